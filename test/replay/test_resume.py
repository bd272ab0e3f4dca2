# SPDX-License-Identifier: Apache-2.0
"""``reconstruct`` continues what was interrupted: the files are those of an undisturbed run."""

from __future__ import annotations

import contextlib
import json
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from binocular_recon.apps.earlier_run import fingerprint
from binocular_recon.apps.frame_formats import FRAME_FORMATS
from binocular_recon.calibration.session.calibration_files import save_rig
from binocular_recon.io.calibration_yaml import write_rig
from binocular_recon.io.files import ClaimedFolder
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
from test.replay.reconstruction import RANGE, Runner, kill, reconstruct, runs

FRAMES, LEFT_OUT = 8, 3
CLOUD = FRAME_FORMATS['ply']
# Everything that a frame takes over from those before it.
STATEFUL = ('--wls-video', '--drawings')


def exposed_bag(folder: Path) -> Path:
    """Write 16-bit pairs that get brighter and dark again: what is white depends on the stream.

    One pair has another size, and the calibration changes once.
    """
    records = []
    for index in range(FRAMES):
        stamp_ns = START_NS + index * PERIOD_NS
        cameras = rig(80.0 if index < 6 else 81.0)
        size = (HEIGHT, WIDTH) if index != LEFT_OUT else (HEIGHT - 8, WIDTH)
        gain = (2, 3, 40, 40, 3, 2, 2, 2)[index]
        for side, camera, pixels in zip(
            ('left', 'right'), (cameras.left, cameras.right), image_pair(index, size), strict=True
        ):
            message: Any = stereo_records(1)[1][1]
            grey = pixels[..., 0].astype(np.uint16) * gain
            fill_image(message, grey, 'mono16', header(stamp_ns))
            records += [
                (f'/{side}/camera_info', info_message(camera, stamp_ns), stamp_ns),
                (f'/{side}/image_raw', message, stamp_ns + 1),
            ]
    return write_bag(folder / 'bag', records)


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exposed_bag(tmp_path_factory.mktemp('exposed'))


@pytest.fixture(scope='module')
def undisturbed(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return what a run makes that nothing interrupts."""
    output = tmp_path_factory.mktemp('undisturbed')
    assert reconstruct(bag, output, *STATEFUL) == 1  # a pair is left out
    found = contents(output)
    kept = [one for one in FRAME_FORMATS.values() if not one.on_request]
    assert len(found) == (len(kept) + 1) * (FRAMES - 1) + 2  # with drawings, summary and log
    levels = found['summary']['progress']['chain']['levels']['uint16']
    assert levels['levels'] == [0, 1020]  # of the new calibration's chain
    return found


@pytest.mark.parametrize('interrupted', range(FRAMES - 1))
def test_a_run_interrupted_at_any_frame_is_continued(
    bag: Path,
    undisturbed: dict[str, Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    interrupted: int,
) -> None:
    made: list[str] = []

    def interrupt(path: Path, *parts: Any) -> None:
        made.append(path.name)
        if len(made) == interrupted + 1:
            raise KeyboardInterrupt
        CLOUD.write(path, *parts)

    cloud = CLOUD._replace(write=interrupt)
    monkeypatch.setitem(FRAME_FORMATS, 'ply', cloud)
    assert reconstruct(bag, tmp_path, *STATEFUL) == 130
    assert json.loads((tmp_path / 'summary.json').read_text())['finished'] is False
    assert reconstruct(bag, tmp_path, *STATEFUL) == 1
    assert contents(tmp_path) == undisturbed
    assert len(made) == FRAMES  # only the interrupted one was made twice


@pytest.mark.parametrize('removal', [1, 3])
def test_an_interruption_while_a_part_is_removed_leaves_none(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, removal: int
) -> None:
    remove, removed = shutil.rmtree, []

    def interrupt(path: Path, **options: Any) -> None:
        removed.append(path)
        if len(removed) == removal:
            raise KeyboardInterrupt
        remove(path, **options)

    monkeypatch.setattr(shutil, 'rmtree', interrupt)
    assert reconstruct(bag, tmp_path) == 130
    assert len(removed) > removal and not removed[removal - 1].exists()
    assert not list(tmp_path.glob('.*'))
    assert len(list(tmp_path.glob('*.ply'))) == removal


# What is there when a run is killed, and how; one that may end in order is first let make a frame.
KILLS = (
    ('.*.part', signal.SIGKILL),
    ('000001*', signal.SIGKILL),
    ('000002*', signal.SIGKILL),
    ('*.ply', signal.SIGTERM),
    ('*.ply', signal.SIGINT),
    ('000006*', signal.SIGKILL),
)


def test_a_run_killed_again_and_again_is_continued(
    bag: Path, undisturbed: dict[str, Any], tmp_path: Path
) -> None:
    output = tmp_path / 'out'
    output.mkdir()
    words = ['reconstruct', str(bag), '--output', str(output), *RANGE, *STATEFUL]
    statuses = []
    with contextlib.closing(Runner(tmp_path / 'log')) as runner:
        for pattern, number in (*KILLS, ('summary.json', 0)):
            clouds = {*output.glob('*.ply')}
            run = runner.start(words)
            known = set() if number == signal.SIGKILL else clouds
            while number and not {*output.glob(pattern)} - known and runs(run):
                time.sleep(0.001)
            if number:
                kill(run, number)
            statuses.append(runner.status())
    said = (tmp_path / 'log').read_text()
    assert 'Traceback' not in said, said
    assert statuses[:3] == [-signal.SIGKILL] * 3
    assert statuses[3:5] == [143, 130]
    assert re.search('reconstruct: terminated; [1-7] finished frames? (is|are) kept', said)
    assert statuses[-1] == 1
    assert contents(output) == undisturbed


def test_a_finished_run_is_not_made_again(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert reconstruct(bag, tmp_path, '--max-frames', '2') == 0
    said = capsys.readouterr().out
    before = {path.name: path.stat() for path in tmp_path.iterdir()}
    assert reconstruct(bag, tmp_path, '--max-frames', '2') == 0
    again = capsys.readouterr()
    assert again.out == said
    assert 'is finished already; --no-resume computes it again' in again.err
    assert {path.name: path.stat() for path in tmp_path.iterdir()} == before
    (tmp_path / '000001.ply').unlink()
    assert reconstruct(bag, tmp_path, '--max-frames', '2') == 0
    assert (tmp_path / '000001.ply').exists()


def interrupted_run(bag: Path, output: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave a run with two finished frames."""

    def interrupt(path: Path, *parts: Any) -> None:
        if path.name == '000002.ply':
            raise KeyboardInterrupt
        CLOUD.write(path, *parts)

    with monkeypatch.context() as patched:
        cloud = CLOUD._replace(write=interrupt)
        patched.setitem(FRAME_FORMATS, 'ply', cloud)
        assert reconstruct(bag, output) == 130


@pytest.mark.parametrize(
    ('change', 'reason'),
    [
        (('--speckle-size', '7'), 'its speckle_size is 200, now it is 7'),
        (('--every', '2'), 'its source.every is 1, now it is 2'),
        (('--preset', 'fast'), 'its preset is default, now it is fast'),
        (('--drawings',), 'its formats is '),
    ],
)
def test_another_run_does_not_replace_an_interrupted_one(
    bag: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    change: tuple[str, ...],
    reason: str,
) -> None:
    interrupted_run(bag, tmp_path, monkeypatch)
    before = contents(tmp_path)
    assert reconstruct(bag, tmp_path, *change) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert f'{tmp_path} holds 2 finished frames of an interrupted run' in error
    assert reason in error
    assert error.endswith('choose another folder, or start over (--no-resume)')
    assert contents(tmp_path) == before
    assert reconstruct(bag, tmp_path, *change, '--no-resume', '--max-frames', '1') == 0
    assert contents(tmp_path)['summary']['finished'] is True


def test_another_recording_or_a_missing_file_is_noticed(
    bag: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    output = tmp_path / 'out'
    interrupted_run(bag, output, monkeypatch)
    other = write_bag(tmp_path / 'bag', stereo_records(3))
    assert reconstruct(other, output) == 1
    assert 'its source.files.bag.mcap is ' in capsys.readouterr().err
    (output / '000000.ply').unlink()
    assert reconstruct(bag, output) == 1
    assert '000000.ply is missing' in capsys.readouterr().err


def test_a_calibration_that_was_changed_is_noticed(tmp_path: Path) -> None:
    """Also where folders in its folder hold files of the same name."""
    folder = tmp_path / 'rig'
    save_rig(rig(80.0), folder)
    save_rig(rig(81.0), folder)
    before = fingerprint(folder, '**/*')
    assert set(before) == {
        f'{place}{side}.yaml' for place in ('', 'previous/') for side in ('left', 'right')
    }
    assert before['left.yaml'] != before['previous/left.yaml']
    write_rig(folder, rig(82.0))
    changed = {name for name, text in fingerprint(folder, '**/*').items() if text != before[name]}
    assert changed == {'left.yaml', 'right.yaml'}


def test_results_in_the_folder_of_the_bag_are_continued(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = write_bag(tmp_path / 'bag', stereo_records(4))
    interrupted_run(bag, bag / 'results', monkeypatch)
    assert reconstruct(bag, bag / 'results') == 0
    assert len(contents(bag / 'results')['summary']['frames']) == 4


def test_a_summary_that_is_none_or_was_changed_is_not_continued(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / 'summary.json'
    interrupted_run(bag, tmp_path, monkeypatch)
    known = json.loads(path.read_text())
    changed = [
        {**known, 'progress': {**known['progress'], **other}}
        for other in ({'pairs': -1}, {'chain': 'x'}, {'refused': 7}, {'digest': None})
    ]
    for seconds in ('a', None, True):
        frames = [{**known['frames'][0], 'seconds': seconds}, known['frames'][1]]
        changed.append({**known, 'frames': frames})
    for content, reason in (
        ('', 'is not valid JSON'),
        ('[1]', 'is not the summary of frames'),
        ('{"mine": 1}', 'is not the summary of frames'),
        (100_000 * '[', 'is not valid JSON'),
        (json.dumps({**known, 'progress': [1]}), 'progress must be a dict'),
        (json.dumps({**known, 'frames': [{'index': 'x'}]}), 'frame 0 has another index'),
        *((json.dumps(one), 'its summary.json was changed') for one in changed),
    ):
        path.write_text(content)
        assert reconstruct(bag, tmp_path) == 1
        error = capsys.readouterr().err.splitlines()[-1]
        assert reason in error
        assert error.endswith('choose another folder, or start over (--no-resume)')
        assert path.read_text() == content
    assert reconstruct(bag, tmp_path, '--max-frames', '1', '--no-resume') == 0
    assert contents(tmp_path)['summary']['finished'] is True


def test_two_runs_do_not_write_to_one_folder(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    claim = ClaimedFolder(tmp_path)
    assert reconstruct(bag, tmp_path) == 1
    assert f'another process writes to {tmp_path}; wait until it is' in capsys.readouterr().err
    claim.release()
    (tmp_path / '.0a1b2c3d.part').mkdir()  # of a process that was killed
    (tmp_path / '.0a1b2c3d.part' / '000009.ply').write_text('cut')
    (tmp_path / '.summary.json.0a1b2c3d.part').write_text('cut')
    (tmp_path / '.mine.part').write_text('kept')
    assert reconstruct(bag, tmp_path, '--max-frames', '1') == 0
    assert {path.name for path in tmp_path.glob('.*')} == {'.mine.part'}
    assert not (tmp_path / '000009.ply').exists()


@pytest.mark.parametrize(
    ('number', 'status', 'word'),
    [(signal.SIGINT, 130, 'interrupted'), (signal.SIGTERM, 143, 'terminated')],
)
@pytest.mark.parametrize('stage', ['imports', 'compilation'])
def test_a_command_that_still_starts_ends_with_one_line(
    bag: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    stage: str,
    number: int,
    status: int,
    word: str,
) -> None:
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path / 'cache'))
    monkeypatch.setenv('NUMBA_CPU_NAME', 'generic')  # nor does one beside the sources fit
    words = ['reconstruct', str(bag), '--output', str(tmp_path / 'out')]
    command = [sys.executable, '-m', 'binocular_recon', *words]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    libraries = Path(f'/proc/{process.pid}/maps')
    while process.poll() is None and not (
        any((tmp_path / 'cache').glob('*/*.nbc'))
        if stage == 'compilation'
        else 'numpy' in libraries.read_text()
    ):
        time.sleep(0.001)
    process.send_signal(number)
    error = process.communicate()[1]
    assert process.returncode == status, error
    said = f'binocular-recon reconstruct: {word}'
    if stage == 'compilation':
        said += f'; 0 finished frames are kept in {tmp_path / "out"}'
    assert error == said + '\n'
    assert {path.name for path in tmp_path.glob('out/*')} <= {'summary.json', 'frames.jsonl'}
