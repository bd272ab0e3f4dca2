# SPDX-License-Identifier: Apache-2.0
"""Read changed inputs of every form for a while: ``run.py [--minutes M | --cases N]``.

No input may end in a traceback, take more than 2 s of processor time or 1 GB. Findings are
written to ``out/fuzz/``; the smallest input that shows one belongs into ``test/fuzz/seeds/``.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import signal
import subprocess
import sys
import time
import types
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
# Without it, `test` would be the one of the standard library.
package = types.ModuleType('test')
package.__path__ = [str(REPOSITORY / 'test')]
sys.modules['test'] = package
sys.path.insert(0, str(REPOSITORY))

from test.fuzz import worker  # noqa: E402
from test.fuzz.forms import FORMS, READERS  # noqa: E402

# Cases that a worker is given at once.
BATCH = 200
# Kinds of findings of one form that are written.
_MOST_FINDINGS = 30


class Workers:
    """A worker process, started again after one ended it."""

    def __init__(self) -> None:
        self._start()

    def _start(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, __file__, '--worker'],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def run(self, form: str, seed: int, first: int, end: int) -> Iterator[tuple[int, str]]:
        """Yield the cases with a problem, and the problem."""
        while first < end:
            assert self._process.stdin and self._process.stdout
            order = {'form': form, 'seed': seed, 'first': first, 'end': end}
            self._process.stdin.write(json.dumps(order) + '\n')
            self._process.stdin.flush()
            number = first
            for line in self._process.stdout:
                answer = json.loads(line) if line != 'done\n' else None
                if answer is None:
                    return
                if isinstance(answer, int):
                    number = answer
                else:
                    yield number, answer
            status = self._process.wait()
            if status >= 0:
                raise SystemExit(f'the worker ended with status {status}')
            name = signal.Signals(-status).name
            if -status == signal.SIGPROF:
                name = f'more than {worker.LIMIT_S:g} s of processor time'
            yield number, f'ended by {name}'
            self._start()
            first = number + 1

    def close(self) -> None:
        """End the process."""
        assert self._process.stdin
        self._process.stdin.close()
        self._process.wait()


def main() -> int:
    """Run; return 1 if there were findings."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--minutes', type=float, help='until so much time has passed')
    parser.add_argument(
        '--cases', type=int, default=100, help='of each form (default %(default)s)'
    )
    parser.add_argument('--seed', type=int, default=0, help='other cases (default %(default)s)')
    parser.add_argument('--forms', nargs='+', default=list(FORMS), choices=list(READERS))
    parser.add_argument('--output', type=Path, default=REPOSITORY / 'out' / 'fuzz')
    parser.add_argument('--worker', action='store_true', help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.worker:
        worker.serve()
        return 0
    counts: Counter[str] = Counter()
    findings: dict[tuple[str, str], int] = {}
    workers = Workers()
    end_s = time.monotonic() + 60 * (args.minutes or 0)
    first, step = 0, BATCH if args.minutes else args.cases
    while True:
        for form in args.forms:
            for number, text in workers.run(form, args.seed, first, first + step):
                kind = form, text.strip().splitlines()[-1][:100] + text[:300]
                findings[kind] = findings.get(kind, 0) + 1
                if findings[kind] == 1 and len(findings) < _MOST_FINDINGS * len(FORMS):
                    report(args.output, form, worker.case(form, args.seed, number), text)
            counts[form] += step
            if args.minutes and time.monotonic() > end_s:
                break
        first += step
        if time.monotonic() >= end_s:
            break
    workers.close()
    for form in args.forms:
        kinds = [count for (of, _), count in findings.items() if of == form]
        print(f'{form}: {counts[form]} inputs, {sum(kinds)} findings of {len(kinds)} kinds')
    return int(bool(findings))


def report(folder: Path, form: str, data: bytes, text: str) -> None:
    """Write a finding and print what it is."""
    path = folder / f'{form}_{hashlib.sha256(data).hexdigest()[:12]}'
    folder.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    path.with_suffix('.txt').write_text(text)
    print(f'{path} ({len(data)} bytes): {text}', flush=True)


if __name__ == '__main__':
    sys.exit(main())
