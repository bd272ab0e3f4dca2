# SPDX-License-Identifier: Apache-2.0
"""The tour of ``demo --survey``: every step of a survey, by the commands that users give."""

from __future__ import annotations

import shlex
import time
from collections.abc import Sequence
from pathlib import Path

from binocular_recon.cli.main import PROGRAM, run_command
from binocular_recon.cli.options import note, say
from binocular_recon.errors import DependencyError, MeasurementError
from binocular_recon.machine import now_text
from binocular_recon.number_text import counted, fixed

SEED = 3
# More contradicts the stated standard deviation.
_MOST_SIGMAS = 4.0


def survey_tour(output: Path, *, boards: int, size: float, options: Sequence[str]) -> None:
    """Simulate a site, survey it with our commands, and print the results beside the truth.

    Parameters
    ----------
    output : Path
        Folder for everything.
    boards : int
        Boards to calibrate with.
    size : float
        Of the images, relative to 1920x1200.
    options : sequence of str
        Arguments of ``reconstruct``.

    Raises
    ------
    BinocularReconError
        If a step fails, or a value is off by more than 4 standard deviations.

    """
    from binocular_recon.apps.survey.simulated_site import (
        compare,
        simulate_survey,
        write_field_book,
    )
    from binocular_recon.io.calibration_yaml import read_rig

    begun = time.monotonic()
    say(f'A simulated site with {counted(boards, "board")} of rods; files in {output}')
    site = simulate_survey(output, seed=SEED, boards=boards, size=size, report=note)
    rods, rig, out = output / 'rods.yaml', output / 'rig', output / 'cloud'
    _run('rods-plan', rods, '--output', output / 'rods.svg')
    _run('calibrate', output / 'captures', '--rods', rods, '--output', rig)
    _run('calibrate', output / 'check', '--rods', rods, '--check', rig, '--output', out)
    _run('reconstruct', output / 'left', output / 'right', '--calibration', rig,
         '--format', 'right,drawing', *options, '--output', out)  # fmt: skip
    scale, system = _map()
    write_field_book(site, read_rig(rig), seed=SEED, scale=scale)
    picks = output / 'picks.yaml'
    _run('georeference', out, '--control', output / 'control.csv', '--picks', picks, *system)
    _run('measure', out, '--picks', picks)
    try:
        _run('export', out, '--format', 'laz')
    except DependencyError as error:
        say(f'LAZ is left out: {error}')
    _run('report', out, '--site', 'Simulated yard', '--client', 'nobody', '--author',
         f'{PROGRAM} demo --survey', '--date', now_text()[:10])  # fmt: skip
    say()
    compared = compare(site, out)
    say(f'{"":>26} {"true m":>12} {"measured m":>12} {"sigma m":>8} {"off / sigma":>12}')
    for one in compared:
        say(
            f'{one.name:>26} {fixed(one.true, 3):>12} {fixed(one.measured, 3):>12}'
            f' {fixed(one.sigma, 3):>8} {one.off_sigmas:>+12.1f}'
        )
    worst = max(compared, key=lambda one: abs(one.off_sigmas))
    say(f'{len(compared)} values, the survey took {time.monotonic() - begun:.0f} s')
    if abs(worst.off_sigmas) > _MOST_SIGMAS:
        raise MeasurementError(
            f'{worst.name} is {worst.measured:.3f} m, {worst.off_sigmas:+.1f} sigma from the truth'
            f' (at most {_MOST_SIGMAS:g}); sigma does not hold on this machine: please report it'
        )


def _run(*words: object) -> None:
    """Print a command as a user would give it, and run it."""
    argv = [str(word) for word in words]
    say(f'\n$ {PROGRAM} {shlex.join(argv)}')
    run_command(argv)


def _map() -> tuple[float, list[str]]:
    """Return the scale of the map at the site, and the option that names its system.

    Without pyproj the coordinates are taken as those of a local system, of scale 1.
    """
    from binocular_recon.apps.survey.simulated_site import EPSG, PLACE_M
    from binocular_recon.measurement.site.reference_systems import reference_system

    try:
        return reference_system(EPSG, PLACE_M).scale, ['--epsg', str(EPSG)]
    except DependencyError as error:
        say(f'\nthe reference system is left out: {error}')
        return 1.0, []
