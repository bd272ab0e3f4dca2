# SPDX-License-Identifier: Apache-2.0
"""Files are complete or absent."""

import contextlib
import errno
import os
import re
import signal
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from binocular_recon.errors import FileError
from binocular_recon.io.calibration_yaml import locked
from binocular_recon.io.files import (
    ClaimedFolder,
    complete_file,
    complete_files,
    make_folder,
    remove_abandoned,
    write_json,
)
from test.full_disk import largest_file


def write_half(path: Path, error: BaseException) -> None:
    with complete_file(path) as file:
        file.write(b'half')
        raise error


def test_an_interruption_keeps_the_old_file_and_leaves_no_part(tmp_path: Path) -> None:
    path = tmp_path / 'result.bin'
    path.write_bytes(b'old')
    with pytest.raises(KeyboardInterrupt):
        write_half(path, KeyboardInterrupt())
    assert path.read_bytes() == b'old'
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    'error', [None, KeyboardInterrupt('^C'), FileError('b cannot be written')]
)
def test_files_of_a_set_appear_together_or_not_at_all(
    tmp_path: Path, error: BaseException | None
) -> None:
    (tmp_path / 'a').write_text('old')
    seen = None if error is None else pytest.raises(type(error), match=re.escape(str(error)))
    with seen or contextlib.nullcontext(), complete_files(tmp_path) as parts:
        write_json(parts / 'a', 1)
        write_json(parts / 'b', 2)
        assert (tmp_path / 'a').read_text() == 'old' and not (tmp_path / 'b').exists()
        if error is not None:
            raise error
    left = {path.name: path.read_text() for path in tmp_path.iterdir()}
    assert left == ({'a': 'old'} if error else {'a': '1\n', 'b': '2\n'})


def test_a_set_that_cannot_take_its_place_is_a_file_error(tmp_path: Path) -> None:
    (tmp_path / 'a').mkdir()
    with (
        pytest.raises(FileError, match=r'cannot be written to: Is a directory; choose a folder'),
        complete_files(tmp_path) as parts,
    ):
        write_json(parts / 'a', 1)
    assert list(tmp_path.iterdir()) == [tmp_path / 'a']


def test_a_full_disk_says_so_and_leaves_no_part(tmp_path: Path) -> None:
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with pytest.raises(FileError, match=r'No space left on device; free some space'):
        write_half(tmp_path / 'result.bin', full)
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_the_system_refuses_to_grow_is_a_file_error(tmp_path: Path) -> None:
    (tmp_path / 'a.json').write_text('old')
    with largest_file(100_000), pytest.raises(FileError, match='File too large; free some space'):
        write_json(tmp_path / 'a.json', 'x' * 200_000)
    assert [path.read_text() for path in tmp_path.iterdir()] == ['old']


def test_what_nobody_writes_any_more_is_removed(tmp_path: Path) -> None:
    def names() -> set[str]:
        return {path.name for path in tmp_path.iterdir()}

    abandoned = '.0123abcd.part', '.a.json.0123abcd.part', '.b.0123abcd.part'
    (tmp_path / abandoned[0]).mkdir()
    (tmp_path / abandoned[0] / 'a').write_text('cut')
    (tmp_path / abandoned[1]).write_text('cut')
    os.mkfifo(tmp_path / abandoned[2])
    (tmp_path / '.mine.part').write_text('kept')
    with complete_file(tmp_path / 'c') as file, complete_files(tmp_path) as parts:
        file.write(b'c')
        (parts / 'd').write_text('d')
        remove_abandoned(tmp_path)
        assert names().isdisjoint(abandoned) and len(names()) == 3
    assert names() == {'.mine.part', 'c', 'd'}


def test_a_claim_does_not_keep_others_from_reading_and_its_end_lets_the_next_one_in(
    tmp_path: Path,
) -> None:
    claim = ClaimedFolder(tmp_path)
    with locked(tmp_path), pytest.raises(FileError, match='another process writes to'):
        ClaimedFolder(tmp_path)
    claim.release()
    (tmp_path / '.claim').touch()  # of a process that was killed
    claim = ClaimedFolder(tmp_path)
    with pytest.raises(FileError, match='another process writes to'):
        ClaimedFolder(tmp_path)
    claim.release()
    assert not list(tmp_path.iterdir())


def test_claims_of_many_threads_exclude_each_other(tmp_path: Path) -> None:
    inside, most = [0], [0]

    def claim() -> int:
        count = 0
        while count < 20:
            with contextlib.suppress(FileError):
                claimed = ClaimedFolder(tmp_path)
                inside[0] += 1
                most[0] = max(most[0], inside[0])
                inside[0] -= 1
                claimed.release()
                count += 1
        return count

    with ThreadPoolExecutor(4) as pool:
        assert sum(pool.map(lambda _: claim(), range(4))) == 80
    assert most == [1]
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not Path('/dev/full').exists(), reason='needs /dev/full')
def test_a_device_is_written_to_and_not_replaced(tmp_path: Path) -> None:
    device = tmp_path / 'device'
    device.symlink_to('/dev/full')
    with pytest.raises(FileError, match='No space left'):
        write_json(device, {'x': 1})
    device.unlink()
    device.symlink_to('/dev/null')
    write_json(device, {'x': 1})
    assert device.is_symlink() and device.is_char_device()


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r'none/a\.json cannot be written: No such file'):
        write_json(tmp_path / 'none' / 'a.json', {})


def test_a_file_where_a_folder_is_wanted(tmp_path: Path) -> None:
    (tmp_path / 'taken').write_text('')
    with pytest.raises(FileError, match=r'taken/out cannot be made: Not a directory'):
        make_folder(tmp_path / 'taken' / 'out')


def test_json_refuses_values_that_json_has_not(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match='not JSON compliant'):
        write_json(tmp_path / 'a.json', {'x': float('nan')})
    assert list(tmp_path.iterdir()) == []


def test_an_interruption_waits_until_all_files_are_in_place(tmp_path: Path) -> None:
    done: list[str] = []

    def completed() -> None:
        signal.raise_signal(signal.SIGINT)  # noticed after the block
        done.append('completed')

    def write() -> None:
        with complete_files(tmp_path, completed) as parts:
            for name in ('a', 'b'):
                (parts / name).write_text(name)

    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        write()
    assert done == ['completed']
    assert sorted(path.name for path in tmp_path.iterdir()) == ['a', 'b']
    assert signal.getsignal(signal.SIGINT) == before


def test_an_interruption_while_files_are_written_leaves_none(tmp_path: Path) -> None:
    done: list[str] = []

    def write() -> None:
        with complete_files(tmp_path, lambda: done.append('completed')) as parts:
            (parts / 'a').write_text('a')
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        write()
    assert not done
    assert not list(tmp_path.iterdir())
