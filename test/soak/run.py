# SPDX-License-Identifier: Apache-2.0
"""Run the nodes for long while their surroundings fail: ``run.py [--minutes M] [--output DIR]``.

Two rigs in two namespaces, one with `stereo_node`, one with separate nodes. Faults are injected in
turn into one, then the other. Status 1 if clouds do not come again within 2 s after a fault, its
cause is not named in the diagnostics, memory grows by more than 3 %, the other rig stops, or a
node does not end cleanly. ``report.html`` shows it all.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
import tempfile
import time
import types
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).resolve().parents[2]
PROFILE = str(REPOSITORY / 'config' / 'fastdds_shared_memory.xml')
for variable in ('FASTDDS_DEFAULT_PROFILES_FILE', 'FASTRTPS_DEFAULT_PROFILES_FILE'):
    os.environ.setdefault(variable, PROFILE)
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))

import rclpy  # noqa: E402, F401 - starts Python again with its libraries on the path

# Without it, `test` would be the one of the standard library.
package = types.ModuleType('test')
package.__path__ = [str(REPOSITORY / 'test')]
sys.modules['test'] = package
sys.path.insert(0, str(REPOSITORY))

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402

from test.soak.faults import FAULTS, KILL, Fault  # noqa: E402
from test.soak.report import Episode, Life, growth, soak_page  # noqa: E402
from test.soak.rig import Rig  # noqa: E402
from test.system.graph import RELIABLE, Graph  # noqa: E402

_START_S, _PATIENCE_S = 180.0, 30.0
_GROWTH = 0.03
_SHOWN = 1000  # characters of a log
# Statuses come once a second; a cause may be stated in the one after the fault.
_STATUS_S = 2.5


class Soak:
    """The rigs under observation."""

    def __init__(self, folder: Path, within_s: float) -> None:
        self._within_s = within_s
        self.graph = Graph('soak')
        self.begun_s = time.monotonic()
        self.problems: list[str] = []
        self.episodes: list[Episode] = []
        self.counts: dict[str, dict[str, str]] = {}
        self._texts: dict[str, list[str]] = {}  # by node: messages,
        self._news: dict[str, list[str]] = {}  # and values that are new
        self._lives: dict[int, Life] = {}
        self._sampled_s = 0.0
        self.graph.do(
            partial(
                self.graph.node.create_subscription,
                DiagnosticArray,
                '/diagnostics',
                self._note,
                RELIABLE,
            )
        )
        self.rigs = [
            Rig(self.graph, 'composed', folder, composed=True),
            Rig(self.graph, 'separate', folder, composed=False),
        ]

    def start(self) -> None:
        """Wait for the first clouds: the first start of the nodes compiles their kernels."""
        for rig in self.rigs:
            if not self._wait(lambda rig=rig: rig.clouds > 3, _START_S):  # type: ignore[misc]
                raise SystemExit(f'no clouds of the {rig.namespace} rig within {_START_S:g} s')

    def inject(self, fault: Fault, rig: Rig) -> None:
        """Let a fault happen, and see what comes of it."""
        for name in rig.names:
            self._texts[name], self._news[name] = [], []
        clouds = {one: one.clouds for one in self.rigs if one is not rig}
        at_s = time.monotonic()
        fault.begin(rig)
        self._wait(lambda: False, fault.seconds)
        fault.end(rig)
        ended_s = time.monotonic()
        self._wait(lambda: rig.first_since(ended_s), _PATIENCE_S)
        back_s = rig.first_since(ended_s)
        recovery_s = (back_s or time.monotonic()) - ended_s
        said: list[str] = []
        if fault.cause:
            said = self._wait(lambda: self._said(fault.cause, rig), _STATUS_S) or []
        go_on = self._wait(lambda: all(one.clouds > n for one, n in clouds.items()), _PATIENCE_S)
        wrong = [] if go_on else ['the other rig stopped, too']
        if recovery_s > self._within_s:
            wrong.append(f'recovered after {recovery_s:.1f} s; its nodes logged last:')
            wrong += [f'{name}: {node.text()[-_SHOWN:]}' for name, node in rig.nodes.items()]
        if fault.cause and not said:
            texts = '; '.join(dict.fromkeys(t for name in rig.names for t in self._texts[name]))
            wrong.append(f'the diagnostics do not name the cause, but say: {texts}')
        episode = Episode(
            fault.name,
            rig.namespace,
            at_s - self.begun_s,
            recovery_s,
            said[0] if said else '',
            '; '.join(wrong),
        )
        self.episodes.append(episode)
        _say(f'{fault.name}, {rig.namespace}: {recovery_s:.2f} s {episode.problem}')

    def close(self) -> list[str]:
        """End everything and return what was wrong."""
        for rig in self.rigs:
            self.problems += rig.close()
        self.graph.close()
        self.problems += [
            f'{one.fault}, {one.rig}: {one.problem}' for one in self.episodes if one.problem
        ]
        for life in self._lives.values():
            grown = growth(life)
            if grown > _GROWTH:
                self.problems.append(f'{life.node} grew by {grown:.1%}')
        return self.problems

    def page(self) -> str:
        """Return the report."""
        clouds = ', '.join(f'{rig.namespace} {rig.clouds}' for rig in self.rigs)
        summary = f'{time.monotonic() - self.begun_s:.0f} s; clouds: {clouds}. Problems:'
        return soak_page(
            summary, self.episodes, list(self._lives.values()), self.counts, self.problems
        )

    def _wait(self, condition: Callable[[], Any], seconds: float) -> Any:
        """Return a condition's first true value, None after the time; sample memory meanwhile."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            if time.monotonic() - self._sampled_s > 1:
                self._sample()
            if value := condition():
                return value
            time.sleep(0.02)
        return None

    def _sample(self) -> None:
        self._sampled_s = time.monotonic()
        for rig in self.rigs:
            for name, node in rig.nodes.items():
                if node.process.poll() is not None:
                    continue
                pages = Path(f'/proc/{node.process.pid}/statm').read_text('ascii').split()[1]
                life = self._lives.setdefault(
                    node.process.pid, Life(f'{rig.namespace}/{name}', [], [])
                )
                life.times_s.append(self._sampled_s - self.begun_s)
                life.memory_mb.append(int(pages) * os.sysconf('SC_PAGE_SIZE') / 1e6)

    def _note(self, array: DiagnosticArray) -> None:
        for status in array.status:
            node, values = status.hardware_id, {one.key: one.value for one in status.values}
            before = self.counts.get(node, {})
            self._texts.setdefault(node, []).append(status.message)
            self._news.setdefault(node, []).extend(
                f'{key}: {value}' for key, value in values.items() if before.get(key) != value
            )
            self.counts[node] = values

    def _said(self, cause: str, rig: Rig) -> list[str]:
        """Return what nodes said of a cause: messages, and values that changed."""
        return [
            f'{name}: {text}'
            for name in rig.names
            for text in [*self._texts[name], *self._news[name]]
            if re.search(cause, text)
        ]


def _say(text: str) -> None:
    sys.stdout.write(f'{text}\n')
    sys.stdout.flush()


def main() -> int:
    """Run the rounds and write the report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--minutes', type=float, default=10.0, help='0: each fault once')
    parser.add_argument('--output', type=Path, default=Path('out/soak'))
    parser.add_argument(
        '--within', type=float, default=2.0, help='longest recovery, s (%(default)g)'
    )
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        soak = Soak(Path(folder), args.within)
        try:
            soak.start()
            end_s = soak.begun_s + 60 * args.minutes
            number = 0
            while number == 0 or time.monotonic() < end_s:
                rig = soak.rigs[number % len(soak.rigs)]
                # a kill ends the life of a process, over which its memory is compared
                for fault in (*FAULTS, KILL) if number < len(soak.rigs) else FAULTS:
                    if number == 0 or time.monotonic() < end_s:
                        soak.inject(fault, rig)
                number += 1
        finally:
            problems = soak.close()
            (args.output / 'report.html').write_text(soak.page(), encoding='utf-8')
    for problem in problems:
        sys.stderr.write(f'{problem}\n')
    _say(f'report: {args.output / "report.html"}')
    return 1 if problems else 0


if __name__ == '__main__':
    sys.exit(main())
