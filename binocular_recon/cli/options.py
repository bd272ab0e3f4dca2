# SPDX-License-Identifier: Apache-2.0
"""Arguments that several commands share."""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

from binocular_recon.config import PRESETS, ChainConfig
from binocular_recon.errors import ConfigError, plain_text
from binocular_recon.options import Options, OptionValue, check_option

# Options whose 0 has a name: found from the images.
FOUND = ('min_disparity', 'disparity_range')
# What commands say that need it.
NO_ROS = (
    'ROS 2 is not installed for this Python: rclpy is missing; source the setup file of an'
    ' installation or install the ROS wheels (make setup)'
)


# What the argument BAG may be.
BAG_FORMS = 'folder of a ROS 2 bag, or a .mcap, .db3 or ROS 1 .bag file, or one of these as .zstd'


def add_bag_argument(parser: argparse.ArgumentParser) -> None:
    """Declare ``BAG``."""
    parser.add_argument('bag', type=Path, metavar='BAG', help=BAG_FORMS)


def add_output_option(
    parser: argparse.ArgumentParser,
    default: str = '',
    content: str = 'the results',
    *,
    required: bool = True,
) -> None:
    """Declare ``--output DIR``, required if there is no default unless stated otherwise."""
    parser.add_argument(
        '--output',
        type=Path,
        default=Path(default) if default else None,
        required=required and not default,
        metavar='DIR',
        help=f'folder for {content}' + (' (%(default)s)' if default else ''),
    )


def add_pick_sigma_option(parser: argparse.ArgumentParser) -> None:
    """Declare ``--pick-sigma PX``."""
    from binocular_recon.measurement.snapping import PICK_SIGMA_PX

    parser.add_argument(
        '--pick-sigma',
        type=positive(float),
        default=PICK_SIGMA_PX,
        metavar='PX',
        help='one standard deviation of a pick on each axis, px (%(default)s)',
    )


def add_comparison_options(parser: argparse.ArgumentParser, *, repeat: int) -> None:
    """Declare the options of a comparison with other programs."""
    add_output_option(parser, 'out')
    parser.add_argument(
        '--presets',
        type=preset_names,
        default=list(PRESETS),
        metavar='NAME,...',
        help=f'presets to run (all: {",".join(PRESETS)})',
    )
    parser.add_argument(
        '--repeat',
        type=positive(int),
        default=repeat,
        metavar='N',
        help='timed runs of each method (%(default)s)',
    )


def ximgproc_note(missing: str, command: str) -> str:
    """Return the note of a comparison if OpenCV has no ximgproc."""
    return (
        f'This OpenCV has no ximgproc: {missing}. It is part of opencv-contrib-python-headless;'
        f' `make {command}` sets up an environment with it.'
    )


def add_chain_options(parser: argparse.ArgumentParser, exclude: Collection[str] = ()) -> None:
    """Declare ``--preset`` and the flags of `add_option_flags`."""
    parser.add_argument(
        '--preset',
        choices=list(PRESETS),
        default='default',
        help='set of chain options (%(default)s)',
    )
    add_option_flags(parser, exclude)


def add_option_flags(parser: argparse.ArgumentParser, exclude: Collection[str] = ()) -> None:
    """Declare a flag for every option of the chain except those in ``exclude``."""
    group = parser.add_argument_group(
        'chain options', 'An option given here replaces its value in the preset.'
    )
    for spec in _options():
        if spec.name not in exclude:
            _add_flag(group, spec)


def add_flags(group: argparse._ArgumentGroup, options: type[Options]) -> None:
    """Declare a flag for every option of a group that is not the chain's."""
    for spec in dataclasses.fields(options):  # type: ignore[arg-type]
        _add_flag(group, spec)


def _add_flag(group: argparse._ArgumentGroup, spec: dataclasses.Field[Any]) -> None:
    flag, text = f'--{spec.name.replace("_", "-")}', _help(spec)
    if isinstance(spec.default, bool):
        group.add_argument(
            flag, action=argparse.BooleanOptionalAction, default=argparse.SUPPRESS, help=text
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
    """Return the configuration of the arguments; ``overrides`` take precedence over all."""
    return ChainConfig.preset(args.preset, **{**given_options(args), **overrides})


def given_options(args: argparse.Namespace) -> dict[str, OptionValue]:
    """Return the options of the chain whose flags were given."""
    return {spec.name: getattr(args, spec.name) for spec in _options() if spec.name in args}


def option_flags(args: argparse.Namespace) -> list[str]:
    """Return the preset and the options that were given, as arguments of another command."""
    flags = ['--preset', args.preset]
    for name, value in given_options(args).items():
        flag = name.replace('_', '-')
        if isinstance(value, bool):
            flags.append(f'--{flag}' if value else f'--no-{flag}')
        else:
            flags.append(f'--{flag}={value}')
    return flags


def say(text: object = '') -> None:
    """Print a result, on stdout; names in it without control characters."""
    print(plain_text(str(text)), flush=True)


def note(text: str) -> None:
    """Print something that is not the result, on stderr."""
    print(plain_text(text), file=sys.stderr)


def names(text: str) -> list[str]:
    """Convert an argument that lists names, separated by commas."""
    return [name.strip() for name in text.split(',') if name.strip()]


def preset_names(text: str) -> list[str]:
    """Convert an argument that lists presets, separated by commas."""
    presets = names(text)
    for name in presets:
        if name not in PRESETS:
            raise argparse.ArgumentTypeError(f'{name!r} is not one of {", ".join(PRESETS)}')
    return presets


def positive(kind: type[int | float]) -> Callable[[str], float]:
    """Return a converter of arguments that must be finite and greater than 0."""

    def convert(text: str) -> float:
        value = kind(text)
        if not 0 < value < math.inf:
            raise argparse.ArgumentTypeError(f'must be finite and above 0, got {text}')
        return value

    convert.__name__ = (
        'number' if kind is float else 'whole number'
    )  # appears in argparse's errors
    return convert


def image_size(text: str) -> tuple[int, int]:
    """Return width and height, px, of ``--image-size``; raises a ConfigError if it has none."""
    try:
        width, height = (int(number) for number in text.split('x'))
    except ValueError:
        width = height = 0
    if min(width, height) < 1:
        raise ConfigError(f'--image-size must be WxH such as 1920x1200, got {text!r}')
    return width, height


def non_negative(text: str) -> int:
    """Convert an argument that is a whole number and not negative, such as a seed."""
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
            found = kind is int and text == 'auto' and spec.name in FOUND
            return check_option(spec, 0 if found else kind(text))
        except ConfigError as error:
            raise argparse.ArgumentTypeError(str(error)) from None
        except ValueError:
            raise argparse.ArgumentTypeError(f'{text!r} is not a valid {_metavar(spec)}') from None

    return convert


def _metavar(spec: dataclasses.Field[Any]) -> str:
    choices = spec.metadata['choices']
    if choices:
        return '{' + ','.join(choices) + '}'
    return {int: 'INTEGER', str: 'TEXT'}.get(type(spec.default), 'NUMBER')


def _help(spec: dataclasses.Field[Any]) -> str:
    meta = spec.metadata
    facts = [meta['unit']] if meta['unit'] else []
    if meta['minimum'] is not None and meta['maximum'] is not None:
        facts.append(f'{meta["minimum"]:g} to {meta["maximum"]:g}')
    presets = {name: values[spec.name] for name, values in PRESETS.items() if spec.name in values}
    facts += [f'preset {name}: {value}' for name, value in presets.items()]
    facts.append(f'default: {spec.default}')
    return f'{meta["description"]} ({"; ".join(facts)})'.replace('%', '%%')


def beside(path: Path, ending: str) -> Path:
    """Return the file beside an output whose name ends in another way: ``a.pfm``, ``a_x.png``."""
    return path.with_name(path.stem + ending)
