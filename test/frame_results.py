# SPDX-License-Identifier: Apache-2.0
"""Frames that were not computed, in an output folder."""

from __future__ import annotations

from binocular_recon.apps.batch.frame_task import write_frame
from binocular_recon.apps.frame_formats import FrameResult
from binocular_recon.apps.output_folder import ResultFolder
from binocular_recon.camera import StereoRig
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
        frame = FrameResult(reconstruction, rig)
        outcome = write_frame(frame, seconds, parts, 0, results.formats, {})
        results.add(parts, outcome, reconstruction.findings, rig, stamp_ns)
