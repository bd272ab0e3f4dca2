# SPDX-License-Identifier: Apache-2.0
"""Networks small enough to be built by a test, which find disparities all the same."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

onnx = pytest.importorskip('onnx', reason='the extra onnx is not installed')
pytest.importorskip('onnxruntime', reason='the extra onnx is not installed')


def block_matcher(shape: list[Any], disparities: int = 10, *, inputs: int = 2) -> Any:
    """Return a network that picks the disparity with the least sum of differences over 5x5.

    A small stereo network: it shifts the right image, takes absolute differences, sums them over
    windows and channels by a convolution, and takes the least.
    """
    helper, numbers = onnx.helper, onnx.numpy_helper
    channels = shape[1] if inputs == 2 else shape[1] // 2
    nodes, constants, costs = [], [], []

    def constant(name: str, values: Any, kind: Any = np.int64) -> str:
        constants.append(numbers.from_array(np.asarray(values, kind), name))
        return name

    names = ['left', 'right']
    if inputs == 1:
        for at, name in enumerate(names):
            first = constant(f'first_{name}', [at * channels])
            last = constant(f'last_{name}', [(at + 1) * channels])
            nodes.append(helper.make_node('Slice', ['pair', first, last, 'channel'], [name]))
        constant('channel', [1])
    constant('columns', [3])
    constant('window', np.ones((1, channels, 5, 5)), np.float32)
    constant('nothing', 1e3, np.float32)
    constant('zero', [0])
    for d in range(disparities):
        # columns move to the right: pixel x gets the right image's pixel x - d
        pads = constant(f'pads{d}', [0, 0, 0, d, 0, 0, 0, -d])
        nodes += [
            helper.make_node('Pad', ['right', pads, 'nothing'], [f'moved{d}']),
            helper.make_node('Sub', ['left', f'moved{d}'], [f'step{d}']),
            helper.make_node('Abs', [f'step{d}'], [f'size{d}']),
            helper.make_node('Conv', [f'size{d}', 'window'], [f'cost{d}'], pads=[2, 2, 2, 2]),
        ]
        costs.append(f'cost{d}')
    nodes += [
        helper.make_node('Concat', costs, ['costs'], axis=1),
        helper.make_node('ArgMin', ['costs'], ['best'], axis=1, keepdims=1),
        helper.make_node('Cast', ['best'], ['disparity'], to=onnx.TensorProto.FLOAT),
        helper.make_node('Neg', ['disparity'], ['flow']),
    ]
    return graph(
        nodes, ['pair'] if inputs == 1 else names, shape, ['disparity', 'flow'], constants
    )


def graph(
    nodes: list[Any],
    inputs: list[str],
    shape: list[Any],
    outputs: list[str],
    constants: list[Any] | None = None,
) -> Any:
    helper, kind = onnx.helper, onnx.TensorProto.FLOAT
    made = helper.make_graph(
        nodes,
        'network',
        [helper.make_tensor_value_info(name, kind, shape) for name in inputs],
        [helper.make_tensor_value_info(name, kind, None) for name in outputs],
        constants or [],
    )
    opset = [helper.make_opsetid('', 13)]
    return helper.make_model(made, opset_imports=opset, ir_version=8)


def node(kind: str, inputs: list[str], outputs: list[str], **attributes: Any) -> Any:
    return onnx.helper.make_node(kind, inputs, outputs, **attributes)
