# SPDX-License-Identifier: Apache-2.0
"""Write the frames of an output folder in other formats."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import fields
from pathlib import Path

from binocular_recon.apps.frame_formats import FRAME_FORMATS, formats_named
from binocular_recon.apps.progress import ProgressBar
from binocular_recon.apps.stored_frame import StoredFrame, stored_frames
from binocular_recon.errors import ConfigError, FileError
from binocular_recon.io.exports.placement import Placement
from binocular_recon.io.files import ClaimedFolder, check_apart, complete_files
from binocular_recon.number_text import counted

_STORED = {*dir(StoredFrame), *(field.name for field in fields(StoredFrame))}
# Formats that can be made from what an output folder holds.
EXPORTS = {name: spec for name, spec in FRAME_FORMATS.items() if _STORED.issuperset(spec.needs)}


def export(
    folder: Path,
    output: Path,
    formats: Collection[str],
    placement: Placement | None = None,
) -> str:
    """Write every frame of an output folder in each of the formats.

    Each frame's files are written all or none, and stay if a later frame fails.

    Parameters
    ----------
    folder : Path
        What `reconstruct` wrote.
    output : Path
        Folder for the files; another one than ``folder``.
    formats : collection of str
        Keys of `EXPORTS`.
    placement : Placement, optional
        Puts the points into the frame of a site.

    Returns
    -------
    text : str
        One sentence about what was written.

    Raises
    ------
    BinocularReconError
        If a format cannot be made, or a file cannot be read or written.

    """
    for name in formats:
        if name not in EXPORTS:
            raise ConfigError(f'--format must be among {", ".join(EXPORTS)}, got {name!r}')
    specs = formats_named(formats)
    frames = list(stored_frames(folder, placement))
    if not frames:
        raise FileError(f'{folder} holds no frame; reconstruct first')
    check_apart(output, folder)
    claim = ClaimedFolder(output)
    try:
        with ProgressBar(len(frames), 'frames') as progress:
            for number, frame in enumerate(frames, 1):
                with complete_files(output) as parts:
                    for spec in specs.values():
                        spec.write_frame(parts, frame.index, frame)
                progress.show(number)
    finally:
        claim.release()
    where = ''
    if placement:
        where = f', clouds in the frame of the site ({placement.crs or "local"})'
    return f'{counted(len(frames), "frame")} as {", ".join(specs)} in {output}{where}'
