# SPDX-License-Identifier: Apache-2.0
"""Other programs in the evaluation: each format they write, each way they fail."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from binocular_recon.cli.main import main
from binocular_recon.errors import ConfigError, FileError
from binocular_recon.evaluation.accuracy.external import ExternalPeer, external_peer
from binocular_recon.evaluation.accuracy.methods import PeerError
from binocular_recon.evaluation.speed.synthetic import SyntheticPair
from binocular_recon.images import FloatImage
from binocular_recon.io.disparity_files import read_disparity_file
from binocular_recon.io.disparity_png import write_disparity_png
from binocular_recon.io.pfm import write_pfm
from test.unit.evaluation.scene_folder import RANGE, write_scene

FILES = '{left} {right} {output}'


def write_map(path: Path, disparity_px: FloatImage) -> None:
    """Write a disparity map with NaN in the format of its ending, as other programs do."""
    if path.suffix == '.npy':
        np.save(path, disparity_px[None].astype(np.float64))
    elif path.suffix == '.tiff':
        cv2.imwrite(str(path), disparity_px)
    elif path.suffix == '.png':
        write_disparity_png(path, disparity_px)
    else:
        write_pfm(path, disparity_px)


@pytest.mark.parametrize('ending', ['.pfm', '.png', '.tiff', '.npy'])
def test_each_format_is_read(pair: SyntheticPair, tmp_path: Path, ending: str) -> None:
    truth = pair.disparity_px.copy()
    truth[:5] = np.nan
    written = tmp_path / f'theirs{ending}'
    write_map(written, truth)
    words = f'sh -c \'test -s "$0" -a -s "$1" -a $2 = {RANGE} && cp "$3" "$4"\''
    command = f'{words} {{left}} {{right}} {{range}} {written} {{output}}{ending}'
    run = external_peer(f'theirs={command}').method().prepare(pair.left, pair.right, RANGE)
    for _ in range(2):
        found = run()
        np.testing.assert_allclose(found.disparity_px, truth, atol=1 / 500)
    assert found.sigma_px is None and found.measured is None


def test_files_that_are_no_disparity_map_are_refused(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / 'colour.tiff'), np.zeros((4, 5, 3), np.float32))
    cv2.imwrite(str(tmp_path / 'byte.png'), np.zeros((4, 5), np.uint8))
    np.save(tmp_path / 'objects.npy', np.array([{}], object), allow_pickle=True)
    np.save(tmp_path / 'cube.npy', np.zeros((2, 3, 4)))
    np.savez(tmp_path / 'several.npz', a=np.zeros((2, 3)))
    (tmp_path / 'several.npz').rename(tmp_path / 'several.npy')
    (tmp_path / 'text.npy').write_text('1 2 3')
    whole = tmp_path / 'whole.npy'
    np.save(whole, np.zeros((40, 50)))
    (tmp_path / 'short.npy').write_bytes(whole.read_bytes()[:-8])
    (tmp_path / 'map.exr').write_bytes(b'')
    (tmp_path / 'folder.pfm').mkdir()
    for name, message in {
        'colour.tiff': r'one channel of float32 px.* got float32 of shape \(4, 5, 3\)',
        'byte.png': '16-bit grey is needed, got uint8',
        'objects.npy': 'is not an npy file of numbers',
        'cube.npy': r'numbers of shape \(rows, columns\) are needed, .* \(2, 3, 4\)',
        'several.npy': r'several arrays \(npz\)',
        'text.npy': 'text.npy is not an npy file',
        'short.npy': 'is not an npy file of numbers',
        'absent.npy': 'cannot be read: No such file',
        'map.exr': "'.exr' is not a format of disparity maps",
        'folder.pfm': 'is not a file',
    }.items():
        with pytest.raises(FileError, match=message):
            read_disparity_file(tmp_path / name)


def test_programs_that_fail_do_not_stop_the_table(
    scenes: Path, pair: SyntheticPair, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_scene(scenes / 'square', pair, {'source': 'x', 'max_disparity_px': RANGE // 2})
    good, small = tmp_path / 'good.pfm', tmp_path / 'small.pfm'
    write_pfm(good, pair.disparity_px)
    write_pfm(small, pair.disparity_px[:-1])
    peers = {
        'copies': f'sh -c \'cp {good} "$2"\'',
        'absent': '/nowhere/matcher',
        'fails': "sh -c 'echo one >&2; echo no licence >&2; exit 3'",
        'silent': 'true',
        'small': f'sh -c \'cp {small} "$2"\'',
        'damaged': 'sh -c \'echo Pf > "$2"\'',
        'killed': "sh -c 'kill -9 $$'",
        'narrow': f'sh -c \'test $3 = {RANGE} && cp {good} "$2"\' {FILES} {{range}}',
    }
    words = [word for name, command in peers.items() for word in ('--peer', f'{name}={command}')]
    words += ['--no-peers', '--presets', '', '--repeat', '2']
    assert main(['evaluate', str(scenes), *words, '--output', str(tmp_path / 'out')]) == 0
    printed = capsys.readouterr().out
    for text in (
        'absent gave no result for park: /nowhere/matcher cannot be started: No such file',
        'fails gave no result for park: failed with status 3: no licence.',
        'silent gave no result for park: wrote no disparity.pfm.',
        'small gave no result for park: disparity.pfm is 200x119 px, the images are 200x120 px.',
        'damaged gave no result for park: disparity.pfm is not a PFM file',
        'killed gave no result for park: was ended by SIGKILL: it said nothing.',
        'killed gave no result for square: was ended by SIGKILL: it said nothing.',
    ):
        assert text in printed
    row = next(line for line in printed.splitlines() if line.startswith('| copies '))
    assert [float(cell) for cell in row.split('|')[2:5]] == [0, 0, 0]
    assert '| narrow (1 of 2 scenes) ' in printed
    facts = json.loads((tmp_path / 'out/evaluation.json').read_text())
    park, square = facts['scenes']
    assert sorted(park['failures']) == sorted(set(peers) - {'copies', 'narrow'})
    assert sorted(square['failures']) == sorted(set(peers) - {'copies'})
    by_name = {score['method']: score for score in park['scores']}
    assert 0 < by_name['copies']['seconds'] < 60
    assert by_name['silent']['seconds'] is None
    assert by_name['silent']['everywhere']['bad_percent'] == [None, None, None]


def test_a_program_that_takes_too_long_is_stopped(pair: SyntheticPair) -> None:
    peer = ExternalPeer('slow', "sh -c 'sleep 600'", timeout_s=0.2)
    with pytest.raises(PeerError, match=r'stopped after 0\.2 s'):
        peer.method().prepare(pair.left, pair.right, RANGE)()


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('matcher', 'a peer is NAME=COMMAND'),
        ('=matcher', 'a peer is NAME=COMMAND'),
        ('x= ', 'a peer is NAME=COMMAND'),
        ('a|b=true', r"a cell of a table, got 'a\|b'"),
        ("x=sh -c 'open", 'No closing quotation'),
        ('x=matcher {left} {output}', r'lacks \{right\}; name all of'),
    ],
)
def test_commands_that_are_none_are_refused(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        external_peer(text)


def test_two_peers_of_one_name_are_wrong_usage(
    scenes: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ['--peer', 'a=true', '--peer', 'a=false', '--no-peers', '--presets', '']
    assert main(['evaluate', str(scenes), *words]) == 2
    assert "two methods are called 'a'" in capsys.readouterr().err


def test_a_program_gets_its_files_last_if_it_names_none(
    pair: SyntheticPair, tmp_path: Path
) -> None:
    listed = tmp_path / 'listed'
    peer = ExternalPeer('lists', f'sh -c \'echo "$0 $1 $2" > {listed}\'')
    run = peer.method().prepare(pair.left, pair.right, RANGE)
    with pytest.raises(PeerError, match='wrote no'):
        run()
    assert [Path(word).name for word in listed.read_text().split()] == [
        'left.png',
        'right.png',
        'disparity.pfm',
    ]
