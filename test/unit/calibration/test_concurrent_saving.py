# SPDX-License-Identifier: Apache-2.0
"""Calibrations that are saved, killed and read at the same time: no reader sees a mixture."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import yaml

from binocular_recon.calibration.session.calibration_files import finish_saving, save_rig
from binocular_recon.camera import StereoRig
from binocular_recon.errors import CalibrationError
from binocular_recon.io.calibration_yaml import read_rig, write_rig
from test.bag_tools import rig

pytestmark = pytest.mark.long

# `KILLS=1000` in the environment kills more often. A kill counts if it hit a save.
KILLS, READERS, SAVERS = int(os.environ.get('KILLS', '3')), 4, 2
FOCAL_PX, STEP_PX = 500.0, 1 / 4096
TESTS = Path(__file__).parents[2]
# Starts savers, of other rigs each, per line of input. Each notes what it has saved, and when it
# began and ended, and whether it is saving, in memory that outlives it.
RUNNER = """
import json, os, sys, time
from pathlib import Path
import numpy as np
import test  # Python's own
from binocular_recon.calibration.session.calibration_files import save_rig
test.__path__ = [sys.argv[1]]
from test.bag_tools import rig
folder, notes = Path(sys.argv[2]), np.memmap(sys.argv[3], np.int64, 'r+', shape=(2, 4))
focal_px, step_px = map(float, sys.argv[4:])
parent = os.getpid()
for line in sys.stdin:
    savers = []
    for number, count in enumerate(json.loads(line)):
        child = os.fork()
        while not child and os.getppid() == parent:
            count += 1
            one = rig(focal_px + step_px * (2 * count + number))
            begun_ns = time.monotonic_ns()
            notes[number, 3] = True
            save_rig(one, folder)
            notes[number] = count, begun_ns, time.monotonic_ns(), False
        if not child:
            os._exit(0)
        savers.append(child)
    print(json.dumps(savers), flush=True)
    sys.stdin.readline()  # they are killed now
    for saver in savers:
        os.waitpid(saver, 0)
    print('ended', flush=True)
"""


def saved(one: StereoRig) -> tuple[int, int]:
    """Return which saver saved a rig, and its how many-th; both cameras must be of it."""
    focal_px = one.left.P[0, 0]
    np.testing.assert_array_equal(one.right.P, rig(focal_px).right.P)
    count, number = divmod((focal_px - FOCAL_PX) / STEP_PX, SAVERS)
    assert number.is_integer()
    return int(number), int(count)


@pytest.mark.timeout(0 if KILLS > 10 else 300)
def test_readers_and_two_savers_that_are_killed(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    save_rig(rig(FOCAL_PX), tmp_path)
    kept = tmp_path_factory.mktemp('notes') / 'notes'
    notes = np.memmap(kept, np.int64, 'w+', shape=(SAVERS, 4))
    faults: list[BaseException] = []
    reads, more = [0] * READERS, threading.Condition()
    saving, ended = threading.Event(), threading.Event()

    def read_on(number: int) -> None:
        while saving.wait() and not ended.is_set():
            try:
                saved(read_rig(tmp_path))
            except BaseException as error:  # noqa: BLE001 - reported by the test
                faults.append(error)
                ended.set()
            with more:
                reads[number] += 1
                more.notify()

    words = [str(TESTS), str(tmp_path), str(kept), str(FOCAL_PX), str(STEP_PX)]
    pipe = subprocess.PIPE
    command = [sys.executable, '-c', RUNNER, *words]
    runner = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)
    assert runner.stdin and runner.stdout
    readers = [threading.Thread(target=read_on, args=(number,)) for number in range(READERS)]
    for reader in readers:
        reader.start()
    try:
        counts, before, acknowledged_before = [0] * SAVERS, (0, 0), [0] * SAVERS
        kills = rounds = 0
        while kills < KILLS and not ended.is_set():
            notes[:, 3] = False
            print(json.dumps(counts), file=runner.stdin, flush=True)
            savers = json.loads(runner.stdout.readline())
            saving.set()
            goal = sum(reads) + 5 + 7 * rounds % 40
            rounds += 1
            with more:
                more.wait_for(lambda goal=goal: ended.is_set() or sum(reads) >= goal, 60)  # type: ignore[misc]
            for saver in savers:
                os.kill(saver, signal.SIGKILL)
            print(file=runner.stdin, flush=True)
            assert runner.stdout.readline() == 'ended\n'
            kills += int(notes[:, 3].any())  # both at once count as one
            finish_saving(tmp_path)
            number, count = saved(read_rig(tmp_path))
            # the last one that was acknowledged, the one in progress, or none was saved
            acknowledged = int(notes[number, 0])
            if (number, count) == before:
                assert notes[:, 0].tolist() == acknowledged_before or count == acknowledged
            else:
                assert count in (acknowledged, max(acknowledged, counts[number]) + 1)
            before, acknowledged_before = (number, count), notes[:, 0].tolist()
            if count == notes[number, 0]:
                later = notes[:, 1] > notes[number, 2]
                assert not later.any(), 'one that was acknowledged later is lost'
            counts = [max(int(one), count) for one in notes[:, 0]]
            if (tmp_path / 'previous').exists():  # the first savers may have come to nothing
                saved(read_rig(tmp_path / 'previous'))
            saving.clear()  # until the next savers have started
    finally:
        ended.set()
        saving.set()
        for reader in readers:
            reader.join()
        runner.communicate()
    assert faults == []
    assert min(reads) > KILLS
    save_rig(rig(FOCAL_PX), tmp_path)  # which clears what the killed ones left
    assert sorted(p.name for p in tmp_path.iterdir()) == ['left.yaml', 'previous', 'right.yaml']
    assert (notes[:, 0] > 0).all()  # the readers let them save


def test_files_of_two_calibrations_are_not_mixed(tmp_path: Path) -> None:
    for name, focal_px in (('one', 500.0), ('two', 500.1)):
        (tmp_path / name).mkdir()
        write_rig(tmp_path / name, rig(focal_px))
    (tmp_path / 'one' / 'right.yaml').write_bytes((tmp_path / 'two' / 'right.yaml').read_bytes())
    with pytest.raises(
        CalibrationError,
        match=r'left\.yaml and right\.yaml are of two calibrations \(calibration_',
    ):
        read_rig(tmp_path / 'one')
    for side in ('left', 'right'):  # as the message says
        path = tmp_path / 'one' / f'{side}.yaml'
        content = yaml.safe_load(path.read_text())
        del content['calibration_id']
        path.write_text(yaml.safe_dump(content))
    assert read_rig(tmp_path / 'one').left.P[0, 0] == 500.0


def test_the_same_rig_has_the_same_files(tmp_path: Path) -> None:
    for name in ('one', 'two'):
        save_rig(rig(FOCAL_PX), tmp_path / name)
    for side in ('left', 'right'):
        first, second = (
            (tmp_path / name / f'{side}.yaml').read_bytes() for name in ('one', 'two')
        )
        assert first == second
