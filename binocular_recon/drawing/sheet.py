# SPDX-License-Identifier: Apache-2.0
"""A sheet of paper with lines, boxes, discs and text at millimetres, as SVG or PDF."""

from __future__ import annotations

from html import escape

from binocular_recon.drawing.svg import INK

_POINTS_PER_MM = 72 / 25.4
# Width of a digit of Helvetica, by which other texts are centred too, as a share of its size.
_DIGIT_WIDTH = 0.556
# Four curves with these handles make a circle, to 0.03 % of its radius.
_HANDLE = 0.5523


class Sheet:
    """A drawing to scale; places are millimetres from the top left corner.

    Parameters
    ----------
    size_mm : (float, float)
        Width and height.
    title : str
        What the drawing shows, for those who cannot see it.

    """

    def __init__(self, size_mm: tuple[float, float], title: str) -> None:
        self.size_mm, self.title = size_mm, title
        self._svg: list[str] = []
        self._pdf: list[str] = []

    def line(
        self, start: tuple[float, float], end: tuple[float, float], width: float = 0.15
    ) -> None:
        """Draw a straight line."""
        (a, b), (c, d) = start, end
        self._svg.append(
            f'<line x1="{a:.3f}" y1="{b:.3f}" x2="{c:.3f}" y2="{d:.3f}" stroke="{INK}"'
            f' stroke-width="{width}"/>'
        )
        self._pdf.append(f'{width} w {a:.3f} {b:.3f} m {c:.3f} {d:.3f} l S')

    def box(self, left: float, top: float, width: float, height: float, color: str) -> None:
        """Draw a filled rectangle with a thin border."""
        self._svg.append(
            f'<rect x="{left:.3f}" y="{top:.3f}" width="{width:.3f}" height="{height:.3f}"'
            f' fill="{color}" stroke="{INK}" stroke-width="0.1"/>'
        )
        self._pdf.append(
            f'{_rgb(color)} rg 0.1 w {left:.3f} {top:.3f} {width:.3f} {height:.3f} re B'
        )

    def disc(self, x: float, y: float, radius: float) -> None:
        """Draw a filled circle."""
        self._svg.append(f'<circle cx="{x:.3f}" cy="{y:.3f}" r="{radius:.3f}" fill="{INK}"/>')
        r, k = radius, _HANDLE * radius
        corners = [(r, 0, r, k, k, r, 0, r), (0, r, -k, r, -r, k, -r, 0)]
        corners += [tuple(-value for value in corner) for corner in corners]  # type: ignore[misc]
        path = f'{x + r:.3f} {y:.3f} m'
        for corner in corners:
            places = [value + (y if i % 2 else x) for i, value in enumerate(corner)][2:]
            path += ''.join(f' {place:.3f}' for place in places) + ' c'
        self._pdf.append(f'{_rgb(INK)} rg {path} f')

    def text(
        self,
        x: float,
        y: float,
        text: str,
        color: str = INK,
        anchor: str = 'start',
        size: float = 3.0,
    ) -> None:
        """Write a line; ``anchor``, start, middle or end, says which part of it stands at x."""
        self._svg.append(
            f'<text x="{x:.2f}" y="{y:.2f}" fill="{color}" text-anchor="{anchor}"'
            f' font-size="{size}">{escape(text)}</text>'
        )
        share = {'start': 0.0, 'middle': 0.5, 'end': 1.0}[anchor]
        left = x - share * _DIGIT_WIDTH * size * len(text)
        written = text.replace('\\', r'\\').replace('(', r'\(').replace(')', r'\)')
        self._pdf.append(
            f'BT {_rgb(color)} rg /F {size} Tf 1 0 0 -1 {left:.3f} {y:.3f} Tm ({written}) Tj ET'
        )

    def svg(self) -> str:
        """Return the text of an SVG file."""
        width, height = self.size_mm
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm"'
            f' viewBox="0 0 {width:g} {height:g}" font-family="Helvetica, Arial, sans-serif">'
            f'<title>{escape(self.title)}</title>'
            f'<rect width="{width:g}" height="{height:g}" fill="#ffffff"/>'
            f'{"".join(self._svg)}</svg>\n'
        )

    def pdf(self) -> bytes:
        """Return the content of a PDF file of one page (PDF 32000-1, sections 7.5 and 8.3)."""
        width, height = (side * _POINTS_PER_MM for side in self.size_mm)
        k = _POINTS_PER_MM
        # PDF measures in points from the bottom left corner
        axes = f'{k:.6f} 0 0 {-k:.6f} 0 {height:.4f} cm'
        content = '\n'.join([axes, f'{_rgb(INK)} RG', *self._pdf]).encode('cp1252', 'replace')
        title = self.title.encode('cp1252', 'replace').hex()
        objects = [
            b'<< /Type /Catalog /Pages 2 0 R >>',
            b'<< /Type /Pages /Kids [3 0 R] /Count 1 >>',
            f'<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.3f} {height:.3f}]'
            ' /Contents 4 0 R /Resources << /Font << /F 5 0 R >> >> >>'.encode(),
            f'<< /Length {len(content)} >>\nstream\n'.encode() + content + b'\nendstream',
            b'<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>',
            f'<< /Title <{title}> >>'.encode(),
        ]
        file, places = b'%PDF-1.4\n', []
        for number, body in enumerate(objects, 1):
            places.append(len(file))
            file += f'{number} 0 obj\n'.encode() + body + b'\nendobj\n'
        table = ''.join(f'{place:010d} 00000 n \n' for place in places)
        count = len(objects) + 1
        return (
            file
            + (
                f'xref\n0 {count}\n0000000000 65535 f \n{table}trailer\n'
                f'<< /Size {count} /Root 1 0 R /Info 6 0 R >>\nstartxref\n{len(file)}\n%%EOF\n'
            ).encode()
        )


def _rgb(color: str) -> str:
    return ' '.join(f'{int(color[i : i + 2], 16) / 255:.3f}' for i in (1, 3, 5))
