# SPDX-License-Identifier: Apache-2.0
"""Calibrations that are saved, killed and read at the same time: no reader sees a mixture."""

from __future__ import annotations

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

KILLS, READERS, RIGS = 2, 4, 7
FOCAL_PX = 500.0
SAVER = """
import itertools, sys
from pathlib import Path
from binocular_recon.calibration.session.calibration_files import save_rig
from binocular_recon.io.calibration_yaml import read_rig
rigs = [read_rig(path) for path in Path(sys.argv[2]).iterdir()]
print('ready', flush=True)
for one in itertools.cycle(rigs):
    save_rig(one, Path(sys.argv[1]))
"""


def start_saving(folder: Path, rigs: Path) -> subprocess.Popen[str]:
    command = [sys.executable, '-c', SAVER, str(folder), str(rigs)]
    saver = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert saver.stdout is not None
    assert saver.stdout.readline() == 'ready\n'
    return saver


def check(one: StereoRig) -> None:
    """Check that both cameras and the baseline are of one calibration."""
    focal_px = one.left.P[0, 0]
    assert FOCAL_PX <= focal_px < FOCAL_PX + RIGS
    np.testing.assert_array_equal(one.right.P, rig(focal_px).right.P)


def test_readers_and_two_savers_that_are_killed(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    save_rig(rig(FOCAL_PX), tmp_path)
    rigs = tmp_path_factory.mktemp('rigs')
    for step in range(RIGS):
        save_rig(rig(FOCAL_PX + step), rigs / str(step))
    faults: list[BaseException] = []
    reads, more = [0] * READERS, threading.Condition()
    saving, ended = threading.Event(), threading.Event()

    def read_on(number: int) -> None:
        while saving.wait() and not ended.is_set():
            try:
                check(read_rig(tmp_path))
            except BaseException as error:  # noqa: BLE001 - reported by the test
                faults.append(error)
                ended.set()
            with more:
                reads[number] += 1
                more.notify()

    readers = [threading.Thread(target=read_on, args=(number,)) for number in range(READERS)]
    for reader in readers:
        reader.start()
    try:
        for kill in range(KILLS):
            savers = [start_saving(tmp_path, rigs) for _ in range(2)]
            saving.set()
            goal = sum(reads) + 40 + 7 * kill
            with more:
                more.wait_for(lambda goal=goal: ended.is_set() or sum(reads) >= goal, 60)  # type: ignore[misc]
            for saver in savers:
                saver.kill()
                saver.communicate()
            finish_saving(tmp_path)
            check(read_rig(tmp_path))
            if (tmp_path / 'previous').exists():  # the first savers may have come to nothing
                check(read_rig(tmp_path / 'previous'))
            saving.clear()  # until the next savers have started
    finally:
        ended.set()
        saving.set()
        for reader in readers:
            reader.join()
    assert faults == []
    assert min(reads) > 5
    save_rig(rig(FOCAL_PX), tmp_path)  # which clears what the killed ones left
    assert sorted(p.name for p in tmp_path.iterdir()) == ['left.yaml', 'previous', 'right.yaml']


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
