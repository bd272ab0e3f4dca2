# SPDX-License-Identifier: Apache-2.0
"""The process that reads inputs: each within 2 s of processor time and 1 GB."""

from __future__ import annotations

import contextlib
import json
import os
import random
import resource
import signal
import sys
import tempfile
import traceback
import warnings
from pathlib import Path
from typing import Any

from binocular_recon.errors import BinocularReconError
from test.fuzz.forms import FORMS, READERS, seeds
from test.fuzz.mutation import mutated

LIMIT_S, LIMIT_BYTES = 2.0, 1_000_000_000


def case(form: str, seed: int, number: int) -> bytes:
    """Return an input: the first ones are the seeds of the form, the others change them."""
    known = seeds(form)
    if number < len(known):
        return known[number]
    generator = random.Random(f'{form} {seed} {number}')
    return mutated(generator.choice(known), known, generator)


def problem(form: str, data: bytes) -> str:
    """Return what is wrong with how an input is read, '' if nothing is."""
    with tempfile.TemporaryDirectory(prefix='fuzz_') as folder:
        try:
            signal.setitimer(signal.ITIMER_PROF, LIMIT_S)  # its signal ends the process
            READERS[form](data, Path(folder))
        except BinocularReconError as error:
            if any(not one.isprintable() and one not in '\n\t' for one in str(error)):
                return f'control characters in {str(error)!r}'
        except MemoryError:
            return f'more than {LIMIT_BYTES / 1e9:g} GB\n{traceback.format_exc(limit=-6)}'
        except BaseException:  # noqa: BLE001 - whatever it is, it is a finding
            return traceback.format_exc(limit=-6)
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
    return ''


def serve() -> None:
    """Read the cases that standard input asks for; say on standard output what is being done."""
    warnings.simplefilter('ignore')
    answers = os.fdopen(os.dup(1), 'w', buffering=1)
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)  # what commands and native libraries print
    os.dup2(null, 2)
    for form in FORMS:  # imports and compiles what it needs
        with tempfile.TemporaryDirectory() as folder, contextlib.suppress(BinocularReconError):
            FORMS[form](seeds(form)[0], Path(folder))
    pages = int(Path('/proc/self/statm').read_text().split()[0])
    limit = pages * resource.getpagesize() + LIMIT_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    for line in sys.stdin:
        order: dict[str, Any] = json.loads(line)
        for number in range(order['first'], order['end']):
            answers.write(f'{number}\n')
            found = problem(order['form'], case(order['form'], order['seed'], number))
            if found:
                answers.write(json.dumps(found) + '\n')
        answers.write('done\n')
