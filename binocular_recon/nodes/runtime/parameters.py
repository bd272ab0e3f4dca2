# SPDX-License-Identifier: Apache-2.0
"""Declare ROS parameters from option groups, so that an option is described in one place."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from binocular_recon.config import PRESETS
from binocular_recon.errors import ConfigError
from binocular_recon.options import Options, OptionValue, check_option

Spec = dataclasses.Field[Any]
Group = TypeVar('Group', bound=Options)


class Parameters:
    """The parameters of a node.

    A value that the user sets, by file, command line or service, survives a change of ``preset``;
    all others follow the preset.

    Parameters
    ----------
    node : Node
        Node that declares them.
    live : iterable of Options types
        Groups that may change while the node runs.
    fixed : iterable of Options types
        Groups that are read when the node starts.

    Raises
    ------
    ConfigError
        If a value given at the start is not valid.

    """

    def __init__(
        self, node: Node, *, live: Iterable[type[Options]], fixed: Iterable[type[Options]] = ()
    ) -> None:
        self._groups = [*live, *fixed]
        self._specs = {spec.name: spec for group in self._groups for spec in _fields(group)}
        self._explicit: set[str] = set()
        self._from_preset: set[str] = set()
        self._values: dict[str, OptionValue] = {}
        read_only = {spec.name for group in fixed for spec in _fields(group)}
        for name in sorted(self._specs, key=lambda name: name != 'preset'):
            self._declare(node, name, read_only=name in read_only)
        self._check(self._values)
        node.add_pre_set_parameters_callback(self._add_preset)
        node.add_on_set_parameters_callback(self._validate)
        node.add_post_set_parameters_callback(self._accept)

    def of(self, group: type[Group]) -> Group:
        """Return the current values of one group; the defaults of one that is not declared."""
        values = self._values  # another thread may replace it, as a whole
        names = (spec.name for spec in _fields(group))
        return group(**{name: values[name] for name in names if name in values})

    def _declare(self, node: Node, name: str, *, read_only: bool) -> None:
        spec = self._specs[name]
        # the first declaration only finds out whether the user gave a value, of whatever type
        given = node.declare_parameter(name, descriptor=ParameterDescriptor(dynamic_typing=True))
        node.undeclare_parameter(name)
        preset = PRESETS.get(str(self._values.get('preset')), {})
        value = check_option(spec, preset.get(name, spec.default))
        if given.type_ != Parameter.Type.NOT_SET:
            value = check_option(spec, given.value)
            self._explicit.add(name)
        node.declare_parameter(
            name, value, _descriptor(spec, read_only=read_only), ignore_override=True
        )
        self._values[name] = value

    def _check(self, values: dict[str, OptionValue]) -> None:
        """Raise a ConfigError if the values of a group are not valid."""
        for group in self._groups:
            group(**{spec.name: values[spec.name] for spec in _fields(group)})

    def _add_preset(self, parameters: list[Parameter[Any]]) -> list[Parameter[Any]]:
        """Convert whole numbers given for float options; add the values of a new preset."""
        given = {parameter.name: _as_declared(parameter, self._specs) for parameter in parameters}
        self._from_preset = set()
        if 'preset' in given and given['preset'].value in PRESETS and 'preset' in self._specs:
            preset = PRESETS[given['preset'].value]
            self._from_preset = self._specs.keys() - self._explicit - given.keys() - {'preset'}
            for name in sorted(self._from_preset):
                value = preset.get(name, self._specs[name].default)
                if value == self._values[name]:
                    self._from_preset.discard(name)
                else:
                    given[name] = Parameter(name, value=value)
        return list(given.values())

    def _validate(self, parameters: list[Parameter[Any]]) -> SetParametersResult:
        """Reject all of them, with the reason, if one is not valid."""
        try:
            self._check({**self._values, **self._own(parameters)})
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _accept(self, parameters: list[Parameter[Any]]) -> None:
        own = self._own(parameters)
        self._explicit |= own.keys() - self._from_preset - {'preset'}
        self._values = {**self._values, **own}

    def _own(self, parameters: list[Parameter[Any]]) -> dict[str, OptionValue]:
        return {
            parameter.name: parameter.value
            for parameter in parameters
            if parameter.name in self._specs
        }


def _fields(group: type[Options]) -> tuple[Spec, ...]:
    return dataclasses.fields(group)  # type: ignore[arg-type]


def _as_declared(parameter: Parameter[Any], specs: dict[str, Spec]) -> Parameter[Any]:
    spec = specs.get(parameter.name)
    if spec and type(spec.default) is float and parameter.type_ == Parameter.Type.INTEGER:
        return Parameter(parameter.name, value=float(parameter.value))
    return parameter


def _descriptor(spec: Spec, *, read_only: bool) -> ParameterDescriptor:
    meta = spec.metadata
    unit = f' [{meta["unit"]}]' if meta['unit'] else ''
    descriptor = ParameterDescriptor(
        description=f'{meta["description"]}{unit}', read_only=read_only
    )
    if meta['choices'] is not None:
        descriptor.additional_constraints = f'one of: {", ".join(meta["choices"])}'
    low, high = meta['minimum'], meta['maximum']
    if low is not None and high is not None:
        if type(spec.default) is float:
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=float(low), to_value=float(high))
            ]
        else:
            descriptor.integer_range = [
                IntegerRange(from_value=int(low), to_value=int(high), step=meta['step'] or 1)
            ]
    return descriptor
