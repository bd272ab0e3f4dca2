# SPDX-License-Identifier: Apache-2.0
"""Faces of the cloud: how flat and steep they are, and cross-sections through them."""

from __future__ import annotations

from contextlib import suppress

import cv2
import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.errors import MeasurementError
from binocular_recon.measurement.frame import MeasuredFrame
from binocular_recon.measurement.planes import Plane, fitted_plane, height_above, normal_of
from binocular_recon.measurement.results import Measurement, Quantity, quantities
from binocular_recon.measurement.session import MeasuringSession
from binocular_recon.measurement.snapping import check_inside, window_around
from binocular_recon.measurement.uncertain import Uncertain, joined, propagate
from binocular_recon.stereo.filtering.wls_filter import sigma_if_right

# Most points of a face that are fitted.
FACE_POINTS = 20_000
# So many pixels share an error of matching: those of a window.
ALIKE_PIXELS = 49
# Parts of a face's deviations that count as its range, percent.
RANGE_PERCENT = 2.5, 97.5
# Half the width of the strip of a cross-section, px, and its most samples.
STRIP_HALF_PX, MOST_SAMPLES = 1, 400


def measure_plane(session: MeasuringSession, names: tuple[str, ...]) -> Measurement:
    """Return how flat and how steep the measured cloud within a polygon of picks is.

    Raises
    ------
    MeasurementError
        If too little of the polygon was measured, or it spans no plane.

    """
    number = session.number(names)
    frame = session.frame(number)
    outline = np.stack([session.pick(name).pixel for name in names])
    for name in names:
        check_inside(frame, session.pick(name), session.pick(name).pixel, 'left')
    inside = np.zeros(frame.measured.shape, np.uint8)
    cv2.fillPoly(inside, [np.rint(outline).astype(np.int32)], 1)
    used = (inside > 0) & frame.measured & np.isfinite(frame.points_xyz[..., 2])
    count = int(np.count_nonzero(used))
    if count < ALIKE_PIXELS:
        raise MeasurementError(
            f'plane {" ".join(names)}: only {count} of {int(inside.sum())} pixels within the'
            f' polygon were measured, {ALIKE_PIXELS} are the least; pick a larger part'
        )
    every = count // FACE_POINTS + 1
    points = frame.points_xyz[used][::every]
    # the pixels of a face agree
    sigma_px = sigma_if_right(frame.sigma_px[used][::every].astype(np.float64))
    plane = fitted_plane(frame, points, ' '.join(names))
    normal = normal_of(plane.support.values)
    off = (points - plane.support.values[:3]) @ normal
    along = np.abs(points @ normal) * points[:, 2] / frame.focal_baseline * sigma_px
    noise = float(np.sqrt(np.mean(along**2)))
    sigma = noise / np.sqrt(2 * max(1.0, count / ALIKE_PIXELS))
    rms = float(np.sqrt(np.mean(off**2)))
    low, high = np.percentile(off, RANGE_PERCENT)
    share = {'matching': sigma}
    found = {
        'flatness_rms': Quantity(rms, sigma, 'm', share),
        'flatness_range': Quantity(float(high - low), 4 * sigma, 'm', {'matching': 4 * sigma}),
        'noise_rms': Quantity(noise, sigma, 'm', share),
    }
    with suppress(MeasurementError):  # no ground is seen: nothing says what level is
        found['slope'] = _slope(session, number, plane)
    return Measurement('plane', 'plane', names, found, outline, number, closed=True)


def measure_section(session: MeasuringSession, names: tuple[str, ...]) -> Measurement:
    """Return the cross-section of the cloud between two picks.

    It is cut by the plane through both points and the left camera: along the straight line
    between the pixels. A profile holds the distance along the line of the two points, how far
    the cloud is before it (towards the camera), one standard deviation of that, and the place.

    Raises
    ------
    MeasurementError
        If nothing was measured between the picks.

    """
    number = session.number(names)
    frame = session.frame(number)
    first, last = (session.point(name) for name in names)
    pixels = np.stack([session.pick(name).pixel for name in names])
    samples = _samples(frame, pixels)
    if len(samples) < 2:
        raise MeasurementError(
            f'section {" ".join(names)}: nothing was measured between the two picks'
        )
    ends = joined(first, last)
    offsets = [propagate(_place, point, ends) for point in samples]
    places = np.stack([point.values for point in samples])
    profile = {
        'along_m': np.array([one.values[0] for one in offsets]),
        'before_m': np.array([one.values[1] for one in offsets]),
        'sigma_before_m': np.array([one.sigma[1] for one in offsets]),
        **dict(zip(('x_m', 'y_m', 'z_m'), places.T, strict=True)),
    }
    with suppress(MeasurementError):
        ground = session.ground(number).support.values
        profile['height_m'] = np.array([height_above(ground, place) for place in places])
    most = int(np.argmax(np.abs(profile['before_m'])))
    found = {
        'length': quantities(
            propagate(lambda ends: np.linalg.norm(ends[3:] - ends[:3]), ends), 'm'
        )[0],
        'most_before': quantities(offsets[most])[1],
    }
    return Measurement('section', 'section', names, found, pixels, number, profile=profile)


def _slope(session: MeasuringSession, number: int, plane: Plane) -> Quantity:
    """Return the angle between a plane and the horizontal, degrees."""
    source, up_of = session.up(number)

    def degrees(support: FloatArray, values: FloatArray) -> float:
        normal, up = normal_of(support), up_of(values)
        tilt = np.degrees(np.arctan2(np.linalg.norm(np.cross(normal, up)), abs(normal @ up)))
        return float(tilt)

    return quantities(propagate(degrees, plane.support, source), 'deg')[0]


def _samples(frame: MeasuredFrame, pixels: FloatArray) -> list[Uncertain]:
    """Return points of the cloud along the line between two pixels."""
    length = float(np.linalg.norm(pixels[1] - pixels[0]))
    count = int(np.clip(round(length) + 1, 2, MOST_SAMPLES))
    found = []
    for index, pixel in enumerate(np.linspace(pixels[0], pixels[1], count)):
        window = window_around(pixel, STRIP_HALF_PX)
        used = frame.measured[window]
        if not used.any():
            continue
        disparity = np.asarray(np.median(frame.disparity_px[window][used]), np.float64)
        sigma_px = sigma_if_right(np.asarray(np.median(frame.sigma_px[window][used]), float))
        point = frame.point(pixel, disparity)
        per_px = -point / float(disparity - frame.rig.disparity_offset_px)
        effects = {('matching', f'sample {index}'): sigma_px * per_px[:, None]}
        found.append(frame.calibrated(Uncertain(point, effects)))
    return found


def _place(point: FloatArray, ends: FloatArray) -> FloatArray:
    """Return how far a point is along the line of two points, and before it, m."""
    along = ends[3:] - ends[:3]
    along = along / np.linalg.norm(along)
    from_first = point - ends[:3]
    distance = float(from_first @ along)
    # towards the camera, across the line
    towards = -(ends[:3] + distance * along)
    towards -= (towards @ along) * along
    return np.array([distance, from_first @ towards / np.linalg.norm(towards)])
