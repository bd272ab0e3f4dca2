# SPDX-License-Identifier: Apache-2.0
"""The cloud with picks and measurements, drawn by viser."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import cv2
import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.errors import BinocularReconError, MeasurementError
from binocular_recon.measurement.picks import Request
from binocular_recon.viewer.coloured_frame import ColouredFrame
from binocular_recon.viewer.shared_view import SharedView

_LINE_RGB, _PICK_RGB = (255, 214, 64), (255, 120, 40)
_LINE_PX = 3.0
# Radius of a pick's ball, as a share of its distance, and points' size, of the gap between them.
_BALL_SHARE, _SIZE_GAPS = 0.0025, 1.3
# The first view is turned by this from that of the left camera, degrees, and so much farther away.
_YAW_DEG, _PITCH_DEG, _AWAY = 14.0, -9.0, 1.35


class Scene:
    """What viser shows.

    Parameters
    ----------
    server : viser.ViserServer
    view : SharedView
    problem : callable
        Is told why a click in the cloud could not be used.

    """

    def __init__(self, server: Any, view: SharedView, problem: Callable[[str], None]) -> None:
        self._server, self._view, self._problem = server, view, problem
        self._drawn: ColouredFrame | None = None
        self._nodes: dict[str, tuple[object, Any]] = {}
        server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
        server.gui.main_panel.minimize()
        server.scene.world_axes.visible = False
        server.scene.on_click()(self._on_click)
        self.update()
        self._place_camera()
        server.gui.set_panel_label('view')

    def update(self) -> None:
        """Draw what has changed."""
        view = self._view
        with view.held(), self._server.atomic():
            if view.displayed is not self._drawn:
                self._drawn = view.displayed
                points, rgb = view.displayed.cloud
                seen = len(points) > 0
                if not seen:  # viser's client wants a point
                    points, rgb = np.zeros((1, 3), np.float32), np.zeros((1, 3), np.uint8)
                self._server.scene.add_point_cloud(
                    '/cloud', points, rgb, point_size=_SIZE_GAPS * view.displayed.gap_m,
                    precision='float32', visible=seen, point_shape='rounded', point_shading='flat',
                )  # fmt: skip
            wanted = self._wanted()
            for name in [*self._nodes]:
                if name not in wanted or wanted[name][0] != self._nodes[name][0]:
                    self._nodes.pop(name)[1].remove()
            for name, (key, make) in wanted.items():
                if name not in self._nodes:
                    self._nodes[name] = key, make(name)

    def _wanted(self) -> dict[str, tuple[object, Callable[[str], Any]]]:
        """Return what marks the cloud: what tells one from another, and what draws it, by name."""
        view, scene = self._view, self._server.scene
        places: dict[str, FloatArray] = {}
        wanted: dict[str, tuple[object, Callable[[str], Any]]] = {}
        for pick in view.board.marks.picks.values():
            place = view.place(pick.name) if pick.frame == view.shown.frame else None
            if place is None:
                continue
            places[pick.name] = place
            ball = partial(
                scene.add_icosphere, radius=_BALL_SHARE * float(np.linalg.norm(place)),
                color=_PICK_RGB, position=place, cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
            label = partial(scene.add_label, text=pick.name, position=place, anchor='bottom-left')
            wanted[f'/picks/{len(places)}'] = pick, ball
            wanted[f'/names/{len(places)}'] = pick, label
        for number, request in enumerate(view.board.marks.requests):
            if len(request.points) > 1 and all(name in places for name in request.points):
                line = np.stack([places[name] for name in request.points])
                key = (request, *(view.board.marks.picks[name] for name in request.points))
                wanted.update(self._line(number, request, line, key))
        return wanted

    def _line(
        self, number: int, request: Request, line: FloatArray, key: object
    ) -> dict[str, tuple[object, Callable[[str], Any]]]:
        scene = self._server.scene
        try:
            found = self._view.measured(request)
        except MeasurementError:
            return {}
        if found.closed:
            line = np.concatenate([line, line[:1]])
        middle = line[:-1].mean(axis=0) if found.closed else (line[0] + line[-1]) / 2
        segments = partial(
            scene.add_line_segments, points=np.stack([line[:-1], line[1:]], axis=1),
            colors=_LINE_RGB, thickness=_LINE_PX, thickness_units='screen',
        )  # fmt: skip
        label = partial(scene.add_label, text=found.label, position=middle, anchor='top-center')
        return {f'/lines/{number}': (key, segments), f'/values/{number}': (key, label)}

    def _place_camera(self) -> None:
        """Look at the cloud from beside the left camera, so that it is seen to be one."""
        frame = self._view.frame
        depth_m = frame.points_xyz[..., 2]
        depth_m = depth_m[np.isfinite(depth_m)]
        away_m = float(np.median(depth_m)) if depth_m.size else 1.0
        middle = away_m * frame.ray((np.array(frame.size) - 1) / 2)
        turn = cv2.Rodrigues(np.radians([_PITCH_DEG, 0.0, 0.0]))[0]
        turn = cv2.Rodrigues(np.radians([0.0, _YAW_DEG, 0.0]))[0] @ turn
        camera = self._server.initial_camera
        self._server.scene.set_up_direction(self._view.up())
        camera.position = middle - _AWAY * turn @ middle
        camera.look_at = middle
        camera.fov = 2 * float(np.arctan(frame.size[1] / (2 * frame.rig.focal_px)))

    def clicked(self, origin: FloatArray, direction: FloatArray) -> None:
        """Pick what a ray (3,) of sight meets, or tell why it cannot be picked."""
        try:
            self._view.look(origin, direction)
        except BinocularReconError as error:
            self._problem(str(error))

    def _on_click(self, event: Any) -> None:
        self.clicked(np.array(event.ray_origin), np.array(event.ray_direction))
