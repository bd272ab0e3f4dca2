# SPDX-License-Identifier: Apache-2.0
"""Reconstruct a whole bag."""

from __future__ import annotations

import itertools
import math
import re
import time
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from binocular_recon.apps.output_folder import ResultFolder
from binocular_recon.apps.progress import ProgressBar
from binocular_recon.camera import StereoRig
from binocular_recon.config import ChainConfig
from binocular_recon.errors import BagError, FileError, ImageError
from binocular_recon.inputs.options import PairingOptions
from binocular_recon.io.bags.reader import Bag
from binocular_recon.io.bags.stereo_bag import StereoBag
from binocular_recon.io.bags.stereo_topics import (
    StereoTopics,
    find_stereo_topics,
    name_stereo_topics,
)
from binocular_recon.io.calibration_yaml import read_rig
from binocular_recon.stereo.pipeline import Chain, warm_up
from binocular_recon.stereo.search_range import SearchRange, range_of_depths
from binocular_recon.stereo.validity import (
    LEAST_MATCHED,
    MOST_OUTSIDE,
    REMEDY,
    few_matched_warning,
)

_WITHOUT_COVARIANCE = (
    'sigma holds the share of matching only; --calibration with the folder of a calibration, which'
    ' has its covariance in calibration.json, adds that of the calibration'
)
# Loading compiled kernels takes less.
_LONG_S = 5.0


@dataclass(frozen=True)
class BagInput:
    """A bag and the pairs of it that are reconstructed.

    Attributes
    ----------
    bag : Path
    namespace : str, optional
        Namespace of the rig.
    images, infos : (str, str), optional
        Topics of left and right if they do not have the usual names.
    rectified : bool, optional
        Whether ``images`` are rectified; by default as `is_rectified` says.
    calibration : Path, optional
        Calibration that replaces the recorded camera infos, as `read_rig` reads it.
    alpha : float
        Passed to `Rectifier`.
    tolerance_ns : int
        Largest difference between the stamps of a pair.
    pairing : PairingOptions
        What tells that images belong together.
    every : int
        Reconstruct every Nth pair.
    max_frames : int, optional
        Stop after this many frames.
    near_m, far_m : float, optional
        Depths that are searched, instead of a range in pixels.

    """

    bag: Path
    namespace: str | None = None
    images: tuple[str, str] | None = None
    infos: tuple[str, str] | None = None
    rectified: bool | None = None
    calibration: Path | None = None
    alpha: float = -1.0
    tolerance_ns: int = 0
    pairing: PairingOptions = field(default_factory=PairingOptions)
    every: int = 1
    max_frames: int | None = None
    near_m: float | None = None
    far_m: float = math.inf


def reconstruct_bag(
    source: BagInput,
    output: Path,
    preset: str,
    config: ChainConfig,
    *,
    formats: Collection[str] = (),
    least_matched: float = LEAST_MATCHED,
    report: Callable[[str], None] = lambda _: None,
) -> str:
    """Reconstruct the pairs of a bag; the files of each frame are written as it is finished.

    Parameters
    ----------
    source : BagInput
    output : Path
        Folder for the results.
    preset : str
        Name of the preset, for the summary.
    config : ChainConfig
        Options of the chain.
    formats : collection of str
        Keys of `FRAME_FORMATS` to write besides those that are always written.
    least_matched : float
        With a smaller share of measured pixels the result is refused, though it is written.
    report : callable
        Takes a line for the user at the start, and warnings.

    Returns
    -------
    text : str
        One sentence about what was reconstructed.

    Raises
    ------
    BinocularReconError
        If nothing could be reconstructed; or, after the rest was, if a part could not be.
    KeyboardInterrupt
        After an interruption; finished frames are kept, and the message says how many.

    """
    with Bag(source.bag) as bag:
        topics = _topics(bag, source)
        rig = (
            read_rig(source.calibration, rectified=topics.rectified)
            if source.calibration
            else None
        )
        stereo = StereoBag(
            bag, topics, rig, tolerance_ns=source.tolerance_ns, pairing=source.pairing
        )
        facts = {'bag': str(source.bag), **topics._asdict()}
        results = ResultFolder(output, facts, formats=formats)
        try:
            rectify = not topics.rectified
            _reconstruct(stereo, source, results, config, report, rectify=rectify)
        except BaseException as error:
            with suppress(FileError):  # the disk may be full
                results.write_summary(preset, config, finished=False)
            if isinstance(error, KeyboardInterrupt):
                kept = f'{len(results.frames)} finished frames are kept in {output}'
                raise KeyboardInterrupt(kept) from None
            raise
        results.write_summary(
            preset, config, finished=True, unpaired=stereo.unpaired, damage=bag.damage
        )
        _raise_problems(bag, results, least_matched)
    sentence = results.sentence()
    if stereo.unpaired:
        sentence += f'; {stereo.unpaired} of {stereo.images_read} images have no partner'
    warning = few_matched_warning(results.matched, results.cause)
    if results.frames and warning:
        report(f'warning: {warning}')
    return sentence


def _prepare(config: ChainConfig, report: Callable[[str], None]) -> None:
    """Compile the kernels before frames are timed; report it if that took long."""
    begun = time.perf_counter()
    warm_up(config)
    seconds = time.perf_counter() - begun
    if seconds > _LONG_S:
        report(f'kernels compiled in {seconds:.0f} s; they are kept for the next run')


def _topics(bag: Bag, source: BagInput) -> StereoTopics:
    calibrated = source.calibration is not None
    if source.images is None:
        return find_stereo_topics(bag.topics, source.namespace, calibrated=calibrated)
    return name_stereo_topics(
        bag.topics,
        source.images,
        source.infos,
        rectified=source.rectified,
        calibrated=calibrated,
    )


def _reconstruct(
    stereo: StereoBag,
    source: BagInput,
    results: ResultFolder,
    config: ChainConfig,
    report: Callable[[str], None],
    *,
    rectify: bool,
) -> None:
    chain, rig, warned, said = None, None, False, set[str]()
    count = -(-stereo.expected // source.every)
    with ProgressBar(min(count, source.max_frames or count), 'frames') as progress:
        for pair in itertools.islice(stereo, 0, None, source.every):
            if chain is None:
                _prepare(config, report)
            if chain is None or pair.rig is not rig:
                chain, rig = Chain(pair.rig, config, rectify=rectify, alpha=source.alpha), pair.rig
                remarks = [*pair.rig.notices, *(f'warning: {text}' for text in pair.rig.warnings)]
                for text in remarks:
                    if text not in said:
                        report(text)
                said.update(remarks)
                if source.near_m is not None:
                    chain.search(range_of_depths(source.near_m, source.far_m, chain.rig))
            start = time.perf_counter()
            try:
                reconstruction = chain(*pair.images())
            except ImageError as error:
                results.leave_out(pair.stamp_ns, error)
            else:
                seconds = time.perf_counter() - start
                if not results.frames:
                    report(_opening(reconstruction.range.search, chain.rig))
                    if not reconstruction.cloud.calibrated:
                        report(_WITHOUT_COVARIANCE)
                warning = reconstruction.range.warning
                if warning and not warned:
                    warned = True
                    report(f'warning: {warning}')
                for text in reconstruction.findings.warnings:
                    if _kind(text) not in said:
                        said.add(_kind(text))
                        report(f'warning: {text}')
                if reconstruction.range.outside_share > MOST_OUTSIDE:
                    results.refuse(warning)
                results.add(pair.stamp_ns, pair.rig, reconstruction, seconds)
            progress.show(len(results.frames) + len(results.left_out))
            if len(results.frames) == source.max_frames:
                return


def _kind(text: str) -> str:
    """Return what warnings have in common that differ in their numbers only."""
    return re.sub(r'\d+(\.\d+)?', '#', text)


def _opening(search: SearchRange, rig: StereoRig) -> str:
    return (
        f'baseline {rig.baseline_m:.3f} m, focal length {rig.focal_px:.0f} px; search range:'
        f' {search.describe(rig)}'
    )


def _raise_problems(bag: Bag, results: ResultFolder, least_matched: float) -> None:
    """Raise a BagError if a part of the recording could not be reconstructed."""
    problems = list(bag.damage)
    if results.left_out:
        total = len(results.left_out) + len(results.frames)
        problems.append(
            f'{len(results.left_out)} of {total} pairs were left out, the first because'
            f' {results.left_out[0]["reason"]}'
        )
    if results.refused and least_matched > 0:
        problems.append(f'{results.refused[0]}; or accept the result (--least-matched 0)')
    elif results.frames and results.matched < least_matched:
        problems.append(
            f'only {results.matched:.1%} of the pixels could be matched, at least'
            f' {least_matched:.0%} are expected; {results.cause or REMEDY}, or accept the result'
            ' (--least-matched 0)'
        )
    if problems:
        kept = f'{len(results.frames)} frames are in {results.folder}'
        raise BagError('; '.join([*problems, kept]))
