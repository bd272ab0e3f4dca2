# SPDX-License-Identifier: Apache-2.0
"""Reconstruct all pairs of an input: a bag, image files or videos."""

from __future__ import annotations

import dataclasses
import itertools
import re
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from binocular_recon.apps.output_folder import ResultFolder
from binocular_recon.apps.pair_input import PairInput, PairStream
from binocular_recon.apps.progress import ProgressBar
from binocular_recon.camera import StereoRig
from binocular_recon.config import ChainConfig
from binocular_recon.errors import BinocularReconError, FileError, ImageError
from binocular_recon.io.pfm import read_pfm
from binocular_recon.machine import machine_facts
from binocular_recon.stereo.pipeline import Chain, warm_up
from binocular_recon.stereo.search_range import SearchRange, range_of_depths
from binocular_recon.stereo.validity import (
    LEAST_MATCHED,
    REMEDY,
    few_matched_warning,
)

_WITHOUT_COVARIANCE = (
    'sigma holds the share of matching only; --calibration with the folder of a calibration, which'
    ' has its covariance in calibration.json, adds that of the calibration'
)
# Loading compiled kernels takes less.
_LONG_S = 5.0


def reconstruct_pairs(
    source: PairInput,
    output: Path,
    preset: str,
    config: ChainConfig,
    *,
    formats: Collection[str] = (),
    least_matched: float = LEAST_MATCHED,
    resume: bool = False,
    report: Callable[[str], None] = lambda _: None,
) -> str:
    """Reconstruct the pairs of an input; the files of each frame are written as it is finished.

    Parameters
    ----------
    source : PairInput
        `BagInput` or `FileInput`.
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
    resume : bool
        Whether to continue the run of the same input and options in ``output``: what is there
        already is not computed again, and the files are those of an uninterrupted run.
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
    FileError
        If files cannot be written, or with ``resume`` the run in ``output`` is another one.
    KeyboardInterrupt
        Or a class of it, after an interruption; finished frames are kept, and the message says
        how many.

    """
    with source.open() as opened:
        made_from = {
            'source': opened.facts,
            'preset': preset,
            'options': dataclasses.asdict(config),
            'versions': {**machine_facts()['versions'], **opened.versions},
        }
        results = ResultFolder(output, made_from, formats=formats, resume=resume)
        try:
            if results.facts:
                report(f'{output} is finished already; --no-resume computes it again')
                _Remarks(report).frames(results.frames)
            else:
                for text in opened.remarks:
                    report(text)
                pairs, rectify = opened.pairs, not opened.rectified
                _reconstruct(pairs, source, results, config, report, rectify=rectify)
                results.facts = {
                    'unpaired': pairs.unpaired,
                    'images_read': pairs.images_read,
                    'damage': pairs.damage,
                }
                results.write_summary(finished=True, **results.facts)
        except BaseException as error:
            with suppress(FileError):  # the disk may be full
                results.write_summary(finished=False)
            if isinstance(error, KeyboardInterrupt):
                kept = f'{len(results.frames)} finished frames are kept in {output}'
                raise type(error)(kept) from None
            raise
        finally:
            results.close()
    _raise_problems(results, least_matched, opened.error)
    sentence = results.sentence()
    unpaired, read = results.facts['unpaired'], results.facts['images_read']
    if unpaired:
        sentence += f'; {unpaired} of {read} images have no partner'
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


def _reconstruct(
    stream: PairStream,
    source: PairInput,
    results: ResultFolder,
    config: ChainConfig,
    report: Callable[[str], None],
    *,
    rectify: bool,
) -> None:
    chain, rig, remarks = None, None, _Remarks(report)
    count = -(-stream.expected // source.every)
    before = results.pairs
    if before:
        report(f'{len(results.frames)} frames are finished already; continuing after them')
        remarks.frames(results.frames)
    with ProgressBar(min(count, source.max_frames or count), 'frames', before) as progress:
        pairs = itertools.islice(stream, 0, None, source.every)
        for number, pair in enumerate(pairs, 1):
            if number <= before:
                rig = pair.rig
                if number == before and len(results.frames) == source.max_frames:
                    return
                continue
            if chain is None:
                _prepare(config, report)
                progress.restart_clock()
            if chain is None or pair.rig is not rig:
                chain = Chain(pair.rig, config, rectify=rectify, alpha=source.alpha)
                if before and pair.rig is rig:
                    _restore(chain, results)
                rig = pair.rig
                remarks.say(*pair.rig.notices, *(f'warning: {text}' for text in rig.warnings))
                if source.near_m is not None:
                    chain.search(range_of_depths(source.near_m, source.far_m, chain.rig))
            start = time.perf_counter()
            try:
                reconstruction = chain(*pair.images())
            except ImageError as error:
                results.leave_out(pair.stamp_ns, error, chain.state(), names=pair.names)
            else:
                seconds = time.perf_counter() - start
                if not results.frames:
                    report(_opening(reconstruction.range.search, chain.rig))
                    if not reconstruction.cloud.calibrated:
                        report(_WITHOUT_COVARIANCE)
                results.add(
                    pair.stamp_ns,
                    pair.rig,
                    reconstruction,
                    seconds,
                    chain.state(),
                    names=pair.names,
                )
                remarks.frames(results.frames[-1:])
            progress.show(len(results.frames) + len(results.left_out))
            if len(results.frames) == source.max_frames:
                return


class _Remarks:
    """Reports remarks, one of each kind: of those that differ only in numbers the first."""

    def __init__(self, report: Callable[[str], None]) -> None:
        self._report = report
        self._said: set[str] = set()

    def say(self, *texts: str) -> None:
        for text in texts:
            kind = re.sub(r'\d+(\.\d+)?', '#', text)
            if kind not in self._said:
                self._said.add(kind)
                self._report(text)

    def frames(self, entries: Sequence[Mapping[str, Any]]) -> None:
        """Report the warnings of frames, of this run or an earlier one, by their entries."""
        for entry in entries:
            texts = entry.get('warning'), *entry.get('findings', ())
            self.say(*(f'warning: {text}' for text in texts if text))


def _restore(chain: Chain, results: ResultFolder) -> None:
    """Let a chain go on where the earlier run ended."""
    if results.chain_state is None:
        return
    last_px = None
    if results.chain_state['starts_from_last']:
        last_px = read_pfm(results.folder / f'{len(results.frames) - 1:06d}_disparity.pfm')
    chain.restore(results.chain_state, last_px)


def _opening(search: SearchRange, rig: StereoRig) -> str:
    return (
        f'baseline {rig.baseline_m:.3f} m, focal length {rig.focal_px:.0f} px; search range:'
        f' {search.describe(rig)}'
    )


def _raise_problems(
    results: ResultFolder, least_matched: float, error: type[BinocularReconError]
) -> None:
    """Raise ``error`` if a part of the input could not be reconstructed."""
    problems = list(results.facts['damage'])
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
        raise error('; '.join([*problems, kept]))
