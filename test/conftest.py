# SPDX-License-Identifier: Apache-2.0
"""What all tests share: an isolated ROS graph, and what is left out where something is missing."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import signal
import socket
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
SHARED_DATA = Path(os.environ.get('BINOCULAR_RECON_DATA', REPOSITORY.parent / 'shared' / 'data'))

_domain_claim = pytest.StashKey[socket.socket]()
_left_out = pytest.StashKey[list[str]]()


def _claim_domain() -> tuple[int, socket.socket]:
    """Return a ROS domain that no other test run has; it is this run's while the socket is open.

    The ports are those of ament's domain_coordinator, so its runs are kept apart too.
    """
    # Begin anywhere: in the first domain, processes of an earlier run that was killed may be left.
    for domain in (1 + (os.getpid() + offset) % 100 for offset in range(100)):
        claim = socket.socket()
        try:
            claim.bind(('127.0.0.1', 22119 + domain))
        except OSError:
            claim.close()
        else:
            return domain, claim
    raise pytest.UsageError('all ROS domains from 1 to 100 are in use by other test runs')


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let a run say for the whole suite what was left out, though a part was run before."""
    parser.addoption(
        '--done',
        action='append',
        default=[],
        metavar='FOLDER',
        help='collect its tests, but do not run them again; may be given several times',
    )


def pytest_configure(config: pytest.Config) -> None:
    """Keep the ROS graph and the compiled kernels of this run, and of its processes, apart."""
    domain, config.stash[_domain_claim] = _claim_domain()
    os.environ['ROS_DOMAIN_ID'] = str(domain)
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    config.stash[_left_out] = []
    # A shell ignores Ctrl-C in what it starts in the background, and processes pass that on.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if sys.prefix != sys.base_prefix:
        # Beside the sources, the numba of one environment would discard what another's compiled.
        os.environ.setdefault('NUMBA_CACHE_DIR', str(Path(sys.prefix, 'numba_cache')))


def pytest_report_header() -> str:
    """Name the versions that the results depend on."""
    packages = ('numpy', 'scipy', 'opencv-python-headless', 'numba', 'rosbags', 'rclpy')
    found = []
    for package in packages:
        with suppress(importlib.metadata.PackageNotFoundError):
            found.append(f'{package} {importlib.metadata.version(package)}')
    return ', '.join(found)


def pytest_unconfigure(config: pytest.Config) -> None:
    """Give the domain back."""
    config.stash[_domain_claim].close()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect what cannot run here; the closing lines of the run say so."""
    reasons = {
        'shared_data': (
            None
            if SHARED_DATA.is_dir()
            else f'there is no {SHARED_DATA} (BINOCULAR_RECON_DATA names another folder)'
        ),
        'ros': None if importlib.util.find_spec('rclpy') else 'rclpy is not installed',
    }
    for need, reason in reasons.items():
        if reason is None:
            continue
        without = [item for item in items if need in _needs(item)]
        items[:] = [item for item in items if item not in without]
        config.hook.pytest_deselected(items=without)
        if without:
            config.stash[_left_out].append(f'tests not run: {len(without)}; {reason}')
    for folder in config.option.done:
        items[:] = [item for item in items if not item.path.is_relative_to(REPOSITORY / folder)]


def _needs(item: pytest.Item) -> set[str]:
    """Return which of ``shared_data`` and ``ros`` a test needs."""
    needs = set(getattr(item, 'fixturenames', ()))
    if item.path.is_relative_to(REPOSITORY / 'test' / 'system') or item.get_closest_marker('ros'):
        needs.add('ros')
    return needs


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say in one line each what was left out and why."""
    for line in terminalreporter.config.stash[_left_out]:
        terminalreporter.write_line(line, yellow=True)


@pytest.fixture(autouse=True, scope='session')
def _ros_log_folder(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Nodes log into the run's temporary folder."""
    os.environ['ROS_LOG_DIR'] = str(tmp_path_factory.mktemp('ros_log'))


@pytest.fixture(scope='session')
def shared_data() -> Path:
    """Folder of the real scenes that the repository does not hold; without it not selected."""
    return SHARED_DATA


@pytest.fixture
def built_in_matchers() -> Iterator[None]:
    """Forget the matchers that a test registers."""
    from binocular_recon.config import MATCHER_NAMES
    from binocular_recon.stereo.matching import registry

    names = list(MATCHER_NAMES)
    yield
    for name in set(MATCHER_NAMES) - set(names):
        MATCHER_NAMES.remove(name)
        registry._MATCHERS.pop(name, None)
