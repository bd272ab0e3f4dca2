# SPDX-License-Identifier: Apache-2.0
"""Images of clouds."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from binocular_recon.drawing.clouds import CloudView, draw_cloud

WIDTH, HEIGHT, FOCAL_PX = 120, 80, 100.0
RED, GREEN = (0, 0, 255), (0, 255, 0)
STRAIGHT = CloudView(yaw_deg=0.0, pitch_deg=0.0, distance=1.0)

Scene = tuple[npt.NDArray[np.float32], npt.NDArray[np.uint8]]


def scene(near_m: float = 4.0, far_m: float = 8.0) -> Scene:
    """Return a green wall with a red square before it."""
    depth = np.full((HEIGHT, WIDTH), far_m)
    depth[30:50, 50:70] = near_m
    rows, columns = np.indices(depth.shape)
    x, y = (columns - WIDTH / 2) / FOCAL_PX, (rows - HEIGHT / 2) / FOCAL_PX
    points = np.stack([x * depth, y * depth, depth], axis=-1).astype(np.float32)
    bgr = np.where((depth == near_m)[..., None], RED, GREEN).astype(np.uint8)
    return points, bgr


def share(image: npt.NDArray[np.uint8], colour: tuple[int, int, int]) -> float:
    return float((image == colour).all(axis=-1).mean())


def centre(image: npt.NDArray[np.uint8], colour: tuple[int, int, int]) -> npt.NDArray[np.float64]:
    """Return the mean row and column of a colour."""
    return np.asarray(np.argwhere((image == colour).all(axis=-1)).mean(axis=0))


def test_seen_straight_the_wall_is_whole_and_hidden_only_by_the_square() -> None:
    image = draw_cloud(*scene(), (2 * WIDTH, 2 * HEIGHT), STRAIGHT)
    assert image.shape == (2 * HEIGHT, 2 * WIDTH, 3)
    # 20 x 20 of 120 x 80 pixels; the borders between the surfaces are not drawn
    assert 0.025 < share(image, RED) < 0.045
    assert share(image, GREEN) > 0.8
    np.testing.assert_allclose(centre(image, RED), [HEIGHT, WIDTH], atol=6)


def test_from_the_left_near_things_move_right_and_from_above_down() -> None:
    size = (2 * WIDTH, 2 * HEIGHT)
    row, column = centre(draw_cloud(*scene(), size, STRAIGHT), RED)
    from_left = draw_cloud(*scene(), size, CloudView(yaw_deg=15.0, pitch_deg=0.0))
    from_above = draw_cloud(*scene(), size, CloudView(yaw_deg=0.0, pitch_deg=15.0))
    assert centre(from_left, RED)[1] > column + 10
    assert centre(from_above, RED)[0] > row + 10


def test_what_stands_before_hides_what_is_behind() -> None:
    points, bgr = scene()
    behind = np.roll(points, 30, axis=1)[::-1]  # painting order must not matter
    both = np.concatenate([points, behind + np.array([0, 0, 5], np.float32)], axis=1)
    colours = np.concatenate([bgr, np.full_like(bgr, 77)], axis=1)
    image = draw_cloud(both, colours, (240, 160), STRAIGHT)
    assert share(image, RED) > 0.015
    rows, columns = np.rint(centre(image, RED)).astype(int)
    assert tuple(image[rows, columns]) == RED


def test_nothing_to_draw_is_an_empty_image() -> None:
    points, bgr = scene()
    image = draw_cloud(np.full_like(points, np.nan), bgr, (60, 40))
    assert image.shape == (40, 60, 3)
    assert np.unique(image.reshape(-1, 3), axis=0).shape == (1, 3)
    one = np.full_like(points, np.nan)
    one[5, 5] = points[5, 5]
    assert draw_cloud(one, bgr, (60, 40)).shape == (40, 60, 3)
