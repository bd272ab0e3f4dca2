# SPDX-License-Identifier: Apache-2.0
"""Charts as SVG text: axes with round ticks, and marks in data coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.number_text import plain

INK, FAINT, GRID = '#22313f', '#71808f', '#e4e9ee'
# Places in a drawing need no more digits than a tenth of a pixel.
_DIGITS = 1


class Chart:
    """A drawing area with axes; y grows upwards unless ``y_limits`` runs downwards.

    Parameters
    ----------
    x_limits, y_limits : (float, float)
        Data coordinates of the left and right, bottom and top border.
    size : (int, int)
        Width and height, px.
    labels : (str, str)
        Names of the axes; an empty name leaves the axis without ticks.

    """

    def __init__(
        self,
        x_limits: tuple[float, float],
        y_limits: tuple[float, float],
        size: tuple[int, int] = (470, 300),
        labels: tuple[str, str] = ('', ''),
    ) -> None:
        self.size = size
        self._x, self._y = x_limits, y_limits
        self._left = 58 if labels[1] else 6
        self._right, self._top = size[0] - 12, 10
        self._bottom = size[1] - (40 if labels[0] else 6)
        self._parts: list[str] = []
        if labels[0]:
            self._x_axis(labels[0])
        if labels[1]:
            self._y_axis(labels[1])

    def place(self, points: FloatArray) -> FloatArray:
        """Return data points (N, 2) as positions in the drawing."""
        points = np.asarray(points, np.float64).reshape(-1, 2)
        x = (points[:, 0] - self._x[0]) / (self._x[1] - self._x[0])
        y = (points[:, 1] - self._y[0]) / (self._y[1] - self._y[0])
        return np.column_stack(
            [
                self._left + x * (self._right - self._left),
                self._bottom - y * (self._bottom - self._top),
            ]
        )

    def line(self, points: FloatArray, color: str, width: float = 2, dash: str = '') -> None:
        """Draw a line through data points (N, 2)."""
        path = ' '.join(f'{x:.{_DIGITS}f},{y:.{_DIGITS}f}' for x, y in self.place(points))
        dashes = f' stroke-dasharray="{dash}"' if dash else ''
        self._parts.append(
            f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="{width}"'
            f' stroke-linejoin="round"{dashes}/>'
        )

    def area(self, points: FloatArray, color: str, opacity: float = 1.0) -> None:
        """Fill the outline of data points (N, 2)."""
        path = ' '.join(f'{x:.{_DIGITS}f},{y:.{_DIGITS}f}' for x, y in self.place(points))
        self._parts.append(f'<polygon points="{path}" fill="{color}" fill-opacity="{opacity}"/>')

    def dots(
        self, points: FloatArray, color: str, radius: float = 2.5, opacity: float = 0.75
    ) -> None:
        """Draw a dot at each data point (N, 2); NaN is left out."""
        placed = self.place(points)
        placed = placed[np.isfinite(placed).all(axis=1)]
        # one path for all: a dot is a line of no length with round ends
        path = ''.join(f'M{x:.{_DIGITS}f} {y:.{_DIGITS}f}h0' for x, y in placed)
        self._parts.append(
            f'<path d="{path}" stroke="{color}" stroke-width="{2 * radius}" stroke-linecap="round"'
            f' stroke-opacity="{opacity}"/>'
        )

    def strokes(self, starts: FloatArray, ends: FloatArray, color: str, width: float = 1) -> None:
        """Draw a line from each start to its end, both (N, 2) data points."""
        path = ''.join(
            f'M{a:.{_DIGITS}f} {b:.{_DIGITS}f}L{c:.{_DIGITS}f} {d:.{_DIGITS}f}'
            for (a, b), (c, d) in zip(self.place(starts), self.place(ends), strict=True)
        )
        self._parts.append(f'<path d="{path}" stroke="{color}" stroke-width="{width}"/>')

    def box(self, corners: FloatArray, color: str, title: str = '') -> None:
        """Fill the rectangle between two opposite corners, (2, 2) data points."""
        (x0, y0), (x1, y1) = self.place(corners)
        tip = f'<title>{escape(title)}</title>' if title else ''
        self._parts.append(
            f'<rect x="{min(x0, x1):.{_DIGITS}f}" y="{min(y0, y1):.{_DIGITS}f}"'
            f' width="{abs(x1 - x0):.{_DIGITS}f}" height="{abs(y1 - y0):.{_DIGITS}f}"'
            f' fill="{color}">{tip}</rect>'
        )

    def text(
        self, point: Sequence[float], text: str, color: str = INK, anchor: str = 'middle'
    ) -> None:
        """Write at a data point."""
        ((x, y),) = self.place(np.array([point]))
        self._write(x, y, text, color, anchor)

    def frame(self) -> None:
        """Draw the border of the area."""
        corners = [[self._x[i], self._y[j]] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))]
        self.line(np.array(corners), FAINT, 1)

    def svg(self, title: str) -> str:
        """Return the SVG; ``title`` describes it to those who cannot see it."""
        width, height = self.size
        return (
            f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{escape(title)}"'
            f' xmlns="http://www.w3.org/2000/svg" font-size="12">{"".join(self._parts)}</svg>'
        )

    def _x_axis(self, label: str) -> None:
        for value in ticks(*self._x):
            ends = np.array([[value, self._y[0]], [value, self._y[1]]])
            self.line(ends, GRID, 1)
            ((x, y),) = self.place(ends[:1])
            self._write(x, y + 15, plain(value), FAINT)
        self._write((self._left + self._right) / 2, self.size[1] - 5, label)

    def _y_axis(self, label: str) -> None:
        for value in ticks(*self._y):
            ends = np.array([[self._x[0], value], [self._x[1], value]])
            self.line(ends, GRID, 1)
            ((x, y),) = self.place(ends[:1])
            self._write(x - 6, y + 4, plain(value), FAINT, 'end')
        middle = (self._top + self._bottom) / 2
        self._parts.append(
            f'<text x="14" y="{middle}" fill="{INK}" text-anchor="middle"'
            f' transform="rotate(-90 14 {middle})">{escape(label)}</text>'
        )

    def _write(
        self, x: float, y: float, text: str, color: str = INK, anchor: str = 'middle'
    ) -> None:
        self._parts.append(
            f'<text x="{x:.{_DIGITS}f}" y="{y:.{_DIGITS}f}" fill="{color}"'
            f' text-anchor="{anchor}">{escape(text)}</text>'
        )


def ticks(start: float, stop: float, about: int = 6) -> FloatArray:
    """Return about so many round numbers between two limits."""
    low, high = sorted((start, stop))
    raw = (high - low) / about
    unit = 10.0 ** np.floor(np.log10(raw))
    step = unit * min((1, 2, 2.5, 5, 10), key=lambda factor: abs(factor * unit - raw))
    values = np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1)
    # + 0.0: never minus zero
    return np.asarray(np.round(values * step, 10) + 0.0, np.float64)


def shade(share: float) -> str:
    """Return a colour from light (0) to dark (1) for maps."""
    stops = np.array(
        [[0xED, 0xF6, 0xF5], [0x6F, 0xBF, 0xB8], [0x0B, 0x7A, 0x75], [0x0A, 0x3D, 0x4A]]
    )
    position = np.clip(share, 0, 1) * (len(stops) - 1)
    index = min(int(position), len(stops) - 2)
    r, g, b = stops[index] + (position - index) * (stops[index + 1] - stops[index])
    return f'#{round(r):02x}{round(g):02x}{round(b):02x}'
