# SPDX-License-Identifier: Apache-2.0
"""The documentation says what the code does."""

from __future__ import annotations

import importlib.util

import pytest

from test.conftest import REPOSITORY


@pytest.mark.ros
def test_nodes_page_is_what_the_nodes_declare() -> None:
    spec = importlib.util.spec_from_file_location(
        'make_nodes', REPOSITORY / 'docs' / 'make_nodes.py'
    )
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.PAGE.read_text() == module.page(), 'run make docs'
