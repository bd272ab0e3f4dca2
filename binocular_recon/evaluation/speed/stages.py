# SPDX-License-Identifier: Apache-2.0
"""What the benchmark times: each stage of the chain next to what OpenCV or SciPy has for it.

Each function returns contestants by name, ready to be called; the first is the reference that
the others' times are divided by.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from binocular_recon.camera import Camera, StereoRig
from binocular_recon.config import ChainConfig
from binocular_recon.evaluation import peers
from binocular_recon.evaluation.speed.content import Content, Pair, Size
from binocular_recon.images import FloatImage, Image, to_grey
from binocular_recon.stereo.filtering.wls_filter import (
    DisparityFilter,
    Filtered,
    filter_disparity,
)
from binocular_recon.stereo.matching import Match, match
from binocular_recon.stereo.pipeline import Chain
from binocular_recon.stereo.rectification import Rectifier
from binocular_recon.stereo.triangulation import triangulate
from binocular_recon.stereo.validity import Validity

Contestants = dict[str, Callable[[], object]]

SGBM = peers.OpenCvMatcher('sgbm_3way')
SGBM_WLS = peers.OpenCvMatcher('sgbm_3way', peers.WLS_LAMBDA)

# A rig of 1 m baseline with the field of view and the distortion of a common lens.
_FOCAL_PER_WIDTH = 0.86
_BASELINE_M = 1.0
_DISTORTION = np.array([-0.12, 0.05, 4e-4, -3e-4, 0.0])

# Grey levels of 255 by which two images of a still scene differ.
_FRAME_NOISE = 2.0


@dataclass(frozen=True, eq=False)
class Bench:
    """Input of all stages on one content.

    Attributes
    ----------
    content : Content
        The pair and its size.
    presets : sequence of str
        Presets that take part.

    """

    content: Content
    presets: Sequence[str]

    @property
    def size(self) -> Size:
        """Size of the content."""
        return self.content.size

    @cached_property
    def pair(self) -> Pair:
        """The images, rectified."""
        return self.content.pair()

    @cached_property
    def recorded(self) -> tuple[Image, Image]:
        """The images as the cameras of the rig would record them."""
        (left, right), rig = self.pair, self.rig
        return recorded_image(left, rig.left), recorded_image(right, rig.right)

    @cached_property
    def rig(self) -> StereoRig:
        """A rig whose cameras have this size and some distortion."""
        width, height = self.size.width, self.size.height
        focal = _FOCAL_PER_WIDTH * width
        K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
        P_left = np.column_stack([K, np.zeros(3)])
        P_right = np.column_stack([K, (-focal * _BASELINE_M, 0, 0)])
        return StereoRig(
            *(Camera(width, height, K, _DISTORTION, np.eye(3), P) for P in (P_left, P_right))
        )

    @cached_property
    def grey(self) -> tuple[FloatImage, FloatImage]:
        """The images as our stages take them."""
        return to_grey(self.pair[0]), to_grey(self.pair[1])

    @cached_property
    def matches(self) -> dict[str, Match]:
        """What each preset's matching makes of the images."""
        return {name: match(*self.grey, self.config(name).match) for name in self.presets}

    @cached_property
    def filtered(self) -> dict[str, Filtered]:
        """What each preset's filter makes of its matches."""
        return {name: self._filtered(name) for name in self.presets}

    @property
    def iterations(self) -> dict[str, int]:
        """Iterations of each preset's solver."""
        return {name: filtered.iterations for name, filtered in self.filtered.items()}

    def _filtered(self, preset: str) -> Filtered:
        matched, config = self.matches[preset], self.config(preset)
        images = matched.disparity_px, matched.confidence, self.grey[0]
        return filter_disparity(*images, config.filter, limits_px=config.match.limits_px)

    def config(self, preset: str) -> ChainConfig:
        """Return a preset's options with this size's search range."""
        return ChainConfig.preset(
            preset, min_disparity=0, disparity_range=self.size.disparity_range
        )


def matching(bench: Bench) -> Contestants:
    """From two grey images to a disparity map; ours both directions with all checks."""
    left, right = (peers.to_bytes(image) for image in bench.pair)
    guide, search = bench.pair[0], bench.size.disparity_range

    def opencv(matcher: peers.OpenCvMatcher) -> Callable[[], object]:
        compute = matcher.prepare(search)
        return lambda: compute(left, right, guide)

    def ours(preset: str) -> Callable[[], object]:
        config = bench.config(preset).match
        return lambda: match(*bench.grey, config)

    rivals = [SGBM, peers.OpenCvMatcher('bm'), peers.OpenCvMatcher('sgbm')]
    return {
        **{rival.name: opencv(rival) for rival in rivals},
        **{name: ours(name) for name in bench.presets},
    }


def filtering(bench: Bench) -> Contestants:
    """From measured disparities to a dense map.

    ximgproc's filter is an approximation (separable passes along rows and columns). Its time
    holds the left-right check that gives it its weights, and the solutions for disparity and
    weight; ours the completion of holes, links, setting up and solving to the tolerance, and the
    standard deviation. Both work with an object made beforehand. The warm runs follow a frame
    that differs by its noise, as in a video of a still scene.
    """
    contestants: Contestants = {}
    if peers.has_ximgproc():
        contestants['ximgproc DisparityWLSFilter'] = _ximgproc_filter(bench)
    for preset in bench.presets:
        contestants[preset] = _our_filter(bench, preset)
        contestants[f'{preset}, warm'] = _our_filter(bench, preset, warm=True)
    return contestants


def _ximgproc_filter(bench: Bench) -> Callable[[], object]:
    left, right = (peers.to_bytes(image) for image in bench.pair)
    guide = bench.pair[0]
    matcher = SGBM.matcher(bench.size.disparity_range)
    wls = peers.wls_filter(matcher)
    disparity = matcher.compute(left, right)
    mirrored = cv2.ximgproc.createRightMatcher(matcher).compute(right, left)
    return lambda: wls.filter(disparity, guide, disparity_map_right=mirrored)


def _our_filter(bench: Bench, preset: str, *, warm: bool = False) -> Callable[[], object]:
    config, guide = bench.config(preset), bench.grey[0]
    wls, limits_px = DisparityFilter(config.filter), config.match.limits_px

    def run(matched: Match, initial: FloatImage | None) -> FloatImage:
        images = matched.disparity_px, matched.confidence, guide
        return wls(*images, limits_px=limits_px, initial=initial).disparity_px

    initial = None
    if warm:
        random = np.random.default_rng(1)
        left, right = (
            image + random.normal(0, _FRAME_NOISE, image.shape).astype(np.float32)
            for image in bench.grey
        )
        initial = run(match(left, right, config.match), None)
    return lambda: run(bench.matches[preset], initial)


def rectifying(bench: Bench) -> Contestants:
    """Both images of a pair, maps made beforehand."""
    left, right = bench.recorded
    remap = _remap(bench.rig)
    rectifier = Rectifier(bench.rig)
    return {'cv2.remap': lambda: remap(left, right), 'Rectifier': lambda: rectifier(left, right)}


def triangulating(bench: Bench) -> Contestants:
    """From a dense disparity map to points; ours with the standard deviation of each depth."""
    disparity_px = bench.filtered[bench.presets[0]].disparity_px
    sigma_px = np.full_like(disparity_px, 0.1)
    validity = np.full(disparity_px.shape, Validity.MEASURED, np.uint8)
    Q = _reprojection(bench.rig)
    config = bench.config(bench.presets[0]).cloud
    return {
        'cv2.reprojectImageTo3D': lambda: cv2.reprojectImageTo3D(disparity_px, Q),
        'triangulate': lambda: triangulate(disparity_px, sigma_px, validity, bench.rig, config),
    }


def chain(bench: Bench) -> Contestants:
    """From two colour images as a camera gives them to the cloud."""
    left, right = bench.recorded
    contestants: Contestants = {}
    if peers.has_ximgproc():
        contestants['remap, SGBM 3WAY x 2, WLS, reprojectImageTo3D'] = _opencv_chain(bench)
    for preset in bench.presets:
        ours = Chain(bench.rig, bench.config(preset))
        contestants[preset] = lambda ours=ours: ours(left, right)  # type: ignore[misc]
    return contestants


def _opencv_chain(bench: Bench) -> Callable[[], object]:
    remap, Q = _remap(bench.rig), _reprojection(bench.rig)
    compute = SGBM_WLS.prepare(bench.size.disparity_range)

    def run() -> object:
        left, right = remap(*bench.recorded)
        grey_left, grey_right = (
            cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in (left, right)
        )
        disparity = compute(grey_left, grey_right, left)
        return cv2.reprojectImageTo3D(disparity.astype(np.float32) / 16, Q)

    return run


def recorded_image(image: Image, camera: Camera) -> Image:
    """Return a rectified image as its camera would record it."""
    columns, rows = np.meshgrid(*(np.arange(length, dtype=np.float64) for length in camera.size))
    recorded = np.stack([columns.ravel(), rows.ravel()], axis=-1)
    rectified = cv2.undistortPoints(recorded, camera.K, camera.D, R=camera.R, P=camera.P)
    places = rectified.reshape(*image.shape[:2], 2).astype(np.float32)
    return np.asarray(
        cv2.remap(image, places, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
    )


def _remap(rig: StereoRig) -> Callable[[Image, Image], list[Image]]:
    maps = [
        cv2.initUndistortRectifyMap(c.K, c.D, c.R, c.P[:, :3], c.size, cv2.CV_16SC2)
        for c in (rig.left, rig.right)
    ]
    return lambda *images: [
        cv2.remap(image, *pair, cv2.INTER_LINEAR) for image, pair in zip(images, maps, strict=True)
    ]


def _reprojection(rig: StereoRig) -> Image:
    """Return OpenCV's Q, which turns (column, row, disparity, 1) into homogeneous points."""
    cx, cy = rig.left.P[0, 2], rig.left.P[1, 2]
    return np.array(
        [
            [1.0, 0, 0, -cx],
            [0, 1, 0, -cy],
            [0, 0, 0, rig.focal_px],
            [0, 0, 1 / rig.baseline_m, -rig.disparity_offset_px / rig.baseline_m],
        ]
    )
