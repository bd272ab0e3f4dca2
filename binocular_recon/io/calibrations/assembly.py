# SPDX-License-Identifier: Apache-2.0
"""From two cameras and their pose to a rectified rig: which is left, and whether it can be."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from binocular_recon.camera import FloatArray, StereoRig
from binocular_recon.errors import CalibrationError
from binocular_recon.inputs.camera_reading import camera_of_image
from binocular_recon.io.calibrations.pair_rectification import Rectification, rectify_pair
from binocular_recon.io.calibrations.raw_rig import Choice, RawCamera, RawRig, relative_pose
from binocular_recon.io.calibrations.values import inverse
from binocular_recon.number_text import significant

# Cameras that differ more do not see the same; the optical axis may come this close to the
# baseline, rad.
_MOST_TURNED, _LEAST_ASIDE = np.radians(75), np.radians(30)
# A baseline that is rounding, m.
_LEAST_APART_M = 1e-9
# R and T of a file may differ from its R1, R2, P1 and P2 by this much, rad and a share of T.
_SAME = 5e-3


@dataclass(frozen=True, eq=False)
class ImportedRig:
    """A rig read from the files of another program.

    Attributes
    ----------
    rig : StereoRig
        Its ``notices`` say what was read and which camera is left.
    format : str
        Name of the format.
    files : tuple of Path
    names : (str, str)
        What the files call the left and the right camera.

    """

    rig: StereoRig
    format: str
    files: tuple[Path, ...]
    names: tuple[str, str]


def assemble(raw: RawRig, choice: Choice, *, rectified: bool = False) -> ImportedRig:
    """Return the rectified rig of two cameras of a calibration.

    Parameters
    ----------
    raw : RawRig
    choice : Choice
        What the file leaves open.
    rectified : bool
        Whether the images are rectified; only P counts then, so the file must state it.

    Raises
    ------
    CalibrationError
        If something is missing, or the cameras and their pose are not those of a stereo rig.

    """
    first, second = raw.pair(choice.cameras)
    pose = relative_pose(first, second, raw.no_pose)
    pose[:3, 3] *= raw.unit_m
    _check_pose(pose, first, second, raw)
    stated = _stated(first, second, raw)
    if stated is not None:
        _check_agreement(stated, pose, raw)
    first, second = (_sized(camera, raw, choice) for camera in (first, second))
    left, right, why = _in_order(first, second, pose)
    if left is not first:
        pose, stated = inverse(pose), stated and stated.exchanged()
    if choice.baseline_m is not None:
        scale = choice.baseline_m / float(np.linalg.norm(pose[:3, 3]))
        pose[:3, 3] *= scale
        stated = stated and stated.scaled(scale)
    cameras = left.camera(), right.camera()
    found = stated or rectify_pair(*cameras, pose)
    if rectified and not found.stated:
        raise CalibrationError(
            f'{raw.where} does not state how the images were rectified ({raw.format} has no P);'
            ' give the images as recorded, or the camera infos of the rectified ones'
        )
    notices = (f'{left.name} of {raw.where} ({raw.format}); {why}', *raw.notices)
    if len(raw.listed) > 2 and choice.cameras is None:
        others = (
            f'{len(raw.listed)} cameras are stated, {first.name} and {second.name} are taken;'
            ' import-calibration --cameras chooses others'
        )
        notices = (*notices, others)
    pair = [
        camera_of_image(
            camera.size, camera.K, camera.D, R, P, camera.distortion_model,
            rectified=rectified, notices=said,
        )
        for camera, R, P, said in (
            (cameras[0], found.R_left, found.P_left, notices),
            (cameras[1], found.R_right, found.P_right, (right.name,)),
        )
    ]  # fmt: skip
    try:
        rig = StereoRig(*pair)
    except CalibrationError as error:
        raise CalibrationError(f'{raw.where}: {error}') from error
    return ImportedRig(rig, raw.format, raw.files, (left.name, right.name))


def _sized(camera: RawCamera, raw: RawRig, choice: Choice) -> RawCamera:
    size = camera.size or choice.image_size
    if size is not None and choice.image_size not in (None, size):
        raise CalibrationError(
            f'{camera.where}: the images have {size[0]}x{size[1]} px, not the size that'
            ' --image-size states; omit it, or use the calibration of that size'
        )
    if size is None:
        raise CalibrationError(
            f'{camera.where}: the image size is missing ({raw.format}); state it with'
            ' import-calibration --image-size WIDTHxHEIGHT, or add image_width and image_height'
            ' to the file'
        )
    return dataclasses.replace(camera, size=size)


def _check_pose(pose: FloatArray, first: RawCamera, second: RawCamera, raw: RawRig) -> None:
    """Raise a CalibrationError unless the cameras stand apart and look the same way."""
    baseline_m = float(np.linalg.norm(pose[:3, 3]))
    both = f'{raw.where}: {first.name} and {second.name}'
    if baseline_m < _LEAST_APART_M:
        raise CalibrationError(
            f'{both} stand at the same place, so there is no baseline; calibrate them together as'
            ' a rig'
        )
    turned = float(np.arccos(np.clip((np.trace(pose[:3, :3]) - 1) / 2, -1, 1)))
    if turned > _MOST_TURNED:
        raise CalibrationError(
            f'{both} are turned against each other by {np.degrees(turned):.0f} degrees, at most'
            f' {np.degrees(_MOST_TURNED):.0f} are possible; choose two cameras that look the same'
            ' way, turn the images of a camera that hangs upside down before calibrating, or check'
            ' the direction of the pose'
        )
    centre = -pose[:3, :3].T @ pose[:3, 3] / baseline_m
    view = np.array([0, 0, 1.0]) + pose[2, :3]
    aside = float(np.arccos(np.clip(abs(centre @ view) / np.linalg.norm(view), 0, 1)))
    if aside < _LEAST_ASIDE:
        raise CalibrationError(
            f'{both}: one stands in front of the other ({np.degrees(aside):.0f} degrees between'
            f' baseline and view, at least {np.degrees(_LEAST_ASIDE):.0f} are needed); cameras'
            ' of a rig stand side by side: check the pose, its axes must be x right, y down, z'
            ' forward'
        )


def _stated(first: RawCamera, second: RawCamera, raw: RawRig) -> Rectification | None:
    """Return the rectification that the file states, None if it does not."""
    one, other = first.rectification(), second.rectification()
    if one is None or other is None:
        return None
    scale = np.array([1, 1, 1, raw.unit_m])
    return Rectification(one[0], one[1] * scale, other[0], other[1] * scale, stated=True)


def _check_agreement(stated: Rectification, pose: FloatArray, raw: RawRig) -> None:
    """Raise a CalibrationError unless R and T are those that R1, R2, P1 and P2 were made from."""
    implied = stated.pose()
    turn, shift = implied[:3, :3], implied[:3, 3]
    off = float(np.linalg.norm(turn @ pose[:3, :3].T - np.eye(3)))
    apart = float(np.linalg.norm(shift - pose[:3, 3]) / np.linalg.norm(pose[:3, 3]))
    if off > _SAME or apart > _SAME:
        raise CalibrationError(
            f'{raw.where}: R and T contradict R1, R2, P1 and P2: T is'
            f' {_vector(pose[:3, 3])} m, they say {_vector(shift)} m, and the rotations differ by'
            f' {np.degrees(off):.1f} degrees; the pose is inverted or of another calibration: take'
            ' all files from one calibration'
        )


def _vector(values: FloatArray) -> str:
    return '(' + ', '.join(significant(value, 4) for value in values) + ')'


def _in_order(
    first: RawCamera, second: RawCamera, pose: FloatArray
) -> tuple[RawCamera, RawCamera, str]:
    """Return the left and the right camera, and why."""
    across = -pose[:3, :3].T @ pose[:3, 3]
    back = pose[:3, 3]  # centre of the first camera, seen from the second one
    right, down = (across[:2] - back[:2]) / 2
    beside = abs(right) >= abs(down)
    named = {first.side, second.side} == {'left', 'right'}
    if first.side == 'right' if named else beside and right < 0:
        first, second, right, down = second, first, -right, -down
    if not beside:
        return first, second, (
            f'{second.name} stands {significant(abs(down))} m {"below" if down > 0 else "above"}'
            f' it, so {first.name}, {"by its name" if named else "the first one"}, is taken as'
            ' left'
        )  # fmt: skip
    if right < 0:
        raise CalibrationError(
            f'{second.where}: the camera that is named right ({second.name}) stands'
            f' {significant(-right)} m to the left of the one named left ({first.name}); exchange'
            ' the names, or invert the pose if its direction is mistaken'
        )
    reason = 'as their names say' if named else 'by their pose'
    return first, second, f'{second.name} stands {significant(right)} m to its right, {reason}'
