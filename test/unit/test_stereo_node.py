# SPDX-License-Identifier: Apache-2.0
"""What a node does with a frame that it cannot process."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from binocular_recon.errors import CalibrationError, ImageError

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    ('error', 'dropped', 'text'),
    [
        (ImageError('too dark'), 'bad input', 'too dark'),
        (CalibrationError('no K'), 'bad calibration', 'no K'),
        (
            MemoryError('Unable to allocate 9 GiB'),
            'not enough memory',
            'Unable to allocate 9 GiB; choose a smaller disparity_range or smaller pictures',
        ),
        (ZeroDivisionError('fault'), 'internal error', 'ZeroDivisionError: fault'),
    ],
)
def test_a_frame_that_fails_is_counted_and_said(error: Exception, dropped: str, text: str) -> None:
    from binocular_recon.nodes.stereo_node import StereoNode

    node: Any = SimpleNamespace(
        process=Mock(side_effect=error), health=Mock(), context=Mock(), _processed=0
    )
    StereoNode._work(node, ('left', 'right'))
    node.health.dropped.assert_called_once_with(dropped)
    assert text in node.health.error.call_args.args[0]
    assert node._processed == 0
