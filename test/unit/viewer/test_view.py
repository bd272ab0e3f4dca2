# SPDX-License-Identifier: Apache-2.0
"""The page's state and server without a browser: clicks, the picks file, and who is let in."""

from __future__ import annotations

import http.client
import importlib
import json
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest

from binocular_recon.apps.survey.measured_folder import MeasuredFolder
from binocular_recon.camera import FloatArray
from binocular_recon.cli.main import main
from binocular_recon.errors import ConfigError, FileError, MeasurementError
from binocular_recon.measurement.picks import Pick, Request, read_picks, write_picks
from binocular_recon.stereo.validity import Validity
from binocular_recon.viewer.actions import ACTIONS, LONGEST_MESSAGE, answer, state_of
from binocular_recon.viewer.coloured_frame import COLOURS, ColouredFrame
from binocular_recon.viewer.page_server import PageServer
from binocular_recon.viewer.picks_board import MOST_PICKS, PicksBoard
from binocular_recon.viewer.shared_view import SharedView
from test.unit.measurement.measured_site import MeasuredSite, write_output

HOLE = (slice(20, 60), slice(30, 80))
ON_HOLE = (55.0, 40.0)


@pytest.fixture(scope='module')
def site() -> MeasuredSite:
    """Return a site of which a part was not measured."""
    site = MeasuredSite(0)
    site.frame.validity[HOLE] = Validity.FILLED | Validity.LOW_TEXTURE
    return site


@pytest.fixture(scope='module')
def output(site: MeasuredSite, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_output(site, tmp_path_factory.mktemp('out'), frames=6)


@pytest.fixture(scope='module')
def folder(output: Path) -> MeasuredFolder:
    return MeasuredFolder(output)


@pytest.fixture
def view(folder: MeasuredFolder, tmp_path: Path) -> SharedView:
    return SharedView(folder, PicksBoard(tmp_path / 'picks.yaml'))


@pytest.fixture(scope='module')
def spots(site: MeasuredSite) -> FloatArray:
    """Return pixels (n, 2) that can be picked."""
    pixels = site.random_pixels(np.random.default_rng(4), 40)[0]
    columns, rows = pixels.T
    near = 10  # of the hole
    beside = (np.abs(columns - 55) > 25 + near) | (np.abs(rows - 40) > 20 + near)
    chosen: FloatArray = pixels[beside][:8]
    return chosen


def ask(view: SharedView, do: str, **fields: object) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(answer(view, json.dumps({'do': do, 'id': 7, **fields})))
    assert found.pop('id') == 7
    return found


def state(view: SharedView) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(state_of(view))['state']
    return found


def test_two_clicks_give_the_length_that_measure_reports(
    view: SharedView, spots: FloatArray, output: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for u, v in spots[:2].tolist():
        assert ask(view, 'click', u=u, v=v) == {'done': None}
    shown = state(view)
    (length,) = shown['measurements']
    assert length['name'] == 'distance P1 P2' and length['label'].endswith(' m')
    assert main(['measure', str(output), '--picks', str(view.board.path)]) == 0
    assert length['label'] in capsys.readouterr().out
    assert [pick['name'] for pick in shown['picks']] == ['P1', 'P2']
    assert [one['what'] for one in shown['picks'][0]['quantities']] == ['x', 'y', 'z']
    (output / 'picks.csv').unlink()
    # what another view reads is the same
    again = SharedView(view.folder, PicksBoard(view.board.path))
    assert state(again)['measurements'] == shown['measurements']


def test_a_hole_is_answered_as_by_measure(
    view: SharedView, output: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = ask(view, 'click', u=ON_HOLE[0], v=ON_HOLE[1])
    picks = tmp_path / 'hole.csv'
    write_picks(picks, [Pick('P1', np.array(ON_HOLE))])
    assert main(['measure', str(output), '--picks', str(picks)]) == 1
    assert found['error'] in capsys.readouterr().err
    assert 'too little texture' in found['error']
    assert not view.board.path.exists() and not view.board.can_undo
    # corners of a polygon need no surface of their own, but lie in the image
    ask(view, 'kind', kind='plane')
    assert 'outside' in ask(view, 'click', u=-3, v=5)['error']
    assert ask(view, 'click', u=ON_HOLE[0], v=ON_HOLE[1]) == {'done': None}
    assert state(view)['picks'][0]['problem'] == found['error']
    assert 'on a hole' in ask(view, 'probe', u=ON_HOLE[0], v=ON_HOLE[1])['done']['problem']


def test_a_hole_is_picked_in_both_images(
    site: MeasuredSite, spots: FloatArray, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = write_output(site, tmp_path / 'out', frames=2)
    view = SharedView(MeasuredFolder(output), PicksBoard(output / 'picks.yaml'))
    assert state(view)['shown']['right'] is None
    shutil.copy(output / '000000_left.png', output / '000000_right.png')
    assert state(view)['shown']['right'].startswith('right.png?')
    assert 'in the left image first' in ask(view, 'click_right', u=5, v=5)['error']
    (u, v), (over, down) = ON_HOLE, spots[0].tolist()
    disparity = float(site.frame.disparity_px[int(v), int(u)])
    ask(view, 'click', u=over, v=down)
    assert ask(view, 'click', u=u, v=v, both=True) == {'done': None}
    assert state(view)['awaited']['left'] == [u, v] and len(state(view)['picks']) == 1
    assert 'rows of the two pixels' in ask(view, 'click_right', u=u - disparity, v=v + 9)['error']
    assert ask(view, 'click_right', u=u - disparity, v=v) == {'done': None}
    shown = state(view)
    assert shown['awaited'] is None and shown['picks'][1]['right'][1] == v
    place = view.place('P2')
    assert place is not None
    # pixels are kept to 0.01 px
    np.testing.assert_allclose(place, site.frame.points_xyz[int(v), int(u)], atol=0.03)
    assert main(['measure', str(output), '--picks', str(view.board.path)]) == 0
    assert shown['measurements'][0]['label'] in capsys.readouterr().out
    # a pick that is there gets its place in the right image too
    there = float(site.frame.disparity_px[int(down), int(over)])
    assert ask(view, 'await_right', name='P1') == {'done': None}
    assert ask(view, 'click_right', u=over - there, v=down) == {'done': None}
    both = read_picks(view.board.path)[0]['P1'].right
    assert both is not None and both[0] == pytest.approx(over - there, abs=0.006)
    ask(view, 'undo')
    assert read_picks(view.board.path)[0]['P1'].right is None
    # and what waits can be given up, or is when another frame is shown
    ask(view, 'await_right', name='P1')
    ask(view, 'cancel')
    assert state(view)['awaited'] is None
    ask(view, 'await_right', name='P1')
    ask(view, 'show', frame=1)
    assert state(view)['awaited'] is None and state(view)['shown']['right'] is None
    assert 'is in frame 0' in ask(view, 'await_right', name='P1')['error']


def test_outlines_undo_rename_and_delete(view: SharedView, spots: FloatArray) -> None:
    path, places = view.board.path, spots.tolist()
    ask(view, 'kind', kind='area')
    for u, v in places[:3]:
        ask(view, 'click', u=u, v=v)
    ask(view, 'take', name='P1')  # closes it
    (area,) = state(view)['measurements']
    assert area['closed'] and area['points'] == ['P1', 'P2', 'P3']
    ask(view, 'kind', kind='polyline')
    assert 'at least 2 picks' in ask(view, 'finish')['error']
    ask(view, 'take', name='P2')
    ask(view, 'click', u=places[3][0], v=places[3][1])
    ask(view, 'finish')
    assert state(view)['measurements'][1]['points'] == ['P2', 'P4']
    ask(view, 'rename', name='P2', to='corner')
    picks, requests = read_picks(path)
    assert list(picks) == ['P1', 'corner', 'P3', 'P4']
    assert [one.name for one in requests] == ['area P1 corner P3', 'polyline corner P4']
    for to in ('P1', '', 'two words', 'x' * 61, 'a\x1b'):
        assert 'error' in ask(view, 'rename', name='corner', to=to)
    ask(view, 'delete_measurement', number=0)
    assert list(read_picks(path)[0]) == ['corner', 'P4']
    ask(view, 'undo')
    assert len(read_picks(path)[1]) == 2
    ask(view, 'redo')
    ask(view, 'delete_pick', name='P4')
    assert [list(part) for part in read_picks(path)] == [['corner'], []]
    ask(view, 'delete_pick', name='corner')
    assert read_picks(path, may_be_empty=True) == ({}, [])
    while state(view)['can_undo']:
        assert ask(view, 'undo') == {'done': None}
    # what is begun can be given up
    ask(view, 'kind', kind='distance')
    ask(view, 'click', u=places[0][0], v=places[0][1])
    assert state(view)['chosen'] == ['P1']
    ask(view, 'cancel')
    assert state(view)['picks'] == []


def test_frames_colours_and_crop(view: SharedView, site: MeasuredSite, spots: FloatArray) -> None:
    whole = state(view)['shown']
    assert whole['points'] == whole['points_of'] > 10_000 and whole['legend']['low'] == ''
    images = [view.displayed.image]
    for colour in COLOURS:
        ask(view, 'show', colour=colour)
        images.append(view.displayed.image)
        assert state(view)['shown']['legend']['title']
    assert len({image.tobytes() for image in images}) == len(COLOURS)
    shares = state(view)['shown']['legend']['entries']
    assert any(entry.startswith('filled') and not entry.endswith(' 0%') for entry in shares)
    ask(view, 'show', near_m=10, far_m=15)
    depth_m = view.displayed.cloud[0][:, 2]
    assert depth_m.min() >= 10 and depth_m.max() <= 15
    assert view.displayed.image.mean() < images[-1].mean()
    assert 'must be below' in ask(view, 'show', near_m=15)['error']
    ask(view, 'show', near_m=None, far_m=None, colour='image')
    for number in range(view.folder.count):  # few of them are held
        assert ask(view, 'show', frame=number) == {'done': None}
    ask(view, 'click', u=spots[0, 0], v=spots[0, 1])
    assert state(view)['picks'][0]['frame'] == view.folder.count - 1
    assert 'has no frame 6' in ask(view, 'show', frame=6)['error']
    assert state(view)['shown']['frame'] == 5
    thinned = ColouredFrame(site.frame, most_points=1000)
    assert 500 < len(thinned.cloud[0]) <= 1000 < thinned.count


def test_heights_against_the_truth(view: SharedView, site: MeasuredSite) -> None:
    """The scale of heights: most of the site is within 3 m above its ground."""
    ask(view, 'show', colour='height')
    legend = view.displayed.legend
    assert legend.title == 'height above the ground'
    assert abs(float(legend.low.split()[0])) < 0.3
    up = site.calibrated.left.R @ site.scene.up_xyz
    assert view.up() @ up / np.linalg.norm(up) > 0.9999
    bare = ColouredFrame(site.frame, 'height')
    assert 'no ground' in bare.legend.title


def test_a_ray_meets_the_nearest_point(view: SharedView, site: MeasuredSite) -> None:
    frame = view.frame
    pixel = site.random_pixels(np.random.default_rng(1), 1)[0][0]
    place = frame.points_xyz[int(pixel[1]), int(pixel[0])]
    # from beside the camera, and with what lies behind in line
    origin = np.array([0.3, -0.2, 0.0])
    met = view.displayed.pixel_on_ray(origin, place - origin)
    found = frame.points_xyz[int(met[1]), int(met[0])]
    assert np.linalg.norm(np.cross(found - origin, place - origin)) < 0.06 * np.linalg.norm(place)
    assert np.linalg.norm(found) < 1.03 * np.linalg.norm(place)
    view.look(np.zeros(3), place)
    np.testing.assert_allclose(view.board.marks.picks['P1'].pixel, pixel, atol=1.5)
    with pytest.raises(MeasurementError, match='no point there'):
        view.look(np.zeros(3), np.array([0.0, 0.0, -1.0]))


def test_messages_that_are_wrong(view: SharedView) -> None:
    for message in (
        '', '[]', '7', '{', '{"do": "format"}', '{"do": ["click"]}', '{"do": "click", "u": "x"}',
        '{"do": "click", "u": NaN, "v": 1}', '{"do": "show", "frame": 0.5}', '[' * 5000,
        '{"do": "show", "frame": -1}', '{"do": "show", "colour": "../x"}', b'\xff\xfe',
        '{"do": "show", "near_m": "no"}', '{"do": "kind", "kind": null}', LONGEST_MESSAGE * 'xx',
        '{"do": "delete_measurement", "number": -1}', '{"do": "take", "name": "P9"}',
        '{"do": "click", "u": 1e300, "v": 1e300}',
    ):  # fmt: skip
        assert json.loads(answer(view, message)).keys() == {'id', 'error'}, message
    assert set(ACTIONS) >= {'click', 'undo', 'show'} and not view.board.marks.picks


def test_the_picks_file_is_never_lost(
    view: SharedView, spots: FloatArray, tmp_path: Path, folder: MeasuredFolder
) -> None:
    from test.full_disk import largest_file

    u, v = spots[0].tolist()
    ask(view, 'click', u=u, v=v)
    before = view.board.path.read_bytes()
    with largest_file(10):
        assert 'free some space' in ask(view, 'click', u=u + 9, v=v)['error']
    assert view.board.path.read_bytes() == before and len(state(view)['picks']) == 1
    view.board.path.write_bytes(before + b'# by hand\n')
    assert 'changed by another program' in ask(view, 'undo')['error']
    assert view.board.path.read_bytes().endswith(b'# by hand\n')
    late = tmp_path / 'late.csv'
    write_picks(late, [Pick('A', spots[0], frame=9)])
    with pytest.raises(MeasurementError, match='frame 9'):
        SharedView(folder, PicksBoard(late))
    damaged = tmp_path / 'damaged.yaml'
    damaged.write_text('picks: [}')
    with pytest.raises(FileError, match='damaged'):
        PicksBoard(damaged)
    board = PicksBoard(tmp_path / 'many.csv')
    many = {str(i): Pick(str(i), spots[0]) for i in range(MOST_PICKS + 1)}
    with pytest.raises(MeasurementError, match='limit'):
        board.change(replace(board.marks, picks=many))
    with pytest.raises(FileError, match='cannot be written'):
        PicksBoard(tmp_path / 'none' / 'x.yaml').change(
            replace(board.marks, picks={'A': many['1']})
        )


@pytest.mark.parametrize('ending', ['csv', 'yaml'])
def test_picks_files_are_read_as_written(tmp_path: Path, ending: str) -> None:
    names = ['P1', '1e5', 'null', '007', 'Mähre', 'a,b', 'x: y', "d'e", '#4', '~', '1_0', '0x1F']
    picks = [Pick(name, np.array([0.1 + i, 1 / 3]), frame=i) for i, name in enumerate(names)]
    picks.append(Pick('both', np.array([1.0, 2.0]), np.array([0.5, 2.0])))
    requests = [Request('distance', ('P1', '1e5'), 'an: odd, name')]
    path = tmp_path / f'picks.{ending}'
    write_picks(path, picks, requests)
    found, listed = read_picks(path)
    for pick, one in zip(picks, found.values(), strict=True):
        assert (one.name, one.frame) == (pick.name, pick.frame)
        assert one.pixel.tolist() == pick.pixel.tolist()
    last = found['both'].right
    assert last is not None and last.tolist() == [0.5, 2.0]
    assert listed == (requests if ending == 'yaml' else [])


@pytest.fixture(scope='module')
def server(
    folder: MeasuredFolder, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[PageServer]:
    pytest.importorskip('viser')
    path = tmp_path_factory.mktemp('served') / 'picks.yaml'
    server = PageServer(SharedView(folder, PicksBoard(path)))
    yield server
    server.close()


def fetch(server: PageServer, path: str, **headers: str) -> tuple[int, bytes, dict[str, str]]:
    place = urlsplit(server.address)
    assert place.hostname == '127.0.0.1'
    connection = http.client.HTTPConnection(place.netloc, timeout=30)
    try:
        connection.request('GET', path, headers=headers)
        found = connection.getresponse()
        return found.status, found.read(), dict(found.getheaders())
    finally:
        connection.close()


def test_what_is_served_and_to_whom(server: PageServer) -> None:
    place = urlsplit(server.address)
    root, port = place.path, place.port
    for path, start in (('', b'<!doctype'), ('page.js', b'//'), ('cloud/', b'<!doctype')):
        status, body, headers = fetch(server, root + path)
        assert status == 200 and body.startswith(start)
        assert "default-src 'self'" in headers['Content-Security-Policy']
        assert 'http' not in headers['Content-Security-Policy']
    status, body, _ = fetch(server, f'{root}left.png?4')
    assert cv2.imdecode(np.frombuffer(body, np.uint8), 1).shape[:2] == (180, 288)
    for path in (
        '../../etc/passwd',
        'right.png',
        'page.py',
        '%2e%2e/x',
        '/etc/passwd',
        'cloud/x',
        'session',
    ):
        assert fetch(server, root + path)[0] == 404, path
    for path in ('/', '/cloud/', '/x/', root[:-2], root.upper(), '//'):
        assert fetch(server, path)[0] == 403, path
    assert fetch(server, root, Host=f'localhost:{port}')[0] == 200
    for wrong in ({'Host': f'evil.example:{port}'}, {'Host': ''}, {'Host': '[::'},
                  {'Origin': 'http://evil.example'}, {'Origin': 'null'},
                  {'Origin': 'http://localhost:1'}):  # fmt: skip
        assert fetch(server, root, **wrong)[0] == 403, wrong
    # on no other address of the machine
    with socket.socket() as other:
        assert other.connect_ex(('127.0.0.2', port)) != 0


def test_two_pages_see_the_same(server: PageServer, spots: FloatArray) -> None:
    connect = importlib.import_module('websockets.sync.client').connect
    refused = importlib.import_module('websockets.exceptions').InvalidStatus
    place = server.address.replace('http', 'ws')
    for wrong in ('cloud', 'session'):
        with pytest.raises(refused, match='403'):
            connect(place + wrong, origin='http://evil.example')
    with connect(f'{place}session') as one, connect(f'{place}session') as other:
        for page in (one, other):
            assert json.loads(page.recv(30))['state']['picks'] == []
        u, v = spots[0].tolist()
        one.send(json.dumps({'do': 'click', 'id': 1, 'u': u, 'v': v}))
        found = json.loads(other.recv(30))['state']
        assert [pick['name'] for pick in found['picks']] == ['P1']
        assert {'id': 1, 'done': None} in [json.loads(one.recv(30)) for _ in range(2)]
        # a click in the cloud that meets nothing is answered on the page
        server.scene.clicked(np.zeros(3), np.array([0.0, 0.0, -1.0]))
        assert 'no point there' in json.loads(one.recv(30))['problem']
        server.scene.clicked(
            np.zeros(3), server.view.frame.points_xyz[int(spots[1, 1]), int(spots[1, 0])]
        )
        assert len(json.loads(one.recv(30))['state']['picks']) == 2
    # pages that close lose nothing
    with connect(f'{place}session') as again:
        assert len(json.loads(again.recv(30))['state']['measurements']) == 1


def test_a_port_that_is_in_use(server: PageServer) -> None:
    port = urlsplit(server.address).port
    assert port is not None
    for wrong in (port, 70_000):
        with pytest.raises(ConfigError, match='cannot be used'):
            PageServer(server.view, wrong)


@pytest.mark.long
def test_the_command_serves_until_it_is_interrupted(output: Path, tmp_path: Path) -> None:
    pytest.importorskip('viser')
    picks = tmp_path / 'p.yaml'
    write_picks(picks, [Pick('A', np.array([100.0, 100.0]))])
    words = [sys.executable, '-m', 'binocular_recon', 'view', str(output), '--picks', str(picks)]
    with subprocess.Popen(
        [*words, '--no-browser'], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        assert process.stdout.readline().startswith('http://127.0.0.1:')
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 130
        assert f'interrupted; 1 pick in {picks}' in process.stderr.read()
        assert process.stdout.read() == ''


def test_view_says_what_is_wrong(
    output: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert main(['view', str(tmp_path)]) == 1
    assert 'give the output folder of reconstruct' in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, 'viser', None)
    assert main(['view', str(output), '--no-browser']) == 1
    assert "pip install 'binocular_recon[view]'" in capsys.readouterr().err
