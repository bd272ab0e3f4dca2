# SPDX-License-Identifier: Apache-2.0
"""``georeference``: tie a reconstruction to control points of the site, or level it."""

from __future__ import annotations

import argparse
from pathlib import Path

from binocular_recon.cli.options import add_pick_sigma_option, names, non_negative, positive, say
from binocular_recon.errors import ConfigError, MeasurementError
from binocular_recon.measurement.picks import Pick, read_picks
from binocular_recon.measurement.site.control_points import (
    CONTROL_SIGMA_M,
    ControlPoint,
    read_control,
)
from binocular_recon.measurement.site.levelling import TILT_SIGMA_RAD
from binocular_recon.measurement.site.tie import TIE_FILE


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``georeference``."""
    parser.add_argument(
        'folder', type=Path, metavar='OUTPUT',
        help='output folder of reconstruct; georeference.json is written to it',
    )  # fmt: skip
    parser.add_argument(
        '--control', type=Path, metavar='FILE.csv',
        help='control points: name,x,y,z[,sigma_x,sigma_y,sigma_z][,check] in metres, and their'
        ' picks frame,u,v[,u_right,v_right] unless --picks has them; rows with check = yes only'
        ' check the result',
    )  # fmt: skip
    parser.add_argument(
        '--picks', type=Path, metavar='FILE',
        help='picks of the control points by name; with --level rods or plumb the ends of upright'
        ' things, one pair after the other',
    )  # fmt: skip
    parser.add_argument(
        '--epsg', type=int, metavar='N',
        help='reference system of the control points, projected and in metres: x is the easting, y'
        ' the northing; the scale of the map is taken into account (needs pyproj)',
    )  # fmt: skip
    parser.add_argument(
        '--free-scale', action='store_true',
        help='estimate the scale too, and say by how much it differs from 1: a check of the'
        ' calibration',
    )  # fmt: skip
    parser.add_argument(
        '--leave-out', type=names, default=[], metavar='NAME,...',
        help='control points that are not used',
    )  # fmt: skip
    parser.add_argument(
        '--control-sigma', type=positive(float), default=CONTROL_SIGMA_M, metavar='M',
        help='one standard deviation of coordinates that state none, m (%(default)s)',
    )  # fmt: skip
    parser.add_argument(
        '--level', choices=['ground', *TILT_SIGMA_RAD],
        help='instead of control points: make the third axis vertical, by the ground plane, by'
        ' upright rods (5 mrad) or by plumb lines (1 mrad)',
    )  # fmt: skip
    parser.add_argument(
        '--frame', type=non_negative, default=0, metavar='N',
        help='frame in which --level ground finds the ground (%(default)s)',
    )  # fmt: skip
    add_pick_sigma_option(parser)


def run(args: argparse.Namespace) -> None:
    """Find the frame of the site, print how well it fits, and write ``georeference.json``.

    Raises
    ------
    BinocularReconError
        If the points do not suffice or contradict each other; nothing is written then.

    """
    from binocular_recon.apps.survey.georeferencing import level_folder, tie_folder
    from binocular_recon.apps.survey.measured_folder import MeasuredFolder

    _check(args)
    folder = MeasuredFolder(args.folder)
    picks = read_picks(args.picks)[0] if args.picks else {}
    if args.level:
        _, text = level_folder(
            folder, args.level, picks, number=args.frame, pick_sigma_px=args.pick_sigma
        )
    else:
        _, text = tie_folder(
            folder,
            _control(args, picks),
            epsg=args.epsg,
            free_scale=args.free_scale,
            pick_sigma_px=args.pick_sigma,
        )
    say(text)
    say(args.folder / TIE_FILE)


def _control(args: argparse.Namespace, picks: dict[str, Pick]) -> list[ControlPoint]:
    control = read_control(args.control, picks, args.control_sigma)
    known = {one.name for one in control}
    for name in args.leave_out:
        if name not in known:
            raise MeasurementError(f'--leave-out: {args.control} has no point {name!r}')
    return [one for one in control if one.name not in args.leave_out]


def _check(args: argparse.Namespace) -> None:
    if (args.control is None) == (args.level is None):
        raise ConfigError('give either --control FILE.csv or --level')
    if args.level and (args.epsg is not None or args.free_scale or args.leave_out):
        raise ConfigError('--epsg, --free-scale and --leave-out belong to --control')
    if args.level in TILT_SIGMA_RAD and args.picks is None:
        raise ConfigError(f'--level {args.level} needs --picks with the ends of upright things')
