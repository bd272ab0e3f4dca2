# SPDX-License-Identifier: Apache-2.0
"""Segments of dead processes are removed from shared memory, and those of living ones never."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from binocular_recon.nodes.runtime import shared_memory
from test.conftest import REPOSITORY

OWNER = """
import fcntl, sys
file = open(sys.argv[1])
fcntl.flock(file, fcntl.LOCK_EX)
print('locked', flush=True)
sys.stdin.read()
"""


def segment(folder: Path, name: str, age_s: float = 60.0) -> Path:
    """Make a segment as Fast DDS does, and return its lock file."""
    (folder / name).write_bytes(b'x' * 8192)
    lock = folder / f'{name}_el'
    lock.touch()
    made_s = lock.stat().st_mtime - age_s
    os.utime(lock, (made_s, made_s))
    return lock


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_a_segment_goes_when_its_owner_is_dead(tmp_path: Path) -> None:
    lock = segment(tmp_path, 'fastdds_0123456789abcdef')
    segment(tmp_path, 'fastrtps_0123456789abcdef')
    young = segment(tmp_path, 'fastdds_0123456789abcdee', age_s=0.0)
    others = {'fastdds_port7411', 'sem.fastdds_port7411_mutex', 'mine', 'fastdds_x_el'}
    for name in others:
        (tmp_path / name).touch()
    command = [sys.executable, '-c', OWNER, str(lock)]
    with subprocess.Popen(command, stdin=-1, stdout=-1) as owner:
        assert owner.stdout
        assert owner.stdout.readline() == b'locked\n'
        assert shared_memory.remove_leftovers(tmp_path) >= 8192
        kept = {lock.name, lock.name[:-3], young.name, young.name[:-3]}
        assert names(tmp_path) == kept | others
        owner.kill()
    assert shared_memory.remove_leftovers(tmp_path) >= 8192
    assert names(tmp_path) == {young.name, young.name[:-3]} | others


def test_a_segment_of_another_user_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    segment(tmp_path, 'fastdds_0123456789abcdef')
    mine = os.getuid()
    monkeypatch.setattr(os, 'getuid', lambda: mine + 1)
    assert shared_memory.remove_leftovers(tmp_path) == 0
    assert len(names(tmp_path)) == 2


def test_a_shared_lock_counts_too(tmp_path: Path) -> None:
    lock = segment(tmp_path, 'fastdds_0123456789abcdef')
    with lock.open() as file:
        fcntl.flock(file, fcntl.LOCK_SH)
        assert shared_memory.remove_leftovers(tmp_path) == 0
    assert len(names(tmp_path)) == 2


def test_there_may_be_no_shared_memory(tmp_path: Path) -> None:
    assert shared_memory.remove_leftovers(tmp_path / 'none') == 0
    assert 'none cannot be used (No such file' in shared_memory.shortage(tmp_path / 'none')


@pytest.mark.parametrize(('free', 'short'), [(1 << 30, False), (60 << 20, True)])
def test_too_little_is_said_with_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, free: int, short: bool
) -> None:
    disk = SimpleNamespace(f_bavail=free // 4096, f_frsize=4096, f_blocks=(64 << 20) // 4096)
    monkeypatch.setattr(os, 'statvfs', lambda _: disk)
    for name in shared_memory.PROFILE_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    assert not shared_memory.shortage(tmp_path)
    profile = REPOSITORY / 'config' / 'fastdds_shared_memory.xml'
    monkeypatch.setenv(shared_memory.PROFILE_VARIABLES[0], str(profile))
    assert shared_memory.segment_bytes() == 64 << 20
    text = shared_memory.shortage(tmp_path)
    assert bool(text) is short
    if short:
        assert 'has 60 of 64 MiB free, and each process takes 70 MiB' in text
        assert 'docker run --shm-size=1g' in text
    monkeypatch.setenv(shared_memory.PROFILE_VARIABLES[0], str(tmp_path / 'gone.xml'))
    assert not shared_memory.shortage(tmp_path)


@pytest.mark.parametrize(
    ('name', 'used'), [(None, True), ('rmw_fastrtps_cpp', True), ('rmw_cyclonedds_cpp', False)]
)
def test_other_middleware_is_left_alone(
    monkeypatch: pytest.MonkeyPatch, name: str | None, used: bool
) -> None:
    if name:
        monkeypatch.setenv('RMW_IMPLEMENTATION', name)
    else:
        monkeypatch.delenv('RMW_IMPLEMENTATION', raising=False)
    assert shared_memory.in_use() is used
