# SPDX-License-Identifier: Apache-2.0
"""The matcher 'onnx': networks made here, their conventions, and each way they do not fit."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from binocular_recon.cli.main import main
from binocular_recon.config import ChainConfig, MatchConfig
from binocular_recon.errors import ConfigError, DependencyError, FileError
from binocular_recon.images import FloatImage
from binocular_recon.io.pfm import read_pfm
from binocular_recon.options import OptionValue
from binocular_recon.stereo import estimate_disparity, match
from binocular_recon.stereo.foreign.onnx_model import NetworkError
from binocular_recon.stereo.validity import Validity
from test.tiny_networks import block_matcher, graph, node, onnx

ROWS, COLUMNS, SHIFT = 40, 90, 6
FREE = ['n', 3, 'h', 'w']
BGR = tuple[np.ndarray, np.ndarray]


@pytest.fixture(scope='module')
def pair() -> BGR:
    """Return colour images of a wall of disparity 6 px, with a black bar at columns 50..59."""
    random = np.random.default_rng(2)
    wide = random.integers(40, 256, (ROWS, COLUMNS + SHIFT, 3)).astype(np.uint8)
    wide[:, 50:60] = 0
    return wide[:, :COLUMNS].copy(), wide[:, SHIFT:].copy()


@pytest.fixture
def config(tmp_path: Path) -> Callable[..., MatchConfig]:
    """Return a function that saves a network and makes the options that choose it."""

    def make(model: Any, **options: OptionValue) -> MatchConfig:
        path = tmp_path / 'network.onnx'
        onnx.save(model, str(path))
        given = {'disparity_range': 16, 'onnx_multiple': 8, **options}
        return MatchConfig(matcher='onnx', onnx_model=str(path), **given)  # type: ignore[arg-type]

    return make


def grey(image: np.ndarray) -> FloatImage:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.float32)


def matched(pair: BGR, config: MatchConfig) -> Any:
    return match(grey(pair[0]), grey(pair[1]), config, lambda: pair)


def test_a_network_matches_and_is_checked(pair: BGR, config: Callable[..., MatchConfig]) -> None:
    result = matched(pair, config(block_matcher(FREE)))
    assert result.disparity_px.shape == (ROWS, COLUMNS)
    right_of_border = np.s_[4:-4, SHIFT + 3 : -3]
    found = result.disparity_px[right_of_border]
    textured = np.ones(found.shape, bool)
    textured[:, 50 - SHIFT - 3 - 4 : 60 - SHIFT - 3 + 4] = False
    assert np.mean(found[textured] == SHIFT) > 0.99
    # what the right camera does not see has no disparity; all others tell measured from rejected
    assert np.isnan(result.disparity_px[:, :SHIFT]).mean() > 0.9
    measured = result.validity == Validity.MEASURED
    assert np.array_equal(measured, np.isfinite(result.disparity_px))
    assert np.array_equal(measured, result.confidence > 0)
    # sigma of sure pixels is below 0.3 px: confidence above 0.4
    assert np.median(result.confidence[right_of_border][textured]) > 0.4


def test_without_the_left_right_check_the_network_runs_once(
    pair: BGR, config: Callable[..., MatchConfig], monkeypatch: pytest.MonkeyPatch
) -> None:
    from binocular_recon.stereo.foreign.onnx_model import StereoNetwork

    calls, original = [], StereoNetwork.disparity

    def counted(self: StereoNetwork, *arguments: Any) -> FloatImage:
        calls.append(1)
        return original(self, *arguments)

    monkeypatch.setattr(StereoNetwork, 'disparity', counted)
    checked, unchecked = (
        matched(pair, config(block_matcher(FREE), disp12_max_diff=limit)) for limit in (1.0, -1.0)
    )
    assert len(calls) == 3
    assert unchecked.matched_share > checked.matched_share


@pytest.mark.parametrize(
    ('shape', 'inputs', 'options'),
    [
        (FREE, 2, {'onnx_output': 'flow', 'onnx_output_scale': -1.0}),
        (['n', 6, 'h', 'w'], 1, {}),
        (['n', 1, 'h', 'w'], 2, {'onnx_channels': 'grey'}),
        ([1, 3, 48, 96], 2, {'onnx_multiple': 1}),
        (FREE, 2, {'onnx_scale': 1 / 255, 'onnx_mean': '0.4, 0.5,0.6', 'onnx_std': '0.2'}),
    ],
)
def test_conventions_of_networks(
    pair: BGR,
    config: Callable[..., MatchConfig],
    shape: list[Any],
    inputs: int,
    options: dict[str, OptionValue],
) -> None:
    result = matched(pair, config(block_matcher(shape, inputs=inputs), **options))
    inner = result.disparity_px[4:-4, 16:40]
    assert np.mean(inner == SHIFT) > 0.98


def test_levels_reach_the_network_in_its_order(
    pair: BGR, config: Callable[..., MatchConfig]
) -> None:
    """A network that returns a channel of its left input shows what it got."""
    from binocular_recon.stereo.foreign.onnx_model import load_network

    pick = onnx.numpy_helper.from_array(np.array([0]), 'pick')
    picked = node('Gather', ['left', 'pick'], ['picked'], axis=3)
    used = node('Identity', ['right'], ['unused'])
    model = graph([picked, used], ['left', 'right'], ['n', 'h', 'w', 3], ['picked'], [pick])
    floats = [np.asarray(image, np.float32) for image in pair]
    for channels, index in (('bgr', 0), ('rgb', 2)):
        made = config(
            model,
            onnx_layout='nhwc',
            onnx_channels=channels,
            onnx_scale=0.5,
            onnx_mean='10,0,0',
            onnx_std='4,1,1',
        )
        seen = load_network(Path(made.onnx_model)).disparity(floats[0], floats[1], made)
        np.testing.assert_allclose(seen, (floats[0][..., index] * 0.5 - 10) / 4, atol=1e-4)


def test_a_command_runs_a_network(
    pair: BGR, config: Callable[..., MatchConfig], tmp_path: Path
) -> None:
    made = config(block_matcher(FREE))
    files = [str(tmp_path / f'{name}.png') for name in ('left', 'right')]
    for name, image in zip(files, pair, strict=True):
        cv2.imwrite(name, image)
    output = tmp_path / 'd.pfm'
    words = ['--output', str(output), '--max-disparity', '15', '--matcher', 'onnx']
    words += ['--onnx-model', made.onnx_model, '--onnx-multiple', '8']
    assert main(['match', *files, *words]) == 0
    dense = read_pfm(output)
    assert np.isfinite(dense).all()
    assert np.median(np.abs(dense - SHIFT)) < 0.05


def test_the_chain_filters_a_network(pair: BGR, config: Callable[..., MatchConfig]) -> None:
    made = config(block_matcher(FREE))
    chain = ChainConfig(match=made)
    result = estimate_disparity(*pair, chain, check_range=False)
    assert np.median(np.abs(result.filtered.disparity_px - SHIFT)) < 0.05
    assert (result.filtered.sigma_px > 0).all()


def _nan() -> Any:
    nodes = [node('Sub', ['left', 'right'], ['zero']), node('Log', ['negative'], ['nan'])]
    nodes.insert(1, node('Sub', ['zero', 'big'], ['negative']))
    nodes.append(node('ReduceMean', ['nan'], ['disparity'], axes=[1], keepdims=1))
    big = onnx.numpy_helper.from_array(np.array(1e6, np.float32), 'big')
    return graph(nodes, ['left', 'right'], FREE, ['disparity'], [big])


def _small() -> Any:
    nodes = [
        node('Sub', ['left', 'right'], ['difference']),
        node('MaxPool', ['difference'], ['half'], kernel_shape=[2, 2], strides=[2, 2]),
    ]
    return graph(nodes, ['left', 'right'], FREE, ['half'])


def _three() -> Any:
    nodes = [node('Sum', ['left', 'right', 'more'], ['sum'])]
    return graph(nodes, ['left', 'right', 'more'], FREE, ['sum'])


@pytest.mark.parametrize(
    ('model', 'options', 'message'),
    [
        (_three, {}, r'has 3 inputs \(left, right, more\); it must have two'),
        (
            lambda: block_matcher([1, 3, 32, 64]),
            {},
            r'input left takes 1x3x32x64 and gets 1x3x40x90; set onnx_channels',
        ),
        (lambda: block_matcher(FREE), {'onnx_channels': 'grey'}, 'and gets 1x1x40x90'),
        (lambda: block_matcher(FREE), {'onnx_layout': 'nhwc'}, 'and gets 1x40x90x3'),
        (_nan, {}, 'output disparity has no finite value; check onnx_scale'),
        (_small, {}, r'output half is float32 of 1x3x20x48; it must be a disparity for each of'),
        (lambda: block_matcher(FREE), {'onnx_output': 'depth'}, "has no output 'depth'; it has"),
        (
            lambda: graph(
                [node('Concat', ['left', 'odd'], ['disparity'], axis=3)],
                ['left', 'right'],
                FREE,
                ['disparity'],
                [onnx.numpy_helper.from_array(np.zeros((1, 3, 7, 1), np.float32), 'odd')],
            ),
            {},
            'cannot be run',
        ),
    ],
)
def test_networks_that_do_not_fit_are_one_error(
    pair: BGR,
    config: Callable[..., MatchConfig],
    model: Callable[[], Any],
    options: dict[str, OptionValue],
    message: str,
) -> None:
    with pytest.raises(NetworkError, match=message):
        matched(pair, config(model(), **options))


def test_files_that_are_no_network_are_one_error(
    pair: BGR, config: Callable[..., MatchConfig]
) -> None:
    made = config(block_matcher(FREE))
    path = Path(made.onnx_model)
    whole = path.read_bytes()
    for damaged in (whole[: len(whole) // 2], b'', b'no network'):
        path.write_bytes(damaged)
        with pytest.raises(FileError, match='is damaged, or no network that onnxruntime'):
            matched(pair, made)
    path.unlink()
    with pytest.raises(FileError, match='cannot be read: No such file'):
        matched(pair, made)
    path.mkdir()
    with pytest.raises(FileError, match='is damaged, or no network'):
        matched(pair, made)
    path.rmdir()
    path.write_bytes(whole)  # a changed file is loaded again
    assert matched(pair, made).matched_share > 0.5


def test_a_missing_onnxruntime_names_the_extra(
    pair: BGR, config: Callable[..., MatchConfig], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = config(block_matcher(FREE))
    monkeypatch.setitem(sys.modules, 'onnxruntime', None)
    with pytest.raises(DependencyError, match=r"pip install 'binocular_recon\[onnx\]'"):
        matched(pair, made)


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        ({'onnx_model': ''}, 'matcher onnx needs onnx_model'),
        ({'onnx_mean': '1,2'}, "onnx_mean must be a number, or three with commas, got '1,2'"),
        ({'onnx_mean': 'none'}, "onnx_mean must be a number, or three with commas, got 'none'"),
        ({'onnx_std': '1,0,1'}, "onnx_std must be above 0, got '1,0,1'"),
        ({'onnx_std': '1,1,1', 'onnx_channels': 'grey'}, 'onnx_std must be a number, got'),
        ({'onnx_output_scale': 0.0}, 'onnx_output_scale must not be 0'),
    ],
)
def test_conventions_that_make_no_sense_are_refused(
    options: dict[str, OptionValue], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        ChainConfig.preset('default', **{'matcher': 'onnx', 'onnx_model': 'x.onnx', **options})
