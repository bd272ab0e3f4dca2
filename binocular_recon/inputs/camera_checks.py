# SPDX-License-Identifier: Apache-2.0
"""What camera infos may hold: names that mean the same, values that do not matter, and faults."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from binocular_recon.errors import CalibrationError, ImageError
from binocular_recon.lenses.registry import LENSES

FloatArray = npt.NDArray[np.float64]

# Other programs' names of the lens models, in lower case without anything but letters and digits.
_ALIASES = {
    alias: model
    for model, aliases in {
        'plumb_bob': 'plumbbob radtan pinholeradtan radialtangential brown brownconrady opencv',
        'rational_polynomial': 'rational rationalpolynomial',
        'equidistant': 'equidistant equidistant4 equi pinholeequi fisheye opencvfisheye'
        ' kannalabrandt kannalabrandt4',
    }.items()
    for alias in aliases.split()
}
# Names of models that leave a point where it is if all coefficients are 0.
_UNDISTORTED = ('none', 'null', 'pinhole', 'perspective', 'undistorted', 'inversebrownconrady')
# Entries of matrices that must be 0 or 1 may be off by rounding: by this much in px, or in units
# of the last row.
_ROUNDING_PX, _ROUNDING = 0.01, 1e-6
# The principal point of a calibration for this image lies near its middle: within this share of
# the size. Beyond these factors, equal in x and y, the calibration is that of another resolution.
_FAR_SHARE, _SCALES, _SAME = 0.15, (0.72, 1.4), 0.12
# Largest displacement of the optical centres across the baseline, as a share of it, and forward:
# published rectifications of good data have 0.5 % and 3 mm. Rows are off by that share of the
# disparity; from the second share on this is said.
_MOST_ACROSS, _ACROSS, _MOST_AHEAD_M = 0.02, 1e-3, 0.01
# Where P of a rectified pair is alike, files with few digits still agree to this.
_APART_PX = 0.01
# Baselines that rigs have, m.
LEAST_BASELINE_M, LARGEST_BASELINE_M = 0.01, 20.0


def known_lens(name: str, D: FloatArray) -> tuple[str, FloatArray, list[str]]:
    """Return the lens model that a name and its coefficients mean.

    Parameters
    ----------
    name : str
        ``distortion_model`` of a CameraInfo, or another program's name of it; may be empty.
    D : (n,) float64
        Its coefficients; trailing zeros may be missing or too many.

    Returns
    -------
    name : str
        A key of `LENSES`.
    D : (m,) float64
        As many coefficients as it takes.
    notices : list of str
        What was read in another way than it is written.

    Raises
    ------
    CalibrationError
        If the model is unknown or the coefficients are not its own.

    """
    notices: list[str] = []
    if not name and not D.any():  # as simulators leave it
        return 'plumb_bob', np.zeros(5), notices
    plain = re.sub('[^a-z0-9]', '', name.lower())
    found = name if name in LENSES else _ALIASES.get(plain, '')
    if plain in _UNDISTORTED and not D.any():
        return 'plumb_bob', np.zeros(5), [f'distortion model {name!r} is read as no distortion']
    if not name:
        found = next((one for one in LENSES if D.size and D.size in LENSES[one].counts), '')
    if found not in LENSES:
        raise CalibrationError(
            f'distortion model {name!r} is not one of {", ".join(LENSES)}; set the one of the'
            f' calibration (number of coefficients: {D.size})'
        )
    if found != name:
        notices.append(f'distortion model {name!r} is read as {found}')
    counts = [count for count in LENSES[found].counts if count]
    if D.size not in LENSES[found].counts:
        wanted = next((count for count in counts if not D[count:].any()), None)
        rational = {'plumb_bob', 'rational_polynomial'}
        if wanted is not None and (D.size > wanted or not D.any()):
            notices.append(f'{D.size} coefficients of {found} are read as {wanted}: the rest is 0')
        elif found == 'plumb_bob' and D.size in LENSES['rational_polynomial'].counts:
            found, wanted = 'rational_polynomial', D.size
            notices.append(f'plumb_bob with {D.size} coefficients is read as {found}')
        elif found in rational and D.size in LENSES['plumb_bob'].counts:
            wanted = min(counts)  # those that are missing are 0
        else:
            raise CalibrationError(
                f'{found} takes {" or ".join(map(str, LENSES[found].counts))} distortion'
                f' coefficients, got {D.size}'
            )
        D = np.concatenate([D, np.zeros(wanted)])[:wanted]
    return found, D, notices


def check_matrices(K: FloatArray, P: FloatArray) -> None:
    """Raise a CalibrationError if K (3, 3) or P (3, 4) has an entry that no such camera has."""
    if K[0, 0] <= 0 or K[1, 1] <= 0:
        raise CalibrationError(
            f'camera is not calibrated (fx = {K[0, 0]:g}, fy = {K[1, 1]:g} px);'
            ' calibrate it or give a calibration folder'
        )
    if P[0, 0] <= 0 or P[1, 1] <= 0:
        raise CalibrationError(
            f'P is not that of a rectified camera (fx = {P[0, 0]:g},'
            f' fy = {P[1, 1]:g} px); calibrate as a stereo rig'
        )
    for name, matrix in (('P', P), ('K', K)):  # K of a rectified camera is made from its P
        must = {(1, 0): 0.0, (2, 0): 0.0, (2, 1): 0.0, (2, 2): 1.0}
        if name == 'P':
            must[0, 1] = 0.0  # (2, 3) is checked with the other camera's
        for place, value in sorted(must.items()):
            tolerance = _ROUNDING if place[0] == 2 else _ROUNDING_PX
            if abs(matrix[place] - value) > tolerance:
                row, column = place
                raise CalibrationError(
                    f'{name}[{row}, {column}] is {matrix[place]:g}, it must be {value:g};'
                    f' {_meaning(name, place)}'
                )


def _meaning(name: str, place: tuple[int, int]) -> str:
    """Return the remedy for a wrong entry."""
    if place[0] == 2:
        last = '0 0 1' if name == 'K' else '0 0 1 0'
        return f'the last row of {name} is {last}: check the order of its values'
    return f'{name} has the focal lengths and the principal point only: rectify without skew'


def resolution_warning(size: tuple[int, int], K: FloatArray, *, rectified: bool) -> str:
    """Return why K (3, 3) seems to be that of another image, '' if it fits.

    Parameters
    ----------
    size : (int, int)
        Width and height of the image, px.
    K : (3, 3) float64
        Intrinsics of the image.
    rectified : bool
        Whether the image is rectified: rectification may move the principal point.

    """
    width, height = size
    centre = K[:2, 2]
    scales = 2 * centre / (width, height)
    scale = float(scales.mean())
    where = (
        f'the principal point ({centre[0]:.1f}, {centre[1]:.1f}) px is far from the middle of the'
        f' {width}x{height} px image'
    )
    apart = abs(scales[0] - scales[1]) / max(scale, 1e-9)
    if apart < _SAME and not _SCALES[0] < scale < _SCALES[1]:
        return (
            f'{where}, as in a calibration for {scale * width:.0f}x{scale * height:.0f} px'
            f' (scale {scale:.2f}): depth would be {scale:.2f} times what it is; use the'
            ' calibration of this resolution, or state binning once'
        )
    off = np.abs(scales - 1) / 2
    if not rectified and off.max() > _FAR_SHARE:
        return (
            f'{where} ({off.max():.0%} of its size): check that the calibration is for this'
            ' resolution and that binning and region of interest are applied once'
        )
    return ''


def check_image_size(size: tuple[int, int], calibrated: tuple[int, int], name: str) -> None:
    """Raise an ImageError if an image does not have the calibrated size (width, height)."""
    if size != calibrated:
        raise ImageError(
            f'{name} is {size[0]}x{size[1]} px, its calibration is for'
            f' {calibrated[0]}x{calibrated[1]}; {scale_between(size, calibrated)}'
        )


def scale_between(size: tuple[int, int], calibrated: tuple[int, int]) -> str:
    """Return the remedy if an image has another size than its calibration."""
    x, y = size[0] / calibrated[0], size[1] / calibrated[1]
    if math.isclose(x, y, rel_tol=0.01):
        return (
            f'use the calibration of this resolution, or if only the resolution was changed, scale'
            f' K and P by {x:.4g}; if they are those of this resolution, correct the size beside'
            ' them'
        )
    return 'use the calibration of this resolution; the sides differ in scale, so it was cropped'


def baseline_axis(left_P: FloatArray, right_P: FloatArray) -> int:
    """Return along which axis of the image the baseline lies: 0 = rows, 1 = columns."""
    across, down = np.abs(left_P[:2, 3] - right_P[:2, 3])
    return int(down > across)


def check_baseline(left_P: FloatArray, right_P: FloatArray) -> None:
    """Raise a CalibrationError if the P (3, 4) of two cameras are not those of a rectified pair.

    Their baseline lies along the rows, the right camera on the right; or along the columns.
    """
    left, right = left_P[:, 3], right_P[:, 3]
    shift = left - right
    along = baseline_axis(left_P, right_P)
    if abs(shift[1 - along]) > _MOST_ACROSS * max(abs(shift[along]), 1e-9):
        raise CalibrationError(
            f'P_right[1, 3] - P_left[1, 3] is {-shift[1]:g} px m and {-shift[0]:g} px m in'
            ' P[0, 3]; one must be 0: the pair is not rectified; rectify so that the baseline'
            ' lies along rows or columns'
        )
    if max(abs(shift[2]), abs(left[2])) > _MOST_AHEAD_M:
        raise CalibrationError(
            f'P[2, 3] is {left[2]:g} m in the left and {right[2]:g} m in the right camera, it must'
            ' be 0; check the order of the values of P'
        )
    if along == 0:
        _check_sign(left, right, shift[0] / right_P[0, 0])
    others = ('fx, fy and cy', 'fx, fy and cx')[along]
    across = 1 - along
    sides = left_P[across, [across, 2]], right_P[across, [across, 2]]
    focal = left_P[along, along], right_P[along, along]
    if not (np.allclose(*sides, atol=0.5) and math.isclose(*focal, rel_tol=1e-3)):
        raise CalibrationError(
            f'rectified cameras must share {others}, got left {focal[0]:g}, {sides[0]} and right'
            f' {focal[1]:g}, {sides[1]}; rectify them as a pair'
        )


def _check_sign(left: FloatArray, right: FloatArray, baseline_m: float) -> None:
    """Raise a CalibrationError if the right camera is not on the right."""
    if baseline_m > 0:
        return
    if baseline_m == 0:
        why = 'P[0, 3] is the same in both: each was calibrated alone; calibrate as a rig'
    elif left[0]:
        why = (
            f'P_left[0, 3] is {left[0]:g} and P_right[0, 3] {right[0]:g}: left and right are'
            ' exchanged; exchange the cameras (images and camera infos)'
        )
    else:
        why = (
            f'P_right[0, 3] is {right[0]:g}, it must be -f B, below 0; correct its sign, or'
            ' exchange left and right if the right images show the scene from the left'
        )
    raise CalibrationError(f'baseline must be positive, got {baseline_m:g} m: {why}')


def baseline_warnings(left_P: FloatArray, right_P: FloatArray) -> Iterator[str]:
    """Yield what is doubtful about the baseline of a rig with these P (3, 4)."""
    along = baseline_axis(left_P, right_P)
    shift = left_P[:2, 3] - right_P[:2, 3]
    reach, off = abs(shift[along]), abs(shift[1 - along])
    if off > _ACROSS * reach:
        yield (
            f'P[{1 - along}, 3] of left and right differ by {off:g} px m, so'
            f' {("rows", "columns")[along]} are off by {off / reach:.2%} of the disparity; rectify'
            ' again'
        )
    across = 1 - along
    sides = ((along, along), (across, across), (across, 2))
    apart_px = max(abs(left_P[place] - right_P[place]) for place in sides)
    if apart_px > _APART_PX:
        yield (
            f'P of left and right differ by {apart_px:.2g} px where a rectified pair has the same'
            ' (focal lengths, principal point across the baseline): they are of two calibrations;'
            ' take both from one'
        )
    baseline_m = reach / right_P[along, along]
    if LEAST_BASELINE_M <= baseline_m <= LARGEST_BASELINE_M:
        return
    entry = f'P[{along}, 3]'
    if baseline_m > LARGEST_BASELINE_M:
        remedy = f'if it is in millimetres, divide {entry} by 1000 ({baseline_m / 1000:g} m)'
    elif LEAST_BASELINE_M <= reach <= LARGEST_BASELINE_M:
        remedy = f'if {entry} is the baseline itself ({reach:g}), multiply it by the focal length'
    else:
        remedy = f'check the unit of {entry}'
    yield (
        f'the baseline is {baseline_m:g} m, outside {LEAST_BASELINE_M:g} to'
        f' {LARGEST_BASELINE_M:g} m: {remedy}; depths are proportional to it'
    )
