# SPDX-License-Identifier: Apache-2.0
"""Measure between points that are clicked in RViz, each result with one standard deviation."""

from __future__ import annotations

import json
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, PointStamped
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from binocular_recon.errors import BinocularReconError, ImageError, plain_text
from binocular_recon.io.calibration_yaml import read_rig
from binocular_recon.io.messages.clouds import read_cloud
from binocular_recon.measurement.clouds import frame_of_cloud, nearest_pixel
from binocular_recon.measurement.frame import MeasuredFrame
from binocular_recon.measurement.kinds import KINDS, measure
from binocular_recon.measurement.picks import Pick, Request
from binocular_recon.measurement.results import Measurement
from binocular_recon.measurement.session import MeasuringSession
from binocular_recon.nodes.runtime.base_node import BaseNode
from binocular_recon.nodes.runtime.endpoints import Input, Output, create_input
from binocular_recon.nodes.runtime.options import CalibrationOptions
from binocular_recon.nodes.runtime.process import run_node
from binocular_recon.number_text import counted
from binocular_recon.options import Options, option
from binocular_recon.stereo.point_covariance import sigma_shares

try:
    from visualization_msgs.msg import Marker, MarkerArray
except ImportError:  # there it is not installed, results come without markers
    Marker = MarkerArray = None

_LINE_M, _TEXT_M = 0.02, 0.2
# Published besides OUTPUTS where its type is installed, as a MarkerArray.
_MARKERS = 'measurement_markers'


@dataclass(frozen=True)
class MeasuringOptions(Options):
    """What is measured between clicked points."""

    kind: str = option('distance', 'What is measured', choices=tuple(KINDS))
    pick_sigma: float = option(
        1.0,
        'One standard deviation of a click on each axis',
        unit='px',
        minimum=0.01,
        maximum=100.0,
    )


class MeasureNode(BaseNode):
    """Measure between points of the cloud that are clicked in RViz (Publish Point)."""

    NAME = 'measure_node'
    SUBJECT = 'measuring'
    INPUTS = (Input('clicked_point', PointStamped), Input('points2', PointCloud2))
    OUTPUTS = (Output('measurements', String, latched=True),)
    SERVICES: ClassVar = {'clear': 'forget the clicked points and remove the markers'}
    LIVE = (MeasuringOptions,)
    FIXED = (CalibrationOptions,)

    def __init__(self) -> None:
        super().__init__()
        folder = self.options.of(CalibrationOptions).calibration
        self._calibration = read_rig(Path(folder).expanduser()) if folder else None
        self.health.state('sigma', sigma_shares(self._covariance_known))
        self._cloud: PointCloud2 | None = None
        self._picks: list[Pick] = []
        self._frames: dict[int, MeasuredFrame] = {}
        self._frame_of_stamp: tuple[Any, int] | None = None
        self._done = False
        markers = [] if MarkerArray is None else [Output(_MARKERS, MarkerArray, latched=True)]
        self.start(outputs=[*self.OUTPUTS, *markers])
        for source, take in zip(self.INPUTS, (self._on_click, self._on_cloud), strict=True):
            create_input(self, source, take, self.health, compressed=False)
        self.create_service(Trigger, '~/clear', self._on_clear)
        if MarkerArray is None:
            self.get_logger().warning(
                'markers are not published, because visualization_msgs is not installed; install'
                ' it, or show measurements as text'
            )

    def condition(self) -> tuple[bytes, str]:
        """Return level and summary for /diagnostics."""
        if self._cloud is None:
            return DiagnosticStatus.STALE, 'no cloud on points2 yet'
        return DiagnosticStatus.OK, f'{counted(len(self._picks), "point")} clicked'

    @property
    def _covariance_known(self) -> bool:
        return self._calibration is not None and self._calibration.covariance is not None

    def _on_cloud(self, cloud: PointCloud2) -> None:
        self.health.received('points2')
        self._cloud = cloud

    def _on_click(self, click: PointStamped) -> None:
        self.health.received('clicked_point')
        try:
            self._take(click)
        except BinocularReconError as error:
            self.health.dropped('not measured')
            self.health.error(str(error))
            self._forget()
        except Exception:  # noqa: BLE001 - a fault in one click must not end the node
            self.health.dropped('internal error')
            self.health.error(traceback.format_exc())
            self._forget()

    def _on_clear(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        count = len(self._picks)
        self._forget()
        if MarkerArray is not None:
            self.publish(_MARKERS, MarkerArray(markers=[Marker(action=3)]))
        response.success, response.message = True, f'{counted(count, "point")} forgotten'
        return response

    def _forget(self) -> None:
        self._picks, self._frames, self._frame_of_stamp = [], {}, None
        self._done = False

    def _take(self, click: PointStamped) -> None:
        """Add a clicked point, and measure once there are enough."""
        cloud = self._cloud
        if cloud is None:
            raise ImageError('a point was clicked before a cloud came; click again')
        if click.header.frame_id != cloud.header.frame_id:
            raise ImageError(
                f'the point was clicked in the frame {click.header.frame_id!r}, the cloud is in'
                f" {cloud.header.frame_id!r}; set RViz's fixed frame to that of the cloud"
            )
        if self._done:
            self._forget()
        points, number = self._frame(cloud)
        place = np.array([click.point.x, click.point.y, click.point.z])
        name = chr(ord('A') + len(self._picks) % 26) + str(len(self._picks) // 26 or '')
        self._picks.append(Pick(name, nearest_pixel(points, place), frame=number))
        options = self.options.of(MeasuringOptions)
        kind = KINDS[options.kind]
        if len(self._picks) < kind.least:
            self.get_logger().info(
                f'{len(self._picks)} of {kind.least} points of {options.kind} clicked'
            )
            return
        names = tuple(pick.name for pick in self._picks)
        session = MeasuringSession(self._frames.__getitem__, self._picks, options.pick_sigma)
        found = measure(session, Request(options.kind, names, options.kind))
        self._done = kind.most == len(self._picks)
        self._publish(found, session, cloud.header)

    def _frame(self, cloud: PointCloud2) -> tuple[Any, int]:
        """Return the points of a cloud and the number of its frame."""
        points, sigma_z_m, with_calibration = read_cloud(cloud)
        stamp = cloud.header.stamp.sec, cloud.header.stamp.nanosec
        if self._frame_of_stamp is None or self._frame_of_stamp[0] != stamp:
            number = len(self._frames)
            self._frames[number] = frame_of_cloud(
                points, sigma_z_m, self._calibration, with_calibration=with_calibration
            )
            self._frame_of_stamp = stamp, number
        return points, self._frame_of_stamp[1]

    def _publish(self, found: Measurement, session: MeasuringSession, header: Any) -> None:
        content = {
            'text': found.label if found.kind != 'point' else _place_text(found),
            **found.to_mapping(),
            'sigma': sigma_shares(self._covariance_known),
            'frame_id': header.frame_id,
        }
        self.get_logger().info(plain_text(f'{found.kind} {content["text"]}'))
        self.publish('measurements', String(data=json.dumps(content)))
        if MarkerArray is not None:
            places = [session.point(name).values for name in found.points]
            self.publish(_MARKERS, _markers(content['text'], places, header))


def _place_text(found: Measurement) -> str:
    return ', '.join(f'{axis} {value}' for axis, value in found.quantities.items())


def _markers(text: str, places: list[Any], header: Any) -> Any:
    """Return a line through the points, and the text above their middle."""
    line = Marker(header=header, ns='measurement', id=0, type=4, action=0)
    line.points = [Point(x=float(x), y=float(y), z=float(z)) for x, y, z in places]
    line.scale.x = _LINE_M
    label = Marker(header=header, ns='measurement', id=1, type=9, action=0, text=text)
    middle = np.mean(places, axis=0)
    label.pose.position = Point(
        x=float(middle[0]), y=float(middle[1]) - _TEXT_M, z=float(middle[2])
    )
    label.scale.z = _TEXT_M
    for marker in (line, label):
        marker.pose.orientation.w = 1.0
        marker.color.r, marker.color.g, marker.color.b, marker.color.a = 1.0, 0.9, 0.24, 1.0
    return MarkerArray(markers=[line, label])


def main() -> int:
    """Run the node."""
    return run_node(MeasureNode)
