# SPDX-License-Identifier: Apache-2.0
"""The pairs of image files and videos."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from binocular_recon.apps.earlier_run import joint_fingerprint
from binocular_recon.apps.pair_input import OpenInput, PairInput, PairStream
from binocular_recon.camera import StereoRig
from binocular_recon.errors import ConfigError, FileError
from binocular_recon.io.bags.stereo_topics import is_rectified
from binocular_recon.io.calibration_yaml import read_rig
from binocular_recon.io.pairs.file_lists import find_files, is_video
from binocular_recon.io.pairs.file_pairs import pair_files
from binocular_recon.io.pairs.stereo_files import StereoFiles
from binocular_recon.io.pairs.stereo_video import SideBySideVideo, StereoVideo
from binocular_recon.io.pairs.video import Video


@dataclass(frozen=True)
class FileInput(PairInput):
    """Image files or videos and the pairs of them that are reconstructed.

    Attributes
    ----------
    left, right : str
        A folder of images, a pattern, an image or a video of each camera; ``right`` is empty for
        a video that shows both images side by side.
    pair_by : str, optional
        What tells which images belong together: one of `PAIR_BY`; by default as `pair_files`
        chooses, of videos the time.

    Raises
    ------
    ConfigError
        If there is no calibration.

    """

    left: str
    right: str = ''
    pair_by: str | None = None

    def __post_init__(self) -> None:
        """Check that there is a calibration, which image files do not carry."""
        if self.calibration is None:
            raise ConfigError(
                'image files and videos do not carry their calibration; give --calibration DIR (a'
                ' rectified pair without one: binocular-recon match LEFT RIGHT)'
            )

    @contextmanager
    def open(self) -> Iterator[OpenInput]:
        """Find the images or open the videos.

        Raises
        ------
        FileError
            If there are none, or they cannot be paired.
        ImageError
            If videos do not have the size of the calibration.
        BinocularReconError
            If the calibration cannot be used.

        """
        assert self.calibration is not None
        rectified = self.rectified
        if rectified is None:
            rectified = is_rectified('/'.join(Path(self.left).parts[-2:]))
        rig = read_rig(self.calibration, rectified=rectified)
        sides = [find_files(text, side) for text, side in self._named()]
        videos = [is_video(side[0].name) for side in sides]
        if len(sides) == 1 and not videos[0]:
            raise FileError(f'{self.left} is not a video; give the images of both cameras')
        if any(videos) and not all(videos):
            raise FileError(
                f'{self.left} and {self.right} are a video and images; give two of one kind'
            )
        facts = {
            **self.facts(),
            'rectified': rectified,
            'files': [joint_fingerprint(side) for side in sides],
        }
        kind = 'rectified' if rectified else 'raw'
        with ExitStack() as files:
            pairs: PairStream
            versions = {}
            if all(videos):
                opened = [files.enter_context(Video(side[0])) for side in sides]
                pairs, remarks = self._of_videos(opened, rig)
                versions = {'av': version('av')}
            else:
                pairs, remarks = self._of_images(sides, rig)
            remarks = [f'{remarks[0]}; taken as {kind} images', *remarks[1:]]
            yield OpenInput(pairs, rectified, facts, versions, remarks, FileError)

    def _named(self) -> list[tuple[str, str]]:
        return [
            (text, side) for text, side in ((self.left, 'left'), (self.right, 'right')) if text
        ]

    def _of_videos(self, videos: list[Video], rig: StereoRig) -> tuple[PairStream, list[str]]:
        if len(videos) == 1:
            both = SideBySideVideo(videos[0], rig)
            return both, both.remarks
        two = StereoVideo(
            videos[0],
            videos[1],
            rig,
            self.pair_by,
            tolerance_ns=self.tolerance_ns,
            offset_ns=self.pairing.stamp_offset_ns,
        )
        return two, two.remarks

    def _of_images(self, sides: list[list[Path]], rig: StereoRig) -> tuple[PairStream, list[str]]:
        found = pair_files(
            sides[0],
            sides[1],
            self.pair_by,
            tolerance_ns=self.tolerance_ns,
            offset_ns=self.pairing.stamp_offset_ns,
        )
        return StereoFiles(found, rig), found.remarks
