# SPDX-License-Identifier: Apache-2.0
"""Numbers for people have the digits asked for and no exponent."""

from __future__ import annotations

import math

import numpy as np
import pytest

from binocular_recon.number_text import day_text, fixed, plain, significant


@pytest.mark.parametrize(
    ('value', 'digits', 'text'),
    [
        (0.00012, 2, '0.00012'),
        (0.4, 2, '0.40'),
        (9.996, 3, '10.0'),
        (0.0999, 2, '0.10'),
        (38.46, 3, '38.5'),
        (-38.46, 3, '-38.5'),
        (101.4, 3, '101'),
        (12345.6, 3, '12346'),
        (3e9, 2, '3000000000'),
        (1e-9, 1, '0.000000001'),
        (0.0, 3, '0'),
        (math.nan, 3, '-'),
        (math.inf, 3, 'none'),
        (None, 3, '-'),
    ],
)
def test_significant_digits(value: float | None, digits: int, text: str) -> None:
    assert significant(value, digits) == text


def test_significant_digits_are_those_of_the_number() -> None:
    rng = np.random.default_rng(0)
    for value in rng.normal(size=300) * 10.0 ** rng.integers(-8, 8, 300):
        text = significant(value, 3)
        assert 'e' not in text
        assert len(text.lstrip('-0.').replace('.', '')) >= 3
        assert float(text) == pytest.approx(value, rel=5.001e-3)


def test_columns_of_a_table() -> None:
    assert [fixed(value, 2) for value in (1.005, -3.0, None, math.nan, math.inf)] == [
        '1.00', '-3.00', '-', '-', 'none',
    ]  # fmt: skip
    assert fixed(1e7) == '10000000.0'


@pytest.mark.parametrize(
    ('value', 'text'),
    [
        (15.0, '15'),
        (0.1 + 0.2, '0.3'),
        (-0.0, '0'),
        (2.5e-5, '0.000025'),
        (1e7, '10000000'),
        (1655.1234567, '1655.12'),
    ],
)
def test_round_numbers_have_no_more_digits_than_they_need(value: float, text: str) -> None:
    assert plain(value) == text


def test_days_are_said_in_english_and_other_texts_stay() -> None:
    assert day_text('2026-11-28') == '28 November 2026'
    assert day_text('2026-01-02T23:59:59+00:00') == '2 January 2026'
    assert day_text('last week') == 'last week'
