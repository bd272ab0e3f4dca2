# SPDX-License-Identifier: Apache-2.0
"""Options that several commands share, made from the fields of the configuration."""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Callable, Collection
from typing import Any

from binocular_recon.config import PRESETS, ChainConfig
from binocular_recon.errors import ConfigError
from binocular_recon.options import OptionValue, check_option


def add_chain_options(parser: argparse.ArgumentParser, exclude: Collection[str] = ()) -> None:
    """Declare ``--preset`` and the flags of `add_option_flags`."""
    parser.add_argument(
        '--preset',
        choices=list(PRESETS),
        default='default',
        help='options of the chain that belong together (%(default)s)',
    )
    add_option_flags(parser, exclude)


def add_option_flags(parser: argparse.ArgumentParser, exclude: Collection[str] = ()) -> None:
    """Declare a flag for every option of the chain that ``exclude`` has not."""
    group = parser.add_argument_group(
        'options of the chain', 'Each replaces the value of the preset.'
    )
    for spec in _options():
        if spec.name not in exclude:
            flag, text = f'--{spec.name.replace("_", "-")}', _help(spec)
            if isinstance(spec.default, bool):
                group.add_argument(
                    flag,
                    action=argparse.BooleanOptionalAction,
                    default=argparse.SUPPRESS,
                    help=text,
                )
            else:
                group.add_argument(
                    flag,
                    type=_converter(spec),
                    default=argparse.SUPPRESS,
                    metavar=_metavar(spec),
                    help=text,
                )


def chain_config(args: argparse.Namespace, **overrides: OptionValue) -> ChainConfig:
    """Return the configuration that the arguments ask for; ``overrides`` win over all."""
    return ChainConfig.preset(args.preset, **{**given_options(args), **overrides})


def given_options(args: argparse.Namespace) -> dict[str, OptionValue]:
    """Return the options of the chain whose flags were given."""
    return {spec.name: getattr(args, spec.name) for spec in _options() if spec.name in args}


def preset_names(text: str) -> list[str]:
    """Convert an argument with one or more presets, separated by commas."""
    names = [name.strip() for name in text.split(',') if name.strip()]
    for name in names:
        if name not in PRESETS:
            raise argparse.ArgumentTypeError(f'{name!r} is not one of {", ".join(PRESETS)}')
    return names


def positive(kind: type[int | float]) -> Callable[[str], float]:
    """Return a converter of arguments that refuses what is not finite and above 0."""

    def convert(text: str) -> float:
        value = kind(text)
        if not 0 < value < math.inf:
            raise argparse.ArgumentTypeError(f'must be finite and greater than 0, got {text}')
        return value

    convert.__name__ = 'number' if kind is float else 'whole number'  # named by argparse's errors
    return convert


def non_negative(text: str) -> int:
    """Convert an argument that is a whole number and not below 0, such as a seed."""
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f'must not be negative, got {text}')
    return value


non_negative.__name__ = 'whole number'


def _options() -> list[dataclasses.Field[Any]]:
    groups: list[Any] = [group.default_factory for group in dataclasses.fields(ChainConfig)]
    return [spec for group in groups for spec in dataclasses.fields(group)]


def _converter(spec: dataclasses.Field[Any]) -> Callable[[str], OptionValue]:
    kind: Callable[[str], object] = type(spec.default)

    def convert(text: str) -> OptionValue:
        try:
            return check_option(spec, kind(text))
        except ConfigError as error:
            raise argparse.ArgumentTypeError(str(error)) from None
        except ValueError:
            raise argparse.ArgumentTypeError(f'{text!r} is no {_metavar(spec)}') from None

    return convert


def _metavar(spec: dataclasses.Field[Any]) -> str:
    choices = spec.metadata['choices']
    if choices:
        return '{' + ','.join(choices) + '}'
    return 'INTEGER' if isinstance(spec.default, int) else 'NUMBER'


def _help(spec: dataclasses.Field[Any]) -> str:
    meta = spec.metadata
    facts = [meta['unit']] if meta['unit'] else []
    if meta['minimum'] is not None and meta['maximum'] is not None:
        facts.append(f'{meta["minimum"]:g} to {meta["maximum"]:g}')
    presets = {name: values[spec.name] for name, values in PRESETS.items() if spec.name in values}
    facts += [f'preset {name}: {value}' for name, value in presets.items()]
    facts.append(f'default: {spec.default}')
    return f'{meta["description"]} ({"; ".join(facts)})'.replace('%', '%%')
