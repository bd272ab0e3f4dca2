# SPDX-License-Identifier: Apache-2.0
"""Reconstruct all pairs of an input: a bag, image files or videos."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Collection
from contextlib import closing, suppress
from pathlib import Path

from binocular_recon.apps.batch.frame_loop import FrameLoop, Remarks
from binocular_recon.apps.batch.frame_task import load_kernels
from binocular_recon.apps.batch.places import Place, ThisProcess
from binocular_recon.apps.output_folder import ResultFolder
from binocular_recon.apps.pair_input import OpenInput, PairInput
from binocular_recon.config import ChainConfig
from binocular_recon.errors import BinocularReconError, ConfigError, FileError
from binocular_recon.machine import machine_facts
from binocular_recon.number_text import counted
from binocular_recon.stereo.validity import (
    LEAST_MATCHED,
    REMEDY,
    few_matched_warning,
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
    jobs: int = 1,
    scheduler: str = '',
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
    jobs : int
        Number of processes that compute frames; the files are the same.
    scheduler : str
        Address of a Dask scheduler whose workers compute the frames instead.
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
    ConfigError
        If frames cannot be computed by so many processes or with these options.
    ClusterError
        If the cluster cannot be reached or used.
    FileError
        If files cannot be written, or with ``resume`` the run in ``output`` is another one.
    KeyboardInterrupt
        Or a class of it, after an interruption; finished frames are kept, and the message says
        how many.

    """
    with closing(_place(jobs, scheduler, config)) as place, source.open() as opened:
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
                Remarks(report).frames(results.frames)
            else:
                for text in opened.remarks:
                    report(text)
                pairs = opened.pairs
                _reconstruct(opened, source, results, config, place, report)
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
                frames = counted(len(results.frames), 'finished frame is', 'finished frames are')
                kept = f'{frames} kept in {output}'
                raise type(error)(kept) from None
            raise
        finally:
            results.close()
    _raise_problems(results, least_matched, opened.error)
    sentence = results.sentence()
    unpaired, read = results.facts['unpaired'], results.facts['images_read']
    if unpaired:
        has = counted(unpaired, f'of {read} images has', f'of {read} images have')
        sentence += f'; {has} no partner'
    warning = few_matched_warning(results.matched, results.cause)
    if results.frames and warning:
        report(f'warning: {warning}')
    return sentence


def _prepare(config: ChainConfig, report: Callable[[str], None]) -> None:
    """Compile the kernels before frames are timed; report it if that took long."""
    begun = time.perf_counter()
    load_kernels(config)
    seconds = time.perf_counter() - begun
    if seconds > _LONG_S:
        report(f'kernels compiled in {seconds:.0f} s; they are kept for the next run')


def _reconstruct(
    opened: OpenInput,
    source: PairInput,
    results: ResultFolder,
    config: ChainConfig,
    place: Place,
    report: Callable[[str], None],
) -> None:
    """Reconstruct the pairs at a place; what they compute there ends if this raises."""
    loop = FrameLoop(source, config, results, place, report, rectify=not opened.rectified)
    try:
        loop.run(opened.pairs, lambda: _prepare(config, report) if place.compiles else None)
    finally:
        place.close()
        loop.drop()


def _place(jobs: int, scheduler: str, config: ChainConfig) -> Place:
    """Return where frames are computed."""
    if jobs == 1 and not scheduler:
        return ThisProcess()
    if config.filter.wls_video:
        raise ConfigError(
            'with wls_video each frame starts from the one before, so that they cannot be computed'
            ' at the same time; omit it, or --jobs and --scheduler'
        )
    if scheduler and jobs != 1:
        raise ConfigError(
            '--scheduler gives frames to the workers of a cluster and --jobs to processes of this'
            ' machine; omit one of them'
        )
    from binocular_recon.apps.batch.dask_cluster import DaskCluster
    from binocular_recon.apps.batch.local_processes import LocalProcesses

    return DaskCluster(scheduler) if scheduler else LocalProcesses(jobs)


def _raise_problems(
    results: ResultFolder, least_matched: float, error: type[BinocularReconError]
) -> None:
    """Raise ``error`` if a part of the input could not be reconstructed."""
    problems = list(results.facts['damage'])
    if results.left_out:
        total = len(results.left_out) + len(results.frames)
        were = counted(len(results.left_out), f'of {total} pairs was', f'of {total} pairs were')
        problems.append(f'{were} left out, the first because {results.left_out[0]["reason"]}')
    if results.refused and least_matched > 0:
        problems.append(f'{results.refused[0]}; or accept the result (--least-matched 0)')
    elif results.frames and results.matched < least_matched:
        problems.append(
            f'only {results.matched:.1%} of the pixels could be matched, at least'
            f' {least_matched:.0%} are expected; {results.cause or REMEDY}, or accept the result'
            ' (--least-matched 0)'
        )
    if problems:
        frames = counted(len(results.frames), 'frame is', 'frames are')
        kept = f'{frames} in {results.folder}'
        raise error('; '.join([*problems, kept]))
