# SPDX-License-Identifier: Apache-2.0
"""An image pair of one board in front of clutter, with the true positions of its marks."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.camera import FloatArray
from binocular_recon.images import ByteImage
from binocular_recon.simulation.clutter import KINDS, fractal_noise, paint
from binocular_recon.simulation.render import (
    Billboard,
    RodPaint,
    Sensor,
    billboard_opacity,
    draw_backdrop,
    draw_billboard,
    draw_rods,
    expose,
)
from binocular_recon.simulation.rig import RawRig, View
from binocular_recon.simulation.rods import PlacedBoard, draw_board

BACKDROP_DEPTH_M = 30.0
# A mark is visible if nothing hides the middle of the rod this far along it ...
CLEAR_ALONG_PX = 2.5
# ... and this share of its width across, and if it is this far inside the image.
CLEAR_ACROSS = 0.6
BORDER_MARGIN_PX = 3.0


@dataclass(frozen=True)
class CaptureOptions:
    """Difficulties of a simulated capture.

    Attributes
    ----------
    occluded, cut, tilted : bool
        Something hides a stretch of a rod; the image border cuts a rod; the board leans by 10 to
        20 degrees.
    blur_px : float
        Blur of lens and sensor, standard deviation, px.
    noise : float
        Standard deviation of the noise, grey levels.
    depth_m : tuple of float
        Range of the board's distance, m.
    kinds : tuple of str
        Painted backgrounds to choose from.
    photographs : tuple of (H, W, 3) uint8
        Photographs to choose from as well; half of the captures use one.

    """

    occluded: bool = False
    cut: bool = False
    tilted: bool = False
    blur_px: float = 0.7
    noise: float = 2.0
    depth_m: tuple[float, float] = (5.0, 16.0)
    kinds: tuple[str, ...] = tuple(KINDS)
    photographs: tuple[ByteImage, ...] = ()


def mixed_options(
    rng: np.random.Generator, photographs: tuple[ByteImage, ...] = (), **changes: Any
) -> CaptureOptions:
    """Draw difficulties: 30 % of boards occluded, 20 % cut by the border, 20 % tilted."""
    return CaptureOptions(
        occluded=bool(rng.random() < 0.3),
        cut=bool(rng.random() < 0.2),
        tilted=bool(rng.random() < 0.2),
        photographs=photographs,
        **changes,
    )


@dataclass(frozen=True, eq=False)
class SimulatedCapture:
    """Images of a board with the ground truth.

    Attributes
    ----------
    left, right : (H, W, 3) uint8
        Raw images.
    placed : PlacedBoard
        The rods as they stand.
    left_px, right_px : (R, M, 2) float64
        Where each camera sees the marks, px.
    left_visible, right_visible : (R, M) bool
        Whether they are visible: inside the image and not hidden.

    """

    left: ByteImage
    right: ByteImage
    placed: PlacedBoard
    left_px: FloatArray = field(repr=False)
    right_px: FloatArray = field(repr=False)
    left_visible: npt.NDArray[np.bool_] = field(repr=False)
    right_visible: npt.NDArray[np.bool_] = field(repr=False)


def simulate_capture(
    board: RodBoard, rig: RawRig, rng: np.random.Generator, options: CaptureOptions | None = None
) -> SimulatedCapture:
    """Simulate one capture.

    Parameters
    ----------
    board : RodBoard
        Rods; their errors are drawn from the board's own sigmas.
    rig : RawRig
        Both cameras.
    rng : numpy.random.Generator
        Source of everything random.
    options : CaptureOptions, optional
        Difficulties; none by default.

    """
    options = options or CaptureOptions()
    roll = np.deg2rad((10.0, 20.0)) if options.tilted else np.deg2rad((0.0, 5.0))
    placed = draw_board(
        board, rig, rng, depth_m=options.depth_m, roll_rad=(roll[0], roll[1]), cut=options.cut
    )
    look = _draw_paint(board, rng)
    hidden_by = _occluders(placed, rig, rng) if options.occluded else []
    backdrop = _backdrop(rig, options, rng)
    gain = rng.uniform(0.75, 1.1)
    sensors = [
        Sensor(gain * ratio, rng.uniform(0, 10), options.blur_px, options.noise)
        for ratio in (1.0, rng.uniform(0.75, 1.2))
    ]
    images, pixels, visible = [], [], []
    for view, sensor in zip(rig.views(), sensors, strict=True):
        canvas = draw_backdrop(view, backdrop)
        draw_rods(canvas, view, placed, look)
        opacity = np.zeros(canvas.shape[:2], np.float32)
        for billboard in hidden_by:
            covered = draw_billboard(canvas, view, billboard)
            np.maximum(opacity, covered, out=opacity)
        images.append(expose(canvas, sensor, rng))
        pixels.append(placed.marks_px(view))
        visible.append(visible_marks(placed, view, opacity))
    return SimulatedCapture(
        images[0], images[1], placed, pixels[0], pixels[1], visible[0], visible[1]
    )


def visible_marks(
    placed: PlacedBoard, view: View, opacity: npt.NDArray[np.float32]
) -> npt.NDArray[np.bool_]:
    """Return which marks can be seen: (R, M) bool.

    A mark is visible if both sides of the rod are inside the image, and nothing opaque is within
    ``CLEAR_ALONG_PX`` along the rod on the middle ``CLEAR_ACROSS`` of its width.
    """
    marks = placed.marks_xyz()
    center = placed.marks_px(view)
    along = view.project(marks + 0.01 * placed.directions_xyz[:, None]) - view.project(marks)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    depth = (marks @ view.R.T + view.T)[..., 2]
    width = placed.board.rod_diameter_m * view.camera.K[0, 0] / depth
    across = np.stack([-along[..., 1], along[..., 0]], -1)
    s, t = np.meshgrid(np.linspace(-1, 1, 7), np.linspace(-0.5, 0.5, 9))
    probe = (
        center[..., None, :]
        + CLEAR_ALONG_PX * s.ravel()[:, None] * along[..., None, :]
        + CLEAR_ACROSS * t.ravel()[:, None] * (width[..., None] * across)[..., None, :]
    )
    limit = np.array(view.camera.size) - 1 - BORDER_MARGIN_PX
    half = 0.5 * width[..., None] * across
    ends = np.stack([center - half, center, center + half])
    inside = np.all((ends >= BORDER_MARGIN_PX) & (ends <= limit), (0, -1))
    probe = np.nan_to_num(probe, nan=-1e6).astype(np.float32)
    hidden = cv2.remap(
        opacity, probe[..., 0].reshape(-1, 1), probe[..., 1].reshape(-1, 1), cv2.INTER_LINEAR
    ).reshape(probe.shape[:-1])
    clear: npt.NDArray[np.bool_] = inside & (hidden.max(-1) < 0.05)
    return clear


def _draw_paint(board: RodBoard, rng: np.random.Generator) -> RodPaint:
    """Black and white or red and white rods, new or faded, in sun or shade."""
    white = rng.uniform(170, 240) * np.array([1.0, 1.0, 1.0]) + rng.normal(0, 4, 3)
    dark = np.array([(1, 1, 1), (0.9, 0.7, 4.5)][rng.integers(2)]) * rng.uniform(20, 45)
    sun = np.array([rng.uniform(-1, 1), -0.7, rng.uniform(-1, 0.3)])
    gap = float(np.diff(board.marks_m).mean())
    return RodPaint(
        dark_bgr=(float(dark[0]), float(dark[1]), float(dark[2])),
        light_bgr=(float(white[0]), float(white[1]), float(white[2])),
        length_m=float(board.marks_m[-1] + gap * rng.uniform(0.3, 1.1)),
        sun_xyz=tuple(sun / np.linalg.norm(sun)),
        ambient=rng.uniform(0.45, 0.9),
        grime=rng.uniform(0.0, 0.06),
    )


def _backdrop(rig: RawRig, options: CaptureOptions, rng: np.random.Generator) -> Billboard:
    """Return a photograph or a painted plane behind the rods, large enough for both views."""
    width, height = (int(1.25 * side) for side in rig.left.size)
    if options.photographs and (not options.kinds or rng.random() < 0.5):
        texture = options.photographs[rng.integers(len(options.photographs))]
        if rng.random() < 0.5:
            texture = np.ascontiguousarray(texture[:, ::-1])
        scale = max(width / texture.shape[1], height / texture.shape[0])
        texture = cv2.resize(texture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    else:
        kind = options.kinds[rng.integers(len(options.kinds))]
        texture = paint(kind, (width, height), rng)
    step = BACKDROP_DEPTH_M / rig.left.K[0, 0]
    corner = -step * np.array([texture.shape[1], texture.shape[0], 0.0]) / 2
    corner += [rig.baseline_m / 2, 0.0, BACKDROP_DEPTH_M]
    return Billboard(texture, None, corner, step * np.eye(3)[0], step * np.eye(3)[1])


def _occluders(placed: PlacedBoard, rig: RawRig, rng: np.random.Generator) -> list[Billboard]:
    """Return one or two things that hide a stretch of some rods, up to half of a rod's marks."""
    while True:
        billboards = [_occluder(placed, rng) for _ in range(rng.integers(1, 3))]
        for view in rig.views():
            width, height = view.camera.size
            nothing = np.zeros((height, width), np.float32)
            covered = nothing.copy()
            for billboard in billboards:
                np.maximum(covered, billboard_opacity(view, billboard), out=covered)
            hidden = visible_marks(placed, view, nothing) & ~visible_marks(placed, view, covered)
            if hidden.sum(1).max() > placed.board.marks_per_rod / 2:
                break
        else:
            return billboards


def _occluder(placed: PlacedBoard, rng: np.random.Generator) -> Billboard:
    """Return something between the rig and a rod that hides a stretch of it."""
    board = placed.board
    rod = rng.integers(board.count)
    height = rng.uniform(0.1, 1.0) * board.marks_m[-1]
    share = rng.uniform(0.5, 0.95)
    middle = share * (placed.feet_xyz[rod] + height * placed.directions_xyz[rod])
    size_m = share * board.marks_m[-1] * rng.uniform(0.15, 0.45) * np.ones(2)
    shape = rng.choice(['plate', 'branch', 'bush', 'trunk'])
    side = 256
    mask = np.zeros((side, side), np.uint8)
    if shape == 'plate':
        mask[:] = 255
        size_m *= rng.uniform(0.5, 1.3, 2)
    elif shape == 'bush':
        blob = fractal_noise((side, side), 64, rng)
        y, x = np.mgrid[-1 : 1 : side * 1j, -1 : 1 : side * 1j]
        mask[blob > 4 * (x**2 + y**2) - 2.2] = 255
    else:
        lean = rng.uniform(-0.5, 0.5)
        ends = np.array([[-0.5 - lean / 2, 0.0], [0.5 + lean / 2, 0.0]])
        ends[:, 1] = [lean, -lean]
        ends = ends if shape == 'branch' else ends[:, ::-1]
        size_m *= 4.0
        ends_px = ((ends * 1.2 + 0.5) * side).astype(int)
        thick = int(rng.uniform(0.06, 0.2) * side)
        cv2.line(mask, tuple(ends_px[0]), tuple(ends_px[1]), 255, thick, cv2.LINE_AA)
    mask[[0, -1]] = mask[:, [0, -1]] = 0
    tone = np.array([60.0, 75.0, 80.0]) * rng.uniform(0.3, 2.8) + rng.uniform(-15, 15, 3)
    bark = 1 + rng.uniform(0.05, 0.4) * fractal_noise((side, side), 32, rng)
    texture = np.clip(bark[..., None] * tone, 0, 255).astype(np.uint8)
    step = size_m / side
    corner = middle - np.array([size_m[0], size_m[1], 0.0]) / 2
    return Billboard(texture, mask, corner, step[0] * np.eye(3)[0], step[1] * np.eye(3)[1])
