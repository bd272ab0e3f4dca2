# SPDX-License-Identifier: Apache-2.0
"""The pairs of two lists of image files, decoded one after the other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from binocular_recon.camera import Camera, StereoRig
from binocular_recon.errors import FileError, ImageError
from binocular_recon.images import Image
from binocular_recon.io.image_files import LARGEST_FILE, decoded_image
from binocular_recon.io.pairs.file_pairs import FilePair, FilePairs
from binocular_recon.io.text_files import read_bytes


@dataclass(frozen=True, eq=False)
class FileFrame:
    """An image pair in two files.

    Attributes
    ----------
    pair : FilePair
    rig : StereoRig
        Calibration of the images.

    """

    pair: FilePair
    rig: StereoRig

    @property
    def stamp_ns(self) -> int | None:
        """When the left image was taken; None if its file does not say."""
        return self.pair.stamp_ns

    @property
    def names(self) -> tuple[str, str]:
        """Names of both files."""
        return self.pair.left.name, self.pair.right.name

    def images(self) -> tuple[Image, Image]:
        """Return left and right, grey, BGR or BGRA.

        Raises an ImageError if one cannot be read or has another size than its calibration.
        """
        return _read(self.pair.left, self.rig.left), _read(self.pair.right, self.rig.right)


def _read(path: Path, camera: Camera) -> Image:
    try:
        data = read_bytes(path, 'check the disk', LARGEST_FILE)
    except FileError as error:
        raise ImageError(str(error)) from error
    return decoded_image(data, str(path), camera.size)


class StereoFiles:
    """The image pairs of two lists of files.

    Parameters
    ----------
    found : FilePairs
    rig : StereoRig

    Attributes
    ----------
    expected : int
        Number of pairs.
    images_read : int
        Number of images, those without a partner included.
    unpaired : int
        Number of images without a partner.
    damage : list of str
        Nothing: pairs with a damaged image are left out one by one.

    """

    def __init__(self, found: FilePairs, rig: StereoRig) -> None:
        self._pairs, self._rig = found.pairs, rig
        self.expected = len(found.pairs)
        self.unpaired = len(found.unpaired)
        self.images_read = 2 * self.expected + self.unpaired
        self.damage: list[str] = []

    def __iter__(self) -> Iterator[FileFrame]:
        """Yield the pairs in their order."""
        for pair in self._pairs:
            yield FileFrame(pair, self._rig)
