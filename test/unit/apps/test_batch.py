# SPDX-License-Identifier: Apache-2.0
"""Frames that are computed at the same time are those of one process, to the bit."""

from __future__ import annotations

import json
import multiprocessing
import os
import pickle
import random
import signal
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from binocular_recon.apps import reconstruction
from binocular_recon.apps.bag_input import BagInput
from binocular_recon.apps.batch import worker
from binocular_recon.apps.batch.dask_cluster import (
    DaskCluster,
    check_versions,
    compute_remotely,
)
from binocular_recon.apps.batch.frame_task import (
    FrameFailedError,
    FrameOutcome,
    FrameTask,
    compute_frame,
)
from binocular_recon.apps.batch.local_processes import LocalProcesses
from binocular_recon.apps.batch.places import ThisProcess
from binocular_recon.apps.frame_formats import FRAME_FORMATS
from binocular_recon.apps.output_folder import ResultFolder
from binocular_recon.apps.reconstruction import reconstruct_pairs
from binocular_recon.config import ChainConfig
from binocular_recon.errors import (
    BagError,
    BinocularReconError,
    ClusterError,
    ConfigError,
    DependencyError,
    FileError,
)
from binocular_recon.io.messages.images import fill_image
from test.bag_tools import (
    HEIGHT,
    PERIOD_NS,
    START_NS,
    WIDTH,
    header,
    image_pair,
    info_message,
    rig,
    stereo_records,
    write_bag,
)
from test.frame_results import contents
from test.full_disk import largest_file

CONFIG = ChainConfig.preset('default', disparity_range=16)
FRAMES = 26
BRIGHT, DARK, WRONG_SIZE, COVERED = (4, 5), (1, 3, 9, 15, 22), (7,), (2, 12, 20)
NEW_RIG = 23


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write 16-bit pairs in whose stream everything happens that later frames depend on.

    Brightness changes; nothing can be matched in some pairs, little in others, another size has
    one, and the calibration changes.
    """
    records = []
    for index in range(FRAMES):
        stamp_ns = START_NS + index * PERIOD_NS
        cameras = rig(81.0 if index >= NEW_RIG else 80.0)
        size = (HEIGHT - 8, WIDTH) if index in WRONG_SIZE else (HEIGHT, WIDTH)
        left, right = image_pair(index, size)
        if index in COVERED:
            weak = np.random.default_rng(index).integers(128, 131, right.shape, np.uint8)
            right[14:] = weak[14:]
        gain = 40 if index in BRIGHT else 0 if index in DARK else 3
        for side, camera, pixels in (
            ('left', cameras.left, left),
            ('right', cameras.right, right),
        ):
            message: Any = stereo_records(1)[1][1]
            fill_image(
                message, pixels[..., 0].astype(np.uint16) * gain + 1, 'mono16', header(stamp_ns)
            )
            records += [
                (f'/{side}/camera_info', info_message(camera, stamp_ns), stamp_ns),
                (f'/{side}/image_raw', message, stamp_ns + 1),
            ]
    return write_bag(tmp_path_factory.mktemp('stream') / 'bag', records)


def fails(bag: Path, output: Path, **options: Any) -> str:
    """Reconstruct a bag of which some pairs cannot be; return why."""
    with pytest.raises(BagError) as caught:
        reconstruct_pairs(BagInput(bag=bag), output, 'default', CONFIG, **options)
    return str(caught.value)


@pytest.fixture(scope='module')
def alone(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return what one process makes."""
    output = tmp_path_factory.mktemp('alone')
    assert f'{len(WRONG_SIZE + DARK)} of {FRAMES} pairs were left out' in fails(bag, output)
    found = contents(output)
    progress = found['summary']['progress']
    assert progress['chain']['frames'] == FRAMES - NEW_RIG
    few = sum('findings' in frame for frame in found['summary']['frames'])
    assert few >= len(COVERED)
    return found


class Threads:
    """Compute frames in threads, in any order."""

    capacity, compiles = 7, True

    def __init__(self) -> None:
        self._threads = ThreadPoolExecutor(3)
        self._order = random.Random(3)

    def submit(self, task: FrameTask, folder: Path) -> Future[FrameOutcome]:
        sent = pickle.loads(pickle.dumps(task))
        delay_s = self._order.choice([0.0, 0.05])

        def compute() -> FrameOutcome:
            time.sleep(delay_s)
            outcome: FrameOutcome = pickle.loads(pickle.dumps(compute_frame(sent, folder)))
            return outcome

        return self._threads.submit(compute)

    def opening(self) -> str:
        return 'three threads'

    def remark(self, outcome: FrameOutcome) -> str:
        assert outcome.entry
        return ''

    def close(self) -> None:
        self._threads.shutdown(cancel_futures=True)


def test_the_order_in_which_frames_are_computed_does_not_matter(
    bag: Path, alone: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reconstruction, '_place', lambda *_: Threads())
    said: list[str] = []
    fails(bag, tmp_path, report=said.append)
    assert 'three threads' in said
    assert contents(tmp_path) == alone
    # as many pairs are read as one process reads, and an earlier run is continued
    for most in (3, 20):
        source = BagInput(bag=bag, max_frames=most)
        folders = tmp_path / f'{most}', tmp_path / f'{most} alone'
        for folder in folders:
            place = Threads() if folder is folders[0] else ThisProcess()
            monkeypatch.setattr(reconstruction, '_place', lambda *_, place=place: place)
            with pytest.raises(BagError):
                reconstruct_pairs(source, folder, 'default', CONFIG)
        assert contents(folders[0]) == contents(folders[1])


@pytest.fixture
def two_cores(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(os, 'sched_getaffinity', lambda _: {0, 1})
    yield
    assert not multiprocessing.active_children()


@pytest.mark.usefixtures('two_cores')
@pytest.mark.long
def test_two_processes_make_the_same_and_a_killed_one_loses_nothing(
    bag: Path, alone: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    add, killed = ResultFolder.add, []

    def kill(self: ResultFolder, *parts: Any, **more: Any) -> None:
        add(self, *parts, **more)
        if len(self.frames) == 2:
            process = multiprocessing.active_children()[0]
            process.kill()
            killed.append(process.pid)

    monkeypatch.setattr(ResultFolder, 'add', kill)
    said: list[str] = []
    fails(bag, tmp_path, jobs=2, report=said.append)
    assert killed
    assert '2 processes with 1 thread each' in said
    assert any(line.startswith('memory: ') for line in said)
    assert contents(tmp_path) == alone


def small_task(bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FrameTask:
    """Return the task of the first pair."""
    tasks: list[FrameTask] = []

    class Keeping(ThisProcess):
        def submit(self, task: FrameTask, folder: Path) -> Future[FrameOutcome]:
            tasks.append(task)
            return super().submit(task, folder)

    monkeypatch.setattr(reconstruction, '_place', lambda *_: Keeping())
    source = BagInput(bag=bag, max_frames=1)
    reconstruct_pairs(source, tmp_path / 'first', 'default', CONFIG)
    return tasks[0]


@pytest.mark.usefixtures('two_cores')
def test_a_frame_that_kills_its_process_twice_has_failed(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    task = small_task(bag, tmp_path, monkeypatch)
    folder = tmp_path / 'parts'
    folder.mkdir()
    place = LocalProcesses(1)
    try:
        for reason, error in (
            (
                'computed 2 times without a result: .* by SIGKILL, as the .* memory',
                FrameFailedError,
            ),
            ('processes for frames cannot be started', BinocularReconError),
        ):
            future = place.submit(task, folder)
            while not future.done():
                for process in multiprocessing.active_children():
                    process.kill()
            with pytest.raises(error, match=reason):
                future.result()
    finally:
        place.close()


def test_a_frame_that_fails_is_tried_again_and_listed_and_the_run_goes_on(
    bag: Path, alone: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec, tries = FRAME_FORMATS['ply'], []

    def short(path: Path, *parts: Any) -> None:
        spec.write(path, *parts)
        tries.append(path.name)
        if len(tries) == 1:
            raise MemoryError('9 GiB')
        if path.name == '000001.ply' and tries.count(path.name) <= 2:
            raise KeyError('x')

    monkeypatch.setitem(FRAME_FORMATS, 'ply', spec._replace(write=short))
    source = BagInput(bag=bag, max_frames=3)
    with pytest.raises(BagError, match='3 of 6 pairs were left out'):
        reconstruct_pairs(source, tmp_path, 'default', CONFIG)
    assert tries[:4] == ['000000.ply'] * 2 + ['000001.ply'] * 2
    summary = json.loads((tmp_path / 'summary.json').read_text())
    reasons = [entry['reason'] for entry in summary['left_out']]
    assert "computed 2 times without a result: KeyError: 'x' (test_batch.py, line" in reasons[1]
    assert [frame['index'] for frame in summary['frames']] == [0, 1, 2]
    assert (tmp_path / '000000.ply').read_bytes() == alone['000000.ply']
    assert not list(tmp_path.glob('.*'))


def test_a_full_disk_ends_the_run_and_keeps_its_frames(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = FRAME_FORMATS['ply']

    def full(path: Path, *parts: Any) -> None:
        if path.name >= '000006.ply':
            raise OSError(28, 'No space left on device')
        spec.write(path, *parts)

    monkeypatch.setattr(reconstruction, '_place', lambda *_: Threads())
    monkeypatch.setitem(FRAME_FORMATS, 'ply', spec._replace(write=full))
    with pytest.raises(FileError, match='No space left on device; free some space'):
        reconstruct_pairs(BagInput(bag=bag), tmp_path, 'default', CONFIG)
    summary = json.loads((tmp_path / 'summary.json').read_text())
    assert summary['finished'] is False
    assert len(list(tmp_path.glob('*.ply'))) == len(summary['frames']) > 0
    assert not list(tmp_path.glob('.*'))


@pytest.mark.parametrize('when', ['before it is ready', 'during a frame', 'after a frame'])
def test_a_process_whose_parent_is_killed_ends_without_an_error(
    when: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, there = multiprocessing.Pipe()
    monkeypatch.setattr(signal, 'signal', lambda *_: None)  # this process hears Ctrl-C
    monkeypatch.setattr(worker, 'limit_threads', lambda _: None)

    def compute(*_: object) -> str:
        if when == 'during a frame':
            here.close()
        return 'made'

    def take_and_end() -> None:
        assert [here.recv(), here.recv()] == [worker.READY, 'made']
        here.close()

    monkeypatch.setattr(worker, 'compute_frame', compute)
    if when == 'before it is ready':
        here.close()
    else:
        here.send(('task', 'folder'))
    parent = threading.Thread(target=take_and_end)
    if when == 'after a frame':
        parent.start()
    worker.serve(there, 1)
    if when == 'after a frame':
        parent.join(60)
    assert here.closed


@pytest.mark.parametrize(
    ('options', 'reason'),
    [
        ({'jobs': 0}, 'jobs must be 1 to '),
        ({'jobs': -1}, 'jobs must be 1 to '),
        ({'jobs': 10_000}, 'the number of cores that this process may use, got 10000'),
        ({'jobs': 2, 'scheduler': 'tcp://127.0.0.1:9'}, 'omit one of them'),
        ({'jobs': 2, 'video': True}, 'with wls_video each frame starts from the one before'),
    ],
)
def test_numbers_of_processes_that_make_no_sense_are_refused(
    bag: Path, tmp_path: Path, options: dict[str, Any], reason: str
) -> None:
    config = ChainConfig.preset('default', wls_video=options.pop('video', False))
    with pytest.raises(ConfigError, match=reason):
        reconstruct_pairs(BagInput(bag=bag), tmp_path / 'out', 'default', config, **options)
    assert not (tmp_path / 'out').exists()


def test_workers_of_other_versions_are_refused() -> None:
    ours = {'binocular_recon': '0.1.0', 'numpy': '2.3.0', 'scipy': '1', 'numba': '1', 'cv2': '5'}
    client = {'packages': ours}
    check_versions({'client': client, 'workers': {'tcp://b:1': {'packages': dict(ours)}}})
    for name, theirs, has in (
        ('binocular_recon', '0.0.9', 'has binocular_recon 0.0.9, this machine has 0.1.0'),
        ('binocular_recon', None, 'does not have binocular_recon'),
        ('numpy', '1.26.4', 'has numpy 1.26.4, this machine has 2.3.0'),
    ):
        workers = {'tcp://b:1': {'packages': {**ours, name: theirs}}}
        with pytest.raises(ClusterError, match=f'the worker tcp://b:1 {has}.*the same version'):
            check_versions({'client': client, 'workers': workers})


class FakeDistributed(SimpleNamespace):
    """The names of the package that are used, with a scheduler that fails as told."""

    class KilledWorker(Exception):  # noqa: N818 - its name there
        pass

    class CommClosedError(OSError):
        pass

    def __init__(self, *, connects: bool = True, fails: type[BaseException] = OSError) -> None:
        super().__init__(comm=self, fails=fails)
        self.Client = self if connects else None

    def resolve_address(self, address: str) -> None:
        if not self.Client:
            raise OSError(f'unknown host in {address}')

    def __call__(self, *_: Any, **__: Any) -> FakeDistributed:
        return self

    def nthreads(self) -> dict[str, int]:
        return {}

    def submit(self, *_: Any, **__: Any) -> Future[FrameOutcome]:
        future: Future[FrameOutcome] = Future()
        future.set_exception(self.fails('frame-1'))
        return future

    def close(self, **_: Any) -> None:
        pass


def test_what_a_cluster_lacks_is_one_sentence(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, 'distributed', None)
    with pytest.raises(DependencyError, match=r"pip install 'binocular_recon\[cluster\]'"):
        DaskCluster('tcp://127.0.0.1:9')
    monkeypatch.setitem(sys.modules, 'distributed', FakeDistributed(connects=False))
    with pytest.raises(ClusterError, match=r"no Dask scheduler answers at 'x:1' .*`dask schedul"):
        DaskCluster('x:1')
    task = small_task(bag, tmp_path, monkeypatch)
    folder = tmp_path / 'parts'
    folder.mkdir()
    for fails, error, reason in (
        (FakeDistributed.KilledWorker, FrameFailedError, 'the workers that computed it were lost'),
        (CancelledError, ClusterError, 'the Dask scheduler at x:1 is gone; start it and its work'),
        (FakeDistributed.CommClosedError, ClusterError, 'run the same command again to continue'),
    ):
        monkeypatch.setitem(sys.modules, 'distributed', FakeDistributed(fails=fails))
        cluster = DaskCluster('x:1')
        assert cluster.opening() == 'x:1 has no workers yet; frames wait for them'
        with pytest.raises(error, match=reason):
            cluster.submit(task, folder).result()
        cluster.close()


def test_the_full_disk_of_a_worker_is_the_fault_of_a_frame(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    task = small_task(bag, tmp_path, monkeypatch)
    outcome, files = compute_remotely(task)
    assert outcome.entry and {Path(name).stem[:6] for name in files} == {'000000'}
    with (
        largest_file(1000),
        pytest.raises(FrameFailedError, match=r'on a worker .*free some spac'),
    ):
        compute_remotely(task)


@pytest.mark.long
def test_workers_of_a_cluster_make_the_same_and_a_killed_one_loses_nothing(
    bag: Path, alone: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    distributed = pytest.importorskip('distributed')
    add = ResultFolder.add
    cluster = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host='127.0.0.1'
    )
    killed: list[int] = []

    def kill(self: ResultFolder, *parts: Any, **more: Any) -> None:
        add(self, *parts, **more)
        if len(self.frames) == 2:
            killed.append(cluster.workers[0].pid)
            os.kill(killed[0], signal.SIGKILL)

    monkeypatch.setattr(ResultFolder, 'add', kill)
    with cluster:
        fails(bag, tmp_path, scheduler=cluster.scheduler_address)
    assert killed
    assert contents(tmp_path) == alone
