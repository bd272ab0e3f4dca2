# SPDX-License-Identifier: Apache-2.0
"""The pairs of a run, handed out in their order and written in their order."""

from __future__ import annotations

import itertools
import re
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, wait
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from binocular_recon.apps.batch.frame_task import FrameFailedError, FrameOutcome, FrameTask
from binocular_recon.apps.batch.places import Place
from binocular_recon.apps.batch.stream_state import StreamState
from binocular_recon.apps.output_folder import ResultFolder
from binocular_recon.apps.pair_input import ImagePair, PairInput, PairStream
from binocular_recon.apps.progress import ProgressBar
from binocular_recon.camera import StereoRig
from binocular_recon.config import ChainConfig
from binocular_recon.errors import ImageError
from binocular_recon.io.files import part_folder, remove_abandoned
from binocular_recon.io.pfm import read_pfm
from binocular_recon.number_text import counted
from binocular_recon.stereo.search_range import SearchRange

_WITHOUT_COVARIANCE = (
    'sigma holds the share of matching only; --calibration with the folder of a calibration, which'
    ' has its covariance in calibration.json, adds that of the calibration'
)
# How often progress is looked at while a frame takes long.
_PROGRESS_S = 1.0


class Remarks:
    """Reports remarks, one of each kind: of those that differ only in numbers the first."""

    def __init__(self, report: Callable[[str], None]) -> None:
        self._report = report
        self._said: set[str] = set()

    def say(self, *texts: str) -> None:
        """Report remarks, unless their kind was reported before."""
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


@dataclass(frozen=True, eq=False)
class _Handed:
    """A pair that was handed out."""

    pair: ImagePair
    stream: StreamState
    task: FrameTask | None
    after: dict[str, Any]
    parts: Path
    outcome: Future[FrameOutcome]
    files: ExitStack


class FrameLoop:
    """Reconstruct the pairs of a stream.

    Parameters
    ----------
    source : PairInput
        Which pairs are reconstructed.
    rectify : bool
        Whether their images are to be rectified.
    config : ChainConfig
    results : ResultFolder
    place : Place
        Where frames are computed.
    report : callable
        Takes a line for the user.

    """

    def __init__(
        self,
        source: PairInput,
        config: ChainConfig,
        results: ResultFolder,
        place: Place,
        report: Callable[[str], None],
        *,
        rectify: bool,
    ) -> None:
        self._source, self._config, self._rectify = source, config, rectify
        self._results, self._place, self._report = results, place, report
        self._remarks = Remarks(report)
        self._stream: StreamState | None = None
        self._rig: StereoRig | None = None
        self._handed: deque[_Handed] = deque()

    def run(self, pairs: PairStream, prepare: Callable[[], None]) -> None:
        """Reconstruct the pairs; ``prepare`` is called once before the first.

        What was handed out and is not back is dropped if this raises.
        """
        before, results, handed = self._results.pairs, self._results, self._handed
        if before:
            self._report(
                counted(len(results.frames), 'frame is', 'frames are')
                + ' finished already; continuing from there'
            )
            self._remarks.frames(results.frames)
        count = -(-pairs.expected // self._source.every)
        total = min(count, self._source.max_frames or count)
        with ProgressBar(total, 'frames', before) as progress:
            for number, pair in enumerate(self._wanted(pairs, progress), 1):
                if number <= before:
                    self._rig = pair.rig
                    continue
                if number == before + 1:
                    self._say(self._place.opening())
                    prepare()
                    progress.restart_clock()
                handed.append(self._hand_out(pair))
                while handed and (handed[0].outcome.done() or len(handed) >= self._place.capacity):
                    self._take_back(progress)
            while handed:
                self._take_back(progress)

    def drop(self) -> None:
        """Remove what frames have written that are not taken back."""
        while self._handed:
            self._handed.popleft().files.close()
        remove_abandoned(self._results.folder)  # an interruption may fall into a removal

    def _wanted(self, pairs: PairStream, progress: ProgressBar) -> Iterator[ImagePair]:
        """Yield every Nth pair, until there are as many frames as wanted."""
        results, most, before = self._results, self._source.max_frames, self._results.pairs
        for number, pair in enumerate(itertools.islice(pairs, 0, None, self._source.every), 1):
            yield pair
            if most is None or number < before:
                continue
            while self._handed and len(results.frames) + len(self._handed) >= most:
                self._take_back(progress)
            if len(results.frames) == most:
                return

    def _hand_out(self, pair: ImagePair) -> _Handed:
        stream = self._stream_of(pair.rig)
        index = len(self._results.frames) + len(self._handed)
        files = ExitStack()
        parts = files.enter_context(part_folder(self._results.folder))
        task: FrameTask | None = None
        outcome: Future[FrameOutcome]
        try:
            try:
                task = stream.task(*pair.images(), index, len(self._handed))
            except ImageError as error:
                outcome = Future()
                outcome.set_result(FrameOutcome(reason=str(error)))
            else:
                outcome = self._place.submit(task, parts)
        except BaseException:
            files.close()
            raise
        return _Handed(pair, stream, task, stream.now(), parts, outcome, files)

    def _stream_of(self, rig: StereoRig) -> StreamState:
        """Return the state of the pairs of a calibration; it begins anew with another one."""
        if self._stream and rig is self._rig:
            return self._stream
        formats = self._results.formats
        stream = StreamState(rig, self._config, self._source, formats, rectify=self._rectify)
        earlier = self._results.chain_state
        if self._stream is None and rig is self._rig and earlier is not None:
            last_px = None
            if earlier['starts_from_last']:
                last = len(self._results.frames) - 1
                last_px = read_pfm(self._results.folder / f'{last:06d}_disparity.pfm')
            stream.restore(earlier, last_px)
        self._rig, self._stream = rig, stream
        self._remarks.say(*rig.notices, *(f'warning: {text}' for text in rig.warnings))
        return stream

    def _take_back(self, progress: ProgressBar) -> None:
        """Wait for the first pair that was handed out, and write what came of it."""
        results, handed = self._results, self._handed[0]
        while not handed.outcome.done():
            wait([handed.outcome], timeout=_PROGRESS_S)
            progress.show(len(results.frames) + len(results.left_out))
        try:
            outcome = handed.outcome.result()
        except FrameFailedError as error:
            outcome = FrameOutcome(reason=str(error))
        findings, state = handed.stream.concluded(handed.task, handed.after, outcome)
        pair = handed.pair
        if outcome.reason:
            results.leave_out(pair.stamp_ns, outcome.reason, state, names=pair.names)
        else:
            if not results.frames:
                self._say_first(outcome, handed.stream.rig)
            results.add(
                handed.parts,
                outcome,
                findings,
                pair.rig,
                pair.stamp_ns,
                state,
                names=pair.names,
            )
            self._remarks.frames(results.frames[-1:])
        self._handed.popleft().files.close()
        progress.show(len(results.frames) + len(results.left_out))

    def _say_first(self, outcome: FrameOutcome, rig: StereoRig) -> None:
        searched = outcome.entry['disparity_px']
        search = SearchRange(searched['min'], searched['max'] - searched['min'] + 1)
        self._report(
            f'baseline {rig.baseline_m:.3f} m, focal length {rig.focal_px:.0f} px; search range:'
            f' {search.describe(rig)}'
        )
        if not outcome.calibrated:
            self._report(_WITHOUT_COVARIANCE)
        self._say(self._place.remark(outcome))

    def _say(self, text: str) -> None:
        if text:
            self._report(text)
