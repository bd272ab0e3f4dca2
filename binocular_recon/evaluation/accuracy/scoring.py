# SPDX-License-Identifier: Apache-2.0
"""Run every method on every scene and measure the results."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.errors import BinocularReconError, FileError, ImageError
from binocular_recon.evaluation.accuracy.error_classes import ClassErrors, class_errors, classify
from binocular_recon.evaluation.accuracy.methods import Method, MethodResult, PeerError
from binocular_recon.evaluation.accuracy.metrics import (
    Accuracy,
    DepthError,
    SigmaBin,
    accuracy,
    depth_errors,
    depth_from_disparity,
    normalised_error_rms,
    sigma_against,
    sigma_bins,
)
from binocular_recon.evaluation.accuracy.parts import Part, parts
from binocular_recon.evaluation.accuracy.scenes import TruthScene
from binocular_recon.evaluation.timing import interleaved

# Rows of a scene that our methods run on before they are timed.
_WARM_UP_ROWS = 64


@dataclass(frozen=True)
class Score:
    """One method on one scene.

    Attributes
    ----------
    method : str
        Its name.
    ours : bool
        True for a preset, False for a peer.
    seconds : float
        Median time from the images to the disparity map.
    everywhere, visible, occluded : Accuracy
        Over all pixels with ground truth, over those that both cameras see, and over the others;
        None where visibility is unknown.
    depth : tuple of DepthError
        By bands of true depth; empty where focal length or baseline is unknown.
    sigma_rms : float or None
        RMS of error / sigma over correctly matched visible pixels; None without sigma.
    sigma : tuple of SigmaBin
        Predicted against measured error over the visible pixels.
    parts : dict of str to Part
        All pixels, and measured and filled ones where the method tells them apart.
    classes : tuple of ClassErrors
        Errors by what makes a pixel hard; empty where visibility is unknown.

    """

    method: str
    ours: bool
    seconds: float
    everywhere: Accuracy
    visible: Accuracy | None
    occluded: Accuracy | None
    depth: tuple[DepthError, ...]
    sigma_rms: float | None
    sigma: tuple[SigmaBin, ...]
    parts: dict[str, Part]
    classes: tuple[ClassErrors, ...]


@dataclass(frozen=True)
class SceneScores:
    """All methods on one scene.

    Attributes
    ----------
    scene, source : str
        Name and origin of the scene.
    width, height : int
        Size of its images, px.
    max_disparity_px : int
        Number of disparities searched.
    truth_percent : float
        Share of pixels with ground truth.
    truth_step_px : float
        Step to which the ground truth is rounded; its variance is added to that of sigma.
    visible_source : str
        Where visibility is known from: `TruthScene.visible_source`.
    scores : tuple of Score
        One for each method, in the methods' order.
    failures : dict of str to str
        Peers that gave no result, by name, and why; their scores have no pixel.

    """

    scene: str
    source: str
    width: int
    height: int
    max_disparity_px: int
    truth_percent: float
    truth_step_px: float
    visible_source: str
    scores: tuple[Score, ...]
    failures: dict[str, str]


@dataclass(frozen=True, eq=False)
class SceneResult:
    """The results of all methods on one scene.

    Attributes
    ----------
    scene : TruthScene
        The scene, with its images.
    scores : SceneScores
        The figures.
    estimates : tuple of MethodResult
        The disparity maps, in the order of the scores.

    """

    scene: TruthScene
    scores: SceneScores
    estimates: tuple[MethodResult, ...]


@dataclass
class Failures:
    """Scenes that could not be evaluated, and why."""

    errors: dict[str, BinocularReconError] = field(default_factory=dict)

    @contextlib.contextmanager
    def of(self, scene: str) -> Iterator[None]:
        """Keep the error that ends the block, if it is one of ours, as this scene's."""
        try:
            yield
        except BinocularReconError as error:
            self.errors[scene] = error

    def raise_if_any(self, scenes: int) -> None:
        """Raise the error of a single failure, or one that names all of them."""
        errors = list(self.errors.values())
        if len(errors) == 1:
            raise errors[0]
        if errors:
            raise FileError(
                f'{len(errors)} of {scenes} scenes could not be evaluated: '
                + '; '.join(str(error) for error in errors)
            )


def evaluate_scene(scene: TruthScene, methods: list[Method], repeat: int = 3) -> SceneResult:
    """Evaluate methods on one scene; the timed runs of all methods take turns.

    Parameters
    ----------
    scene : TruthScene
        Images and ground truth.
    methods : list of Method
        What to compare.
    repeat : int
        Timed rounds.

    Raises
    ------
    ImageError
        If a method refuses the scene; other programs that fail are among the `failures`.

    """
    _compile(scene, methods)
    estimates: dict[str, MethodResult] = {}
    failures: dict[str, str] = {}
    nothing = MethodResult(np.full_like(scene.truth_px, np.nan))

    def keeping(method: Method) -> Callable[[], None]:
        run = method.prepare(scene.left, scene.right, scene.max_disparity_px)

        def keep() -> None:
            if method.name in failures:
                return
            with _naming(scene, method):
                try:
                    estimates[method.name] = run()
                except PeerError as error:
                    failures[method.name] = str(error)
                    estimates[method.name] = nothing

        return keep

    seconds = interleaved({m.name: keeping(m) for m in methods}, repeat, warm_up=0)
    height, width = scene.truth_px.shape
    classes = classify(scene)
    unscored = dataclasses.replace(scene, truth_px=nothing.disparity_px)
    scores = tuple(
        score(unscored, m, nothing, math.nan, classes)
        if m.name in failures
        else score(scene, m, estimates[m.name], seconds[m.name], classes)
        for m in methods
    )
    figures = SceneScores(
        scene.name,
        scene.source,
        width,
        height,
        scene.max_disparity_px,
        100.0 * float(np.isfinite(scene.truth_px).mean()),
        scene.truth_step_px,
        scene.visible_source,
        scores,
        failures,
    )
    return SceneResult(scene, figures, tuple(estimates[m.name] for m in methods))


def score(
    scene: TruthScene,
    method: Method,
    estimate: MethodResult,
    seconds: float,
    classes: npt.NDArray[np.int8] | None,
) -> Score:
    """Measure one estimate against a scene's ground truth; ``classes`` are those of `classify`."""
    disparity_px, truth_px, visible = estimate.disparity_px, scene.truth_px, scene.visible
    depth: list[DepthError] = []
    if scene.focal_baseline is not None:
        estimated, true = (
            depth_from_disparity(values, scene.focal_baseline, scene.offset_px)
            for values in (disparity_px, truth_px)
        )
        depth = depth_errors(estimated, true)
    sigma_px, sigma_rms, sigma = estimate.sigma_px, None, []
    if sigma_px is not None:
        sigma_px = sigma_against(sigma_px, scene.truth_step_px)
        sigma_rms = normalised_error_rms(disparity_px, sigma_px, truth_px, visible)
        sigma = sigma_bins(disparity_px, sigma_px, truth_px, visible)
    return Score(
        method=method.name,
        ours=method.ours,
        seconds=seconds,
        everywhere=accuracy(disparity_px, truth_px),
        visible=None if visible is None else accuracy(disparity_px, truth_px, visible),
        occluded=None if visible is None else accuracy(disparity_px, truth_px, ~visible),
        depth=tuple(depth),
        sigma_rms=sigma_rms,
        sigma=tuple(sigma),
        parts=parts(disparity_px, sigma_px, estimate.measured, truth_px),
        classes=() if classes is None else class_errors(classes, disparity_px, truth_px),
    )


def _compile(scene: TruthScene, methods: list[Method]) -> None:
    """Run our methods on a piece of the scene: the first call of a kernel compiles it."""
    rows = slice(0, _WARM_UP_ROWS)
    for method in methods:
        if method.ours:
            with _naming(scene, method):
                method.prepare(scene.left[rows], scene.right[rows], scene.max_disparity_px)()


@contextlib.contextmanager
def _naming(scene: TruthScene, method: Method) -> Iterator[None]:
    """Say which method failed on which scene."""
    try:
        yield
    except (cv2.error, BinocularReconError) as error:
        raise ImageError(f'scene {scene.name}, {method.name}: {error}') from error
