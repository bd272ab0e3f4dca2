# SPDX-License-Identifier: Apache-2.0
"""The output folder of `reconstruct` and `demo`."""

from __future__ import annotations

import math
import re
import statistics
import time
from collections.abc import Collection
from pathlib import Path
from typing import Any

from binocular_recon.apps.batch.frame_log import FrameLog
from binocular_recon.apps.batch.frame_task import FrameOutcome
from binocular_recon.apps.earlier_run import earlier_run, state_digest
from binocular_recon.apps.frame_formats import FRAME_FORMATS, formats_named
from binocular_recon.apps.summary_entries import (
    RIG_ENTRY,
    calibration_entry,
    findings_entry,
)
from binocular_recon.camera import StereoRig
from binocular_recon.io.files import (
    ClaimedFolder,
    move_files,
    naming_errors,
    signals_deferred,
    write_json,
)
from binocular_recon.number_text import counted, reach
from binocular_recon.stereo.diagnosis import Findings

# What the summary says of the recording at the end.
_RECORDING = ('unpaired', 'images_read', 'damage')
# The summary of a long run takes time to write: at most this share of the run.
_SUMMARY_SHARE = 0.05


class ResultFolder:
    """Write the files of each frame as it is finished, and a summary as the run goes.

    Each frame replaces that of the same number of an earlier run; the other frames of the earlier
    run are removed when this run is complete. One process at a time writes to a folder.

    Parameters
    ----------
    folder : Path
        Made with its parents if it does not exist.
    made_from : dict
        What the frames are made from and how, for the summary: `earlier_run.MADE_FROM` without
        the formats.
    formats : collection of str
        Keys of `FRAME_FORMATS` to write besides those that are always written.
    resume : bool
        Whether to continue the run in the folder.

    Attributes
    ----------
    frames : list of dict
        Entry of each finished frame in the summary.
    left_out : list of dict
        Stamp and reason of each pair that could not be reconstructed.
    pairs : int
        Number of pairs that were finished or left out.
    chain_state : dict or None
        `Chain.state` after the last of them.
    refused : list of str
        Why written frames are not reliable.
    cause : str
        Why few pixels could be matched, if that is known.
    facts : dict
        What was found about the recording when the run was finished; else empty.

    Raises
    ------
    ConfigError
        If a format is unknown.
    DependencyError
        If a package is not installed that one needs.
    FileError
        If the folder cannot be made, another process writes to it, or the run in it was
        interrupted and cannot be continued.

    """

    def __init__(
        self,
        folder: Path,
        made_from: dict[str, Any],
        *,
        formats: Collection[str] = (),
        resume: bool = False,
    ) -> None:
        always = [name for name, spec in FRAME_FORMATS.items() if not spec.on_request]
        self._formats = formats_named([*always, *formats])
        self._claim = ClaimedFolder(folder)
        self.folder = folder
        self._made_from = {**made_from, 'formats': list(self._formats)}
        before: dict[str, Any] = {}
        if resume:
            endings = [one for spec in self._formats.values() for one in spec.endings]
            before = earlier_run(folder, self._made_from, endings) or {}
        progress = before.get('progress') or {}
        self.frames: list[dict[str, Any]] = before.get('frames', [])
        self.left_out: list[dict[str, Any]] = before.get('left_out', [])
        self.pairs: int = progress.get('pairs', 0)
        self.chain_state: dict[str, Any] | None = progress.get('chain')
        self.refused: list[str] = progress.get('refused', [])
        self.cause: str = progress.get('cause', '')
        self.facts: dict[str, Any] = {
            name: before[name] for name in _RECORDING if name in before and before['finished']
        }
        self._rig = {
            name: before[name] for name in RIG_ENTRY if name in before and before['frames']
        }
        earlier = [*self.frames, *({'left_out': one} for one in self.left_out)]
        self._log = FrameLog(folder, earlier)
        self._next_summary_s = -math.inf

    @property
    def matched(self) -> float:
        """Mean share of the pixels that were measured; 0 without a frame."""
        return statistics.fmean([frame['matched'] for frame in self.frames] or [0.0])

    @property
    def formats(self) -> tuple[str, ...]:
        """Keys of `FRAME_FORMATS` of the files that each frame has."""
        return tuple(self._formats)

    def add(
        self,
        parts: Path,
        outcome: FrameOutcome,
        findings: Findings,
        rig: StereoRig,
        stamp_ns: int | None = None,
        chain_state: dict[str, Any] | None = None,
        *,
        names: tuple[str, str] | None = None,
    ) -> None:
        """Take over all files of a frame or none; raises a FileError if that is not possible.

        Parameters
        ----------
        parts : Path
            Folder of the files, whose names begin with a number of six digits or more.
        outcome : FrameOutcome
            What came of the pair.
        findings : Findings
            What is wrong with it.
        rig : StereoRig
            Its calibration.
        stamp_ns : int, optional
            Stamp of the pair, if it is known.
        chain_state : dict, optional
            `Chain.state` after it.
        names : (str, str), optional
            What the images of the pair are called.

        """
        index = len(self.frames)
        entry = {'index': index, 'stamp_ns': stamp_ns, **outcome.entry, **findings_entry(findings)}
        if names:
            entry['images'] = list(names)
        rig_entry = self._rig or outcome.rig_entry
        calibration = calibration_entry(rig)
        if calibration != rig_entry['calibration']:
            entry['calibration'] = calibration

        def completed() -> None:
            self._rig = rig_entry
            self.frames.append(entry)
            self.cause = self.cause or findings.cause
            if outcome.outside:
                self.refused.append(outcome.outside)
            self._advance(chain_state, entry)

        with naming_errors(self.folder):
            if not self.frames:  # the summary of an earlier run does not fit any more
                self._summary.unlink(missing_ok=True)
            move_files(parts, self.folder, completed, lambda name: _renumbered(name, index))
        self._save_progress()

    def leave_out(
        self,
        stamp_ns: int | None,
        reason: str,
        chain_state: dict[str, Any] | None = None,
        *,
        names: tuple[str, str] | None = None,
    ) -> None:
        """Note a pair that could not be reconstructed, and `Chain.state` after it."""
        images = {'images': list(names)} if names else {}
        entry = {'stamp_ns': stamp_ns, **images, 'reason': reason}
        with signals_deferred():
            self.left_out.append(entry)
            self._advance(chain_state, {'left_out': entry})
        self._save_progress()

    def _advance(self, chain_state: dict[str, Any] | None, line: dict[str, Any]) -> None:
        self.pairs += 1
        self.chain_state = chain_state
        self._log.add(line)

    def _save_progress(self) -> None:
        """Write the summary so far, unless that was done a short while ago."""
        begun_s = time.monotonic()
        if self.frames and begun_s >= self._next_summary_s:
            self.write_summary(finished=False)
            taken_s = time.monotonic() - begun_s
            self._next_summary_s = begun_s + taken_s / _SUMMARY_SHARE

    @property
    def _summary(self) -> Path:
        return self.folder / 'summary.json'

    def write_summary(self, *, finished: bool, **facts: Any) -> None:
        """Write ``summary.json``, with facts about the recording.

        A run without a finished frame leaves the summary of an earlier run as it is. Raises a
        FileError if it cannot be written.
        """
        if not self.frames and self._summary.exists():
            return
        summary: dict[str, Any] = {
            'frames': self.frames,
            'left_out': self.left_out,
            'finished': finished,
            **facts,
            **self._made_from,
            'calibration': None,
            'matched': self.matched,
            **self._rig,
            'progress': {
                'pairs': self.pairs,
                'refused': self.refused,
                'cause': self.cause,
                'chain': self.chain_state,
            },
        }
        summary['progress']['digest'] = state_digest(summary)
        if finished and self.frames:
            self._drop_earlier_frames()
        write_json(self._summary, summary)

    def close(self) -> None:
        """Let other processes write to the folder."""
        self._claim.release()

    def _drop_earlier_frames(self) -> None:
        """Remove the files of an earlier run that this run has not replaced."""
        every = [one for spec in FRAME_FORMATS.values() for one in spec.endings]
        frame_file = re.compile(rf'(\d{{6,}})({"|".join(map(re.escape, every))})')
        written = {one for spec in self._formats.values() for one in spec.endings}
        for path in self.folder.iterdir():
            found = frame_file.fullmatch(path.name)
            if found and (int(found[1]) >= len(self.frames) or found[2] not in written):
                path.unlink()

    def sentence(self) -> str:
        """Return one sentence about all frames."""
        if not self.frames:
            return f'no frames in {self.folder}'
        depths = [frame['depth_m'] for frame in self.frames if frame['depth_m']['min'] is not None]
        low = min((depth['min'] for depth in depths), default=math.nan)
        high = max((depth['max'] for depth in depths), default=math.nan)
        median = statistics.median([depth['median'] for depth in depths] or [math.nan])
        density = statistics.fmean(frame['density'] for frame in self.frames)
        seconds = statistics.median(frame['seconds'] for frame in self.frames)
        frames = counted(len(self.frames), 'frame')
        return (
            f'{frames} in {self.folder}: {self.matched:.1%} of the pixels measured, {density:.1%}'
            f' with a disparity; points from {low:.2f} to {high:.2f} m (median {median:.2f} m),'
            f' {seconds:.2f} s per frame{self._scale()}'
        )

    def _scale(self) -> str:
        """Return what all depths depend on, for the sentence."""
        if not self._rig:
            return ''
        near, far = (math.inf if one is None else one for one in self._rig['depth_searched_m'])
        return (
            f'; baseline {self._rig["baseline_m"]:.4g} m, focal length'
            f' {self._rig["focal_px"]:.0f} px, searched from {near:.3g} m to {reach(far)}'
        )


def _renumbered(name: str, index: int) -> str:
    """Return the name of a file of a frame with the number of the frame."""
    return f'{index:06d}{name.lstrip("0123456789")}'
