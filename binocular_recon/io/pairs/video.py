# SPDX-License-Identifier: Apache-2.0
"""Decode the frames of a video in their order, and say what of it is damaged."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, NamedTuple

from binocular_recon.errors import FileError, ImageError
from binocular_recon.images import Image
from binocular_recon.io.image_headers import MOST_PIXELS
from binocular_recon.io.text_files import open_file
from binocular_recon.machine import optional_package
from binocular_recon.number_text import counted

_NS = 1_000_000_000
# A video may lack so many frames of what its header states without being called cut off.
_ROUNDED_FRAMES = 1.5
# FFmpeg's names of what is read. Others, such as playlists, may name any file or themselves.
_FORMATS = (
    'mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,asf,mpeg,mpegts,mpegvideo,flv,ogg,mjpeg,h264,hevc'
)


class VideoFrame(NamedTuple):
    """A decoded frame: its number, its time since the first frame, ns, and its content."""

    number: int
    time_ns: int
    content: Any

    def image(self, name: str) -> Image:
        """Return it as grey or BGR, 8 or 16 bit; raises an ImageError if it is damaged.

        ``name`` says what it is, for the error.
        """
        if self.content.is_corrupt:
            raise ImageError(f'{name} is damaged; record it again')
        depth = max(component.bits for component in self.content.format.components)
        grey = self.content.format.name.startswith('gray')
        kind = ('gray', 'bgr24') if depth <= 8 else ('gray16le', 'bgr48le')
        image: Image = self.content.to_ndarray(format=kind[0 if grey else 1])
        return image


class Video(AbstractContextManager['Video']):
    """A video file, open for reading.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    path : Path
    size : (int, int)
        Width and height, px.
    rate_hz : float
        Mean number of frames per second; 0 if the file does not state it.
    expected : int
        Number of frames by the header; 0 if it does not say.
    began_ns : int
        When the recording began, ns since 1970; 0 if the file does not say.
    damage : list of str
        Sentences about what could not be read; grows while frames are read.

    Raises
    ------
    DependencyError
        If PyAV is not installed.
    FileError
        If the file is not a video that can be read.

    """

    def __init__(self, path: Path) -> None:
        av = optional_package('av', 'videos')
        self.path, self.damage = path, list[str]()
        self._errors = av.error.FFmpegError
        try:
            open_file(path).close()
            self._container = av.open(str(path), options={'format_whitelist': _FORMATS})
        except (self._errors, OSError) as error:
            raise FileError(
                f'{path} cannot be read as a video: {_reason(error)}; a recording that'
                ' was cut off before its end lacks its index, so repair or record it again'
            ) from error
        if not self._container.streams.video:
            self._container.close()
            raise FileError(f'{path} holds no video stream; give a video')
        self._stream = self._container.streams.video[0]
        context = self._stream.codec_context
        context.options = {'max_pixels': str(MOST_PIXELS)}
        self.size = context.width, context.height
        self.rate_hz = float(self._stream.average_rate or 0)
        self._duration_s = (self._container.duration or 0) / av.time_base
        self.expected = self._stream.frames or round(self._duration_s * self.rate_hz)
        self.began_ns = _began_ns(self._container.metadata.get('creation_time', ''))

    def __exit__(self, *error: object) -> None:
        """Close the file."""
        self._container.close()

    def frames(self, *, past_damage: bool = True) -> Iterator[VideoFrame]:
        """Yield the frames; what cannot be decoded is noted in `damage` and left out.

        Unless ``past_damage``, they end where one cannot be decoded.
        """
        number, first_ns, last_ns, lost = 0, None, 0, 0
        for packet in self._packets():
            try:
                decoded = packet.decode()
            except self._errors:
                lost += 1
                if past_damage:
                    continue
                break
            for content in decoded:
                time_ns = self._time_ns(content, number)
                first_ns = time_ns if first_ns is None else first_ns
                last_ns = time_ns - first_ns
                yield VideoFrame(number, last_ns, content)
                number += 1
        self._note(number, last_ns / _NS, lost)

    def _packets(self) -> Iterator[Any]:
        try:
            yield from self._container.demux(self._stream)
        except self._errors as error:
            self.damage.append(f'{self.path} cannot be read to its end: {_reason(error)}')

    def _time_ns(self, content: Any, number: int) -> int:
        """Return the time of a frame by its time stamp; without one by its number."""
        if content.pts is None:
            return round(number * _NS / self.rate_hz) if self.rate_hz else 0
        base = content.time_base
        return int(content.pts * base.numerator * _NS // base.denominator)

    def _note(self, number: int, last_s: float, lost: int) -> None:
        """Say what is missing, after the last frame."""
        if lost:
            self.damage.append(f'{counted(lost, "frame")} of {self.path} cannot be decoded')
        period_s = 1 / self.rate_hz if self.rate_hz else 0.0
        missing = number < self._stream.frames
        short = last_s + period_s < self._duration_s - _ROUNDED_FRAMES * period_s
        if not lost and (missing or short) and not self.damage:
            stated = (
                counted(self._stream.frames, 'frame') if missing else f'{self._duration_s:.1f} s'
            )
            found = counted(number, 'frame') if missing else f'{last_s + period_s:.1f} s'
            self.damage.append(f'{self.path} is cut off: it has {found} of the {stated} it states')


def _reason(error: Exception) -> str:
    return str(getattr(error, 'strerror', None) or error)


def _began_ns(text: str) -> int:
    try:
        began = datetime.fromisoformat(text.replace('Z', '+00:00'))
    except ValueError:
        return 0
    began = began if began.tzinfo else began.replace(tzinfo=timezone.utc)
    return max(0, round(began.timestamp() * 1e6) * 1000)
