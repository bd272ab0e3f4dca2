# SPDX-License-Identifier: Apache-2.0
"""Write frames that were not computed to an output folder, and compare such folders."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

from binocular_recon.apps.batch.frame_task import write_frame
from binocular_recon.apps.frame_formats import FrameResult
from binocular_recon.apps.output_folder import ResultFolder
from binocular_recon.apps.survey.measured_folder import MeasuredFolder
from binocular_recon.camera import StereoRig
from binocular_recon.config import ChainConfig
from binocular_recon.io.files import part_folder
from binocular_recon.stereo.pipeline import Reconstruction


def add_frame(
    results: ResultFolder,
    stamp_ns: int,
    rig: StereoRig,
    reconstruction: Reconstruction,
    seconds: float = 0.5,
) -> None:
    """Write the files of a frame and take them over."""
    with part_folder(results.folder) as parts:
        frame = FrameResult.of(reconstruction, rig, rig)
        outcome = write_frame(frame, seconds, parts, 0, results.formats, {})
        results.add(parts, outcome, reconstruction.findings, rig, stamp_ns)


def store_frames(folder: Path, rig: StereoRig, frames: list[Reconstruction]) -> MeasuredFolder:
    """Write an output folder with the default options, and open it; stamps count from 1000 ns."""
    options = dataclasses.asdict(ChainConfig())
    results = ResultFolder(folder, {'source': {'rectified': True}, 'options': options})
    for number, frame in enumerate(frames):
        add_frame(results, 1000 + number, rig, frame)
    results.write_summary(finished=True)
    results.close()
    return MeasuredFolder(folder)


def contents(output: Path) -> dict[str, Any]:
    """Return every file of an output folder; the entries without the times that frames took."""
    files: dict[str, Any] = {path.name: path.read_bytes() for path in output.iterdir()}
    summary = json.loads(files.pop('summary.json'))
    log = [json.loads(line) for line in files.pop('frames.jsonl').splitlines()]
    assert [entry for entry in log if 'left_out' not in entry] == summary['frames']
    assert [entry['left_out'] for entry in log if 'left_out' in entry] == summary['left_out']
    for frame in (*summary['frames'], *log):
        assert frame.pop('seconds', 0.0) >= 0
    return {**files, 'summary': summary, 'log': log}
