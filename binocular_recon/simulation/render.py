# SPDX-License-Identifier: Apache-2.0
"""Ray-cast images of banded rods in front of painted planes, as a camera delivers them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.camera import Camera, FloatArray
from binocular_recon.images import ByteImage
from binocular_recon.simulation._ray_kernels import draw_cylinder
from binocular_recon.simulation.rig import View
from binocular_recon.simulation.rods import PlacedBoard

Canvas = npt.NDArray[np.float32]

# Rays to flat images are exact at every 16th pixel and interpolated between (0.01 px).
GRID_PX = 16
# Points at which a rod's outline is projected before its rows are filled.
OUTLINE_POINTS = 65


@dataclass(frozen=True)
class RodPaint:
    """How a rod looks; grey levels before exposure.

    Attributes
    ----------
    dark_bgr, light_bgr : tuple of float
        Colours of the dark and the light bands.
    length_m : float
        Foot to top.
    sun_xyz : tuple of float
        Unit direction to the sun in the rig's frame.
    ambient : float
        Share of the light that comes from everywhere.
    grime : float
        Amplitude of soft stains, relative.

    """

    dark_bgr: tuple[float, float, float] = (35.0, 35.0, 35.0)
    light_bgr: tuple[float, float, float] = (215.0, 215.0, 215.0)
    length_m: float = 2.0
    sun_xyz: tuple[float, float, float] = (0.5, -0.7, -0.5)
    ambient: float = 0.6
    grime: float = 0.03


@dataclass(frozen=True, eq=False)
class Billboard:
    """A flat image standing in the scene.

    Attributes
    ----------
    texture : (h, w, 3) uint8
        Colours.
    alpha : (h, w) uint8 or None
        255 where the image hides what is behind it; None = everywhere, mirrored beyond its
        border.
    corner_xyz : (3,) float64
        Centre of the top left pixel in the rig's frame, m.
    right_xyz, down_xyz : (3,) float64
        Step from one pixel to the next, m.

    """

    texture: ByteImage
    alpha: ByteImage | None
    corner_xyz: FloatArray
    right_xyz: FloatArray
    down_xyz: FloatArray


@dataclass(frozen=True)
class Sensor:
    """Response of the camera: blur, ``gain * image + offset``, noise, 8 bits."""

    gain: float = 1.0
    offset: float = 0.0
    blur_px: float = 0.7
    noise: float = 2.0


def draw_backdrop(view: View, backdrop: Billboard) -> Canvas:
    """Render a plane that fills the view: (H, W, 3) float32, grey levels."""
    columns, rows = _texture_coordinates(view, backdrop)
    image: Canvas = cv2.remap(
        backdrop.texture, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101
    ).astype(np.float32)
    return image


def draw_billboard(canvas: Canvas, view: View, billboard: Billboard) -> Canvas:
    """Draw a billboard over ``canvas`` in place and return what it covers.

    Returns
    -------
    (H, W) float32
        Opacity, 0..1.

    """
    columns, rows = _texture_coordinates(view, billboard)
    color = cv2.remap(
        billboard.texture, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    opacity = billboard_opacity(view, billboard)
    touched = np.nonzero(opacity.any(1))[0]
    if touched.size:
        band = slice(touched[0], touched[-1] + 1)
        canvas[band] += opacity[band, :, None] * (color[band] - canvas[band])
    return opacity


def billboard_opacity(view: View, billboard: Billboard) -> Canvas:
    """Return how much of each pixel a billboard covers: (H, W) float32, opacity 0..1."""
    columns, rows = _texture_coordinates(view, billboard)
    alpha = cv2.remap(
        billboard.alpha, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT
    )
    opacity: Canvas = alpha.astype(np.float32) / np.float32(255)
    return opacity


def draw_rods(canvas: Canvas, view: View, placed: PlacedBoard, paint: RodPaint) -> None:
    """Ray-cast the rods of a board over ``canvas`` in place, the farthest first.

    Sides of rods and edges of bands are anti-aliased with 64 rays per pixel.
    """
    feet = placed.feet_xyz @ view.R.T + view.T
    directions = placed.directions_xyz @ view.R.T
    sun = view.R @ np.array(paint.sun_xyz)
    colors = np.array([paint.dark_bgr, paint.light_bgr])
    board = placed.board
    radius = board.rod_diameter_m / 2
    for i in np.argsort(-feet[:, 2]):
        spans = _spans(view.camera, feet[i], directions[i], paint.length_m, radius)
        rod = np.concatenate(
            [feet[i], directions[i], sun, [radius, paint.length_m, paint.ambient, paint.grime, i]]
        )
        draw_cylinder(canvas, spans, view.numbers, rod, board.marks_m, board.light_bands, colors)


def expose(canvas: Canvas, sensor: Sensor, rng: np.random.Generator) -> ByteImage:
    """Return what the sensor delivers: (H, W, 3) uint8."""
    image = cv2.GaussianBlur(canvas, (0, 0), sensor.blur_px) if sensor.blur_px > 0 else canvas
    image = image * np.float32(sensor.gain) + np.float32(sensor.offset)
    if sensor.noise > 0:
        image += np.float32(sensor.noise) * rng.standard_normal(image.shape, np.float32)
    levels: ByteImage = cv2.convertScaleAbs(np.maximum(image, 0))
    return levels


def _texture_coordinates(view: View, billboard: Billboard) -> tuple[Canvas, Canvas]:
    """Return the texture column and row that each pixel of the view sees, each (H, W)."""
    width, height = view.camera.size
    x, y = np.arange(0, width + GRID_PX, GRID_PX), np.arange(0, height + GRID_PX, GRID_PX)
    rays = view.rays(np.stack(np.meshgrid(x, y), -1).astype(np.float64))
    # centre + s ray = corner + column right + row down, solved for all rays at once
    plane = np.stack(
        [billboard.right_xyz, billboard.down_xyz, billboard.corner_xyz - view.centre_xyz], -1
    )
    local = rays @ np.linalg.inv(plane).T
    ahead = local[..., 2:] > 1e-9
    coarse = np.where(ahead, local[..., :2] / np.where(ahead, local[..., 2:], 1.0), -1e6)
    along_y, along_x = _interpolation(height, y), _interpolation(width, x)
    columns, rows = (along_y @ coarse[..., k].astype(np.float32) @ along_x.T for k in range(2))
    return columns, rows


def _interpolation(count: int, knots: npt.NDArray[np.int64]) -> Canvas:
    """Return the matrix that interpolates values at ``knots`` to 0..count - 1."""
    pixels = np.arange(count)
    return np.stack([np.interp(pixels, knots, row) for row in np.eye(len(knots))], -1).astype(
        np.float32
    )


def _spans(
    camera: Camera, foot: FloatArray, direction: FloatArray, length_m: float, radius_m: float
) -> npt.NDArray[np.int64]:
    """Return the row, first and last column of the pixels a rod may touch: (n, 3) int64."""
    axis = foot + np.linspace(0, length_m, OUTLINE_POINTS)[:, None] * direction
    axis = axis[axis[:, 2] > 0.05]
    if not len(axis):
        return np.empty((0, 3), np.int64)
    view = View(camera, np.eye(3), np.zeros(3))
    pixels = view.project(axis)
    half = 1.5 * radius_m * max(camera.K[0, 0], camera.K[1, 1]) / axis[:, 2] + 2
    order = np.argsort(pixels[:, 1])
    x, y, half = pixels[order, 0], pixels[order, 1], half[order]
    first, last = max(0, int(y[0] - half[0])), min(camera.height - 1, int(y[-1] + half[-1]) + 1)
    rows = np.arange(first, last + 1)
    middle, reach = np.interp(rows, y, x), np.interp(rows, y, half)
    slope = np.abs(np.gradient(middle)) if len(rows) > 1 else np.zeros(len(rows))
    reach = reach * (1 + slope)
    left = np.clip(np.floor(middle - reach), 0, camera.width)
    right = np.clip(np.ceil(middle + reach), -1, camera.width - 1)
    return np.stack([rows, left, right], -1).astype(np.int64)
