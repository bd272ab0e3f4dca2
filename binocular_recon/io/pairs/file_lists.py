# SPDX-License-Identifier: Apache-2.0
"""Find the images or the video that a person names: a folder, a pattern or a file."""

from __future__ import annotations

import glob
import itertools
import re
from collections.abc import Iterator
from pathlib import Path

from binocular_recon.errors import FileError
from binocular_recon.number_text import counted

_IMAGES = re.compile(r'\.(png|jpe?g|jpe|tiff?|bmp|dib|webp|jp2|j2k|p[bgpn]m|pfm)', re.IGNORECASE)
_VIDEOS = re.compile(
    r'\.(mp4|m4v|mov|mkv|webm|avi|wmv|mpe?g|m?ts|m2ts|flv|ogv|mjpeg|h26[45]|hevc)', re.IGNORECASE
)

# What a pattern with many `*` fits may be without end: folders with links to themselves.
_MOST_NAMES = 200_000


def is_video(text: str) -> bool:
    """Tell whether a name is that of a video, by its suffix."""
    return bool(_VIDEOS.fullmatch(Path(text).suffix))


def holds_images(folder: Path) -> bool:
    """Tell whether a path is a folder with images."""
    return folder.is_dir() and any(map(_is_image, folder.iterdir()))


def find_files(text: str, side: str) -> list[Path]:
    """Return the images of one camera, or its video.

    Parameters
    ----------
    text : str
        A folder of images, a pattern such as ``captures/left_*.png``, an image or a video.
    side : str
        ``left`` or ``right``, for errors.

    Returns
    -------
    files : list of Path
        One video, or images in the order of their names; numbers in names count as such, so that
        ``a2`` precedes ``a10``.

    Raises
    ------
    FileError
        If there is no such file, or no image in the folder.

    """
    path = Path(text)
    if path.is_dir():
        inside = [one for one in path.iterdir() if not one.name.startswith('.')]
        found = [one for one in inside if _is_image(one)]
        if not found:
            raise FileError(f'{path} has no images for the {side} camera: {_instead(inside)}')
    elif path.exists():
        found = [path]
    else:
        names = list(itertools.islice(_fitting(text), _MOST_NAMES + 1))
        if len(names) > _MOST_NAMES:
            raise FileError(
                f'{text}: more than {_MOST_NAMES} names fit the pattern, perhaps by links that'
                ' lead back; give the folder itself'
            )
        found = [one for one in map(Path, names) if one.is_file()]
        if not found:
            reason = (
                'no file fits the pattern' if glob.has_magic(text) else 'there is no such file'
            )
            raise FileError(
                f'{text}: {reason}; give a folder, a pattern, an image or a video of the {side}'
                ' camera'
            )
        others = [one for one in found if not _is_image(one)]
        if others and len(found) > 1:
            raise FileError(
                f'{text}: {others[0].name} is not an image by its name; give a pattern that fits'
                f' the images of the {side} camera only'
            )
    return sorted(found, key=lambda one: _natural(str(one)))


def _fitting(text: str) -> Iterator[str | Path]:
    """Return what fits a pattern. `**` follows no links: they may lead back."""
    parts = Path(text).parts
    if '**' not in parts:
        yield from glob.iglob(text)  # noqa: PTH207 - Path.glob takes no absolute patterns
        return
    first = parts.index('**')
    rest = Path(*(part if part == '**' else re.sub(r'\*+', '*', part) for part in parts[first:]))
    wants_hidden = any(part.startswith('.') for part in rest.parts)
    for folder in glob.iglob(str(Path(*parts[:first]))):  # noqa: PTH207
        for path in Path(folder).glob(str(rest / '*' if rest.name == '**' else rest)):
            inside = path.relative_to(folder).parts
            if wants_hidden or not any(part.startswith('.') for part in inside):
                yield path


def _is_image(path: Path) -> bool:
    hidden = path.name.startswith('.')
    return bool(_IMAGES.fullmatch(path.suffix)) and not hidden and path.is_file()


def _instead(inside: list[Path]) -> str:
    videos = sorted(one for one in inside if is_video(one.name))
    if videos:
        return f'it has videos; give the file, such as {videos[0]}'
    if not inside:
        return 'it is empty; give another folder'
    kinds = sorted({one.suffix.lower() or 'no suffix' for one in inside})
    return (
        f'{counted(len(inside), "other file")} ({", ".join(kinds[:4])}); PNG, JPEG, TIFF and'
        ' others are read'
    )


def _natural(text: str) -> list[tuple[int, str]]:
    """Return a key that sorts numbers in names by their value."""
    parts = re.split(r'(\d+)', text)
    return [(int(part), '') if part.isdecimal() else (-1, part) for part in parts]
