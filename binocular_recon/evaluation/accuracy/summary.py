# SPDX-License-Identifier: Apache-2.0
"""Tables of an evaluation, as Markdown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from binocular_recon.evaluation.accuracy.metrics import Accuracy
from binocular_recon.evaluation.accuracy.robustness import CropChange, ExposureChange
from binocular_recon.evaluation.accuracy.scoring import SceneScores, Score
from binocular_recon.evaluation.tables import markdown_table
from binocular_recon.number_text import fixed

REGIONS = ('everywhere', 'visible', 'occluded')
# Times are given relative to the first of these that took part.
TIME_REFERENCES = ('StereoSGBM 5 (3WAY) + WLS', 'StereoSGBM 5 (3WAY)')
# Bands of depth with fewer pixels are left out.
MIN_BAND_PIXELS = 100


@dataclass(frozen=True)
class Mean:
    """A method's figures, averaged over scenes.

    Attributes
    ----------
    method : str
        Its name.
    ours : bool
        True for a preset, False for a peer.
    regions : dict of str to Accuracy
        By region (`REGIONS`); ``pixels`` is the sum. A region that no scene knows is absent.
    seconds : float
        Mean time of a scene.
    relative_time : float
        Mean of the time's ratio to the reference's; NaN without a reference.
    scenes : int
        Scenes that it gave a result for; the means are over these.

    """

    method: str
    ours: bool
    regions: dict[str, Accuracy]
    seconds: float
    relative_time: float
    scenes: int


def mean_over_scenes(scenes: Sequence[SceneScores]) -> list[Mean]:
    """Average each method's figures over scenes."""
    names = [score.method for score in scenes[0].scores]
    reference = next((names.index(name) for name in TIME_REFERENCES if name in names), None)
    means = []
    for i, name in enumerate(names):
        finished = [scene for scene in scenes if name not in scene.failures]
        scores = [scene.scores[i] for scene in finished]
        ratios = [
            scene.scores[i].seconds / scene.scores[reference].seconds
            for scene in finished
            if reference is not None
        ]
        regions = {region: _mean_accuracy(scores, region) for region in REGIONS}
        regions['everywhere'] = regions['everywhere'] or scenes[0].scores[i].everywhere
        means.append(
            Mean(
                name,
                scenes[0].scores[i].ours,
                {region: value for region, value in regions.items() if value is not None},
                float(np.mean([score.seconds for score in scores])) if scores else math.nan,
                float(np.mean(ratios)) if ratios else math.nan,
                len(finished),
            )
        )
    return means


def _mean_accuracy(scores: Sequence[Score], region: str) -> Accuracy | None:
    known = [getattr(score, region) for score in scores]
    known = [value for value in known if value is not None and value.pixels]
    if not known:
        return None
    return Accuracy(
        sum(value.pixels for value in known),
        tuple(float(x) for x in np.mean([value.bad_percent for value in known], axis=0)),
        float(np.mean([value.measured_error_px for value in known])),
        float(np.mean([value.mean_error_px for value in known])),
        float(np.mean([value.density_percent for value in known])),
    )


def overview(means: Sequence[Mean]) -> str:
    """Return the main table: every method over all pixels with ground truth."""
    header = ['mean over scenes, all pixels', 'bad-1.0 %', 'bad-2.0 %', 'bad-3.0 %']
    header += ['mean error px', 'of filled pixels px', 'density %', 'time ms', 'relative']
    most, rows = max(mean.scenes for mean in means), []
    for mean in means:
        everywhere = mean.regions['everywhere']
        short = '' if mean.scenes == most else f' ({mean.scenes} of {most} scenes)'
        rows.append(
            [
                mean.method + short,
                *(fixed(bad) for bad in everywhere.bad_percent),
                fixed(everywhere.mean_error_px, 2),
                fixed(everywhere.measured_error_px, 2),
                fixed(everywhere.density_percent),
                fixed(1000 * mean.seconds, 0),
                fixed(mean.relative_time, 2),
            ]
        )
    return markdown_table(header, rows)


def visibility(means: Sequence[Mean]) -> str:
    """Return bad pixels and mean errors of visible and occluded pixels; empty if not known."""
    regions = REGIONS[1:]
    if not all(region in means[0].regions for region in regions):
        return ''
    header = ['mean over scenes']
    for region in regions:
        header += [f'{region}: bad-1.0 %', 'bad-2.0 %', 'mean error px', 'density %']
    rows = []
    for mean in means:
        row = [mean.method]
        for region in regions:
            value = mean.regions.get(region)
            if value is None:
                row += ['-'] * 4
                continue
            row += [fixed(value.bad_percent[0]), fixed(value.bad_percent[1])]
            row += [fixed(value.mean_error_px, 2), fixed(value.density_percent)]
        rows.append(row)
    return markdown_table(header, rows)


def by_scene(scenes: Sequence[SceneScores], threshold: int = 1) -> str:
    """Return bad-2.0 (or another threshold's share) of every method on every scene."""
    header = [f'bad-{threshold + 1}.0 %, all pixels', *(scene.scene for scene in scenes)]
    rows = [
        [
            score.method,
            *(fixed(scene.scores[i].everywhere.bad_percent[threshold]) for scene in scenes),
        ]
        for i, score in enumerate(scenes[0].scores)
    ]
    return markdown_table(header, rows)


def depth_by_band(scenes: Sequence[SceneScores]) -> str:
    """Return the depth error by band of distance, a mean over scenes; empty if none is metric."""
    metric = [scene for scene in scenes if scene.scores[0].depth]
    if not metric:
        return ''
    bands = [(depth.near_m, depth.far_m) for depth in metric[0].scores[0].depth]
    rows = []
    for i, score in enumerate(metric[0].scores):
        row = [score.method]
        for band in range(len(bands)):
            found = [scene.scores[i].depth[band] for scene in metric]
            found = [depth for depth in found if depth.pixels >= MIN_BAND_PIXELS]
            median = np.mean([depth.median_m for depth in found]) if found else math.nan
            p90 = np.mean([depth.p90_m for depth in found]) if found else math.nan
            row.append(f'{fixed(float(median), 3)} / {fixed(float(p90), 2)}')
        rows.append(row)
    header = ['depth error m, median / 90th percentile']
    return markdown_table([*header, *(f'{near:g}-{far:g} m' for near, far in bands)], rows)


def sigma_calibration(scenes: Sequence[SceneScores]) -> str:
    """Return RMS(error / sigma) of our methods on every scene; empty without any of ours."""
    chosen = [i for i, score in enumerate(scenes[0].scores) if score.sigma_rms is not None]
    if not chosen:
        return ''
    header = ['RMS(error / sigma)', *(scene.scene for scene in scenes)]
    rows = [
        [
            scenes[0].scores[i].method,
            *(fixed(scene.scores[i].sigma_rms, 2) for scene in scenes),
        ]
        for i in chosen
    ]
    return markdown_table(header, rows)


def sigma_by_bin(scenes: Sequence[SceneScores]) -> list[str]:
    """Return predicted against measured error, pooled over scenes: a table for each of ours."""
    tables = []
    for i, score in enumerate(scenes[0].scores):
        if not score.sigma:
            continue
        header = [f'{score.method}: predicted sigma px', 'pixels %', 'predicted RMS px']
        header += ['measured RMS px', 'mismatched %']
        total = sum(one.pixels for scene in scenes for one in scene.scores[i].sigma)
        rows = []
        for k, edges in enumerate(score.sigma):
            bins = [
                scene.scores[i].sigma[k] for scene in scenes if scene.scores[i].sigma[k].pixels
            ]
            pixels = np.array([one.pixels for one in bins], float)
            if not bins:
                continue
            wrong = np.array([one.mismatched_percent for one in bins]) / 100
            kept = pixels * (1 - wrong)
            rows.append(
                [
                    _range(edges.low_px, edges.high_px),
                    fixed(100 * pixels.sum() / total),
                    fixed(_pooled_rms([one.predicted_px for one in bins], kept), 3),
                    fixed(_pooled_rms([one.measured_px for one in bins], kept), 3),
                    fixed(100 * float((pixels * wrong).sum() / pixels.sum())),
                ]
            )
        tables.append(markdown_table(header, rows))
    return tables


def _range(low: float, high: float) -> str:
    return f'{low:g} - {high:g}' if math.isfinite(high) else f'{low:g} or more'


def _pooled_rms(values: Sequence[float], weights: object) -> float:
    weight = np.asarray(weights)
    if not weight.sum():
        return math.nan
    return float(np.sqrt(np.nansum(weight * np.square(values)) / weight.sum()))


def exposure_table(changes: Sequence[ExposureChange]) -> str:
    """Return how bad-2.0 changes when the right image is darker; empty if not measured."""
    names = list(dict.fromkeys(change.method for change in changes))
    rows = []
    for name in names:
        mine = [change for change in changes if change.method == name]
        before, after = (
            np.array([getattr(change, key) for change in mine])
            for key in ('bad_percent', 'changed_bad_percent')
        )
        rows.append(
            [
                name,
                *(fixed(float(x)) for x in (before.mean(), after.mean())),
                *(f'{x:+.1f}' for x in ((after - before).mean(), (after - before).max())),
            ]
        )
    header = ['right image darker', 'bad-2.0 % before', 'after', 'change', 'worst scene']
    return markdown_table(header, rows) if rows else ''


def crop_table(changes: Sequence[CropChange]) -> str:
    """Return the largest change of disparity by cropping; empty if not measured."""
    depths = sorted({change.depth_px for change in changes})
    rows = []
    for name in dict.fromkeys(change.method for change in changes):
        row = [name]
        for depth in depths:
            found = [c for c in changes if c.method == name and c.depth_px == depth]
            largest = float(np.nanmax([c.largest_px for c in found]))
            p99 = float(np.nanmean([c.p99_px for c in found]))
            appeared = max(c.appeared_percent for c in found)
            row.append(f'{fixed(largest, 3)} / {fixed(p99, 3)} / {fixed(appeared)}')
        rows.append(row)
    header = [
        'effect of cropping: max px / p99 px / changed fill %',
        *(f'{depth} px inside' for depth in depths),
    ]
    return markdown_table(header, rows) if rows else ''
