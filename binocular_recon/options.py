# SPDX-License-Identifier: Apache-2.0
"""Declare options: dataclass fields that carry their description, unit and limits."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import field
from typing import Any

from binocular_recon.errors import ConfigError, shortened

OptionValue = bool | int | float | str
# What the types are called in messages.
KINDS = {bool: 'true or false', int: 'a whole number', float: 'a number', str: 'text'}


def option(
    default: OptionValue,
    description: str,
    *,
    unit: str = '',
    minimum: float | None = None,
    maximum: float | None = None,
    step: int | None = None,
    choices: Sequence[str] | None = None,
) -> Any:
    """Declare an option: return a dataclass field with its description, unit and limits.

    Parameters
    ----------
    default : bool, int, float or str
        Default value; its type is the option's type.
    description : str
        One sentence for the user, without the unit.
    unit : str
        Unit of the value; empty for a pure number.
    minimum, maximum : float, optional
        Limits of a number, both included.
    step : int, optional
        An integer option accepts only ``minimum + k * step``.
    choices : sequence of str, optional
        Accepted values of a string option. A list stays open: what is appended to it later is
        accepted too.

    """
    metadata = {
        'description': description,
        'unit': unit,
        'minimum': minimum,
        'maximum': maximum,
        'step': step,
        'choices': choices,
    }
    return field(default=default, metadata=metadata)


def check_option(spec: dataclasses.Field[Any], value: object) -> OptionValue:
    """Return ``value`` as the option's type, or raise a ConfigError that names what is allowed."""
    kind = type(spec.default)
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    meta = spec.metadata
    if meta['choices'] is not None and value not in meta['choices']:
        raise ConfigError(
            f'{spec.name} must be one of {", ".join(meta["choices"])}, got {shortened(value)}'
        )
    if type(value) is not kind:
        raise ConfigError(f'{spec.name} must be {KINDS[kind]}, got {shortened(value)}')
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        low, high, step = meta['minimum'], meta['maximum'], meta['step']
        unit = f' {meta["unit"]}' if meta['unit'] else ''
        # `not (>=)` refuses NaN too
        if (low is not None and not value >= low) or (high is not None and not value <= high):
            raise ConfigError(f'{spec.name} must be within {low}..{high}{unit}, got {value}')
        if step is not None and (value - (low or 0)) % step:
            raise ConfigError(
                f'{spec.name} must be {low} plus a multiple of {step}{unit}, got {value}'
            )
    return value  # type: ignore[return-value]


class Options:
    """Base of option groups: checks every field when constructed."""

    def __post_init__(self) -> None:
        """Check each option against its limits."""
        for spec in dataclasses.fields(self):  # type: ignore[arg-type]
            object.__setattr__(self, spec.name, check_option(spec, getattr(self, spec.name)))
