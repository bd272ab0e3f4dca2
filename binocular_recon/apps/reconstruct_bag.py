# SPDX-License-Identifier: Apache-2.0
"""The chain on a whole bag."""

from __future__ import annotations

import itertools
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from binocular_recon.apps.output_folder import ResultFolder
from binocular_recon.apps.progress import ProgressBar
from binocular_recon.config import ChainConfig
from binocular_recon.errors import BagError, FileError, ImageError
from binocular_recon.io.bags.reader import Bag
from binocular_recon.io.bags.stereo_bag import StereoBag
from binocular_recon.io.bags.stereo_topics import (
    StereoTopics,
    find_stereo_topics,
    name_stereo_topics,
)
from binocular_recon.io.calibration_yaml import read_rig
from binocular_recon.stereo.pipeline import Chain


@dataclass(frozen=True)
class BagInput:
    """Which pairs of which bag.

    Attributes
    ----------
    bag : Path
    namespace : str, optional
        Namespace of the rig.
    images, infos : (str, str), optional
        Topics of left and right where they have not the usual names.
    rectified : bool, optional
        Whether named pictures are rectified; by default if their name says so.
    calibration : Path, optional
        Folder with left.yaml and right.yaml that replaces the recorded calibration.
    alpha : float
        Of the rectification.
    tolerance_ns : int
        Largest difference of the stamps of a pair.
    every : int
        Take every Nth pair.
    max_frames : int, optional
        Stop after so many.
    pictures : bool
        Draw each cloud as well.

    """

    bag: Path
    namespace: str | None = None
    images: tuple[str, str] | None = None
    infos: tuple[str, str] | None = None
    rectified: bool | None = None
    calibration: Path | None = None
    alpha: float = -1.0
    tolerance_ns: int = 0
    every: int = 1
    max_frames: int | None = None
    pictures: bool = False


def reconstruct_bag(source: BagInput, output: Path, preset: str, config: ChainConfig) -> str:
    """Reconstruct the pairs of a bag; each frame's files are written when it is finished.

    Parameters
    ----------
    source : BagInput
    output : Path
        Folder for the results.
    preset : str
        Name of the preset, for the summary.
    config : ChainConfig
        Options of the chain.

    Returns
    -------
    text : str
        What was done, in a sentence.

    Raises
    ------
    BinocularReconError
        If nothing could be reconstructed, or, after all the rest was, if something could not.
    KeyboardInterrupt
        With what was finished, which is kept.

    """
    with Bag(source.bag) as bag:
        rig = read_rig(source.calibration) if source.calibration else None
        topics = _topics(bag, source)
        stereo = StereoBag(bag, topics, rig, tolerance_ns=source.tolerance_ns)
        facts = {'bag': str(source.bag), **topics._asdict()}
        results = ResultFolder(output, facts, pictures=source.pictures)
        try:
            _reconstruct(stereo, source, results, config, rectify=not topics.rectified)
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
        _complain(bag, results)
    sentence = results.sentence()
    if stereo.unpaired:
        sentence += f'; {stereo.unpaired} of {stereo.pictures} pictures have no partner'
    return sentence


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
    *,
    rectify: bool,
) -> None:
    chain, rig = None, None
    count = -(-stereo.expected // source.every)
    with ProgressBar(min(count, source.max_frames or count), 'frames') as progress:
        for pair in itertools.islice(stereo, 0, None, source.every):
            if chain is None or pair.rig is not rig:
                chain, rig = Chain(pair.rig, config, rectify=rectify, alpha=source.alpha), pair.rig
            start = time.perf_counter()
            try:
                reconstruction = chain(*pair.images())
            except ImageError as error:
                results.leave_out(pair.stamp_ns, error)
            else:
                seconds = time.perf_counter() - start
                results.add(pair.stamp_ns, pair.rig, reconstruction, seconds)
            progress.show(len(results.frames) + len(results.left_out))
            if len(results.frames) == source.max_frames:
                return


def _complain(bag: Bag, results: ResultFolder) -> None:
    """Raise a BagError if something that was recorded could not be reconstructed."""
    problems = list(bag.damage)
    if results.left_out:
        total = len(results.left_out) + len(results.frames)
        problems.append(
            f'{len(results.left_out)} of {total} pairs are left out, the first because'
            f' {results.left_out[0]["reason"]}'
        )
    if problems:
        kept = f'{len(results.frames)} frames are in {results.folder}'
        raise BagError('; '.join([*problems, kept]))
