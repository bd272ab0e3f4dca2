# SPDX-License-Identifier: Apache-2.0
"""The report of a survey: complete, escaped, and open about what it lacks."""

from __future__ import annotations

import base64
import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from binocular_recon.apps.survey.measured_folder import MeasuredFolder
from binocular_recon.apps.survey.report.images import cut_out
from binocular_recon.apps.survey.report.sources import ReportDetails, ReportSources
from binocular_recon.camera import FloatArray
from binocular_recon.cli.main import main
from binocular_recon.images import ByteImage
from binocular_recon.io.exports.placement import read_placement
from binocular_recon.io.exports.point_table import PointTable
from binocular_recon.measurement.results import Quantity
from binocular_recon.measurement.site.tie import TIE_FILE
from test.unit.measurement.measured_site import MeasuredSite, write_output, write_rows

EVIL = '<script>alert("1")</script> & </style>'


class Page(HTMLParser):
    """What a browser takes a page for."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.words: list[str] = []
        self.data: dict[str, str] = {}
        self.tags: list[str] = []
        self.addresses: list[str] = []
        self._inside = ''
        self.feed(html)

    @property
    def text(self) -> str:
        return ' '.join(' '.join(self.words).split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.tags.append(tag)
        self.addresses += [given[key] or '' for key in ('src', 'href') if key in given]
        self._inside = f'{tag} {given.get("type") or ""}' if tag in {'script', 'style'} else ''

    def handle_data(self, data: str) -> None:
        if self._inside:
            self.data[self._inside] = self.data.get(self._inside, '') + data
        else:
            self.words.append(data)

    def handle_endtag(self, tag: str) -> None:
        self._inside = '' if tag in {'script', 'style'} else self._inside


def points_of(page: Page) -> tuple[FloatArray, ByteImage, FloatArray]:
    """Return the points of the view, their colours (red, green, blue) and sigmas."""
    meta = json.loads(page.data['script application/json'])
    count = meta['count']
    data = base64.b64decode(page.data['script text/plain'])
    words = np.frombuffer(data, '<u2', 4 * count).reshape(4, count)
    octets = np.frombuffer(data, np.uint8, offset=8 * count).reshape(4, count)
    xyz = np.array(meta['low']) + words[:3].T * np.array(meta['step'])
    return xyz, octets[:3].T, words[3] * meta['sigma_step']


@pytest.fixture(scope='module')
def site() -> MeasuredSite:
    return MeasuredSite(0)


@pytest.fixture(scope='module')
def bare(site: MeasuredSite, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an output folder with one frame."""
    return write_output(site, tmp_path_factory.mktemp('bare'))


@pytest.fixture(scope='module')
def surveyed(site: MeasuredSite, bare: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a survey: georeferenced, measured, with calibration and check."""
    folder = tmp_path_factory.mktemp('survey') / 'out'
    shutil.copytree(bare, folder)
    pixels, truth = site.random_pixels(np.random.default_rng(2), 6, 10.0, 18.0)
    places = (truth + np.array([5e5, 5.4e6, 300])).tolist()
    rows: list[dict[str, object]] = [
        {'name': f'P{i}', 'frame': 0, 'u': u, 'v': v, 'x': x, 'y': y, 'z': z,
         'check': 'yes' if i > 4 else ''}
        for i, ((u, v), (x, y, z)) in enumerate(zip(pixels.tolist(), places, strict=True))
    ]  # fmt: skip
    control = str(write_rows(folder.parent / 'control.csv', rows))
    assert main(['georeference', str(folder), '--control', control, '--free-scale']) == 0
    picks = folder.parent / 'picks.yaml'
    content = {
        'picks': [{key: row[key] for key in ('name', 'frame', 'u', 'v')} for row in rows],
        'measurements': [
            {'name': f'wall {EVIL}', 'kind': 'distance', 'points': ['P0', 'P1']},
            {'name': 'corner', 'kind': 'angle', 'points': ['P2', 'P3', 'P4']},
            {'name': 'spot', 'kind': 'point', 'points': ['P5']},
        ],
    }
    picks.write_text(json.dumps(content))
    assert main(['measure', str(folder), '--picks', str(picks)]) == 0
    (folder / 'check.json').write_text(json.dumps(CHECK))
    (folder.parent / 'rig').mkdir()
    (folder.parent / 'rig' / 'calibration.json').write_text(json.dumps(CALIBRATION))
    summary = json.loads((folder / 'summary.json').read_text())
    summary['left_out'] = [
        {'stamp_ns': 5, 'images': ['a_3.png', 'b_3.png'], 'reason': f'it is dark {EVIL}'}
    ]
    summary['unpaired'], summary['images_read'], summary['damage'] = 3, EVIL, ['torn at 17 s']
    summary['frames'][0] |= {'note': EVIL, 'warning': 'the range is small'}
    (folder / 'summary.json').write_text(json.dumps(summary))
    shutil.copy(folder / '000000_left.png', folder / '000000_right.png')
    return folder


CHECK = {
    'date': '2026-05-11T08:00:00+00:00', 'rows': 'rows differ by 0.04 px', 'left_out': [],
    'distances': [{'name': '07 rod 3', 'measured_m': 1.5021, 'sigma_m': 0.0031, 'known_m': 1.5,
                   'depth_m': 12.44, 'off_sigmas': 0.68, 'passed': True}],
    'faults': [],
}  # fmt: skip
CALIBRATION: dict[str, Any] = {
    'date': '2026-05-01T23:00:00+00:00', 'baseline_m': 1.00234, 'rms_px': 0.0567,
    'left': {'K': [[1650.25, 0, 965.5], [0, 1652.75, 598.25], [0, 0, 1]]},
    'right': {'K': [[1660.5, 0, 951.75], [0, 1661.25, 607.5], [0, 0, 1]]},
    'sigma': {'baseline_m': 0.00123, 'fx_left_px': 4.56},
    'depth_sigma_m': {'10': 0.0391, '15': 0.0602, '20': None},
    'boards': [{'name': '01', 'marks': 30}, {'name': '02', 'marks': 27}],
    'row_difference_px': {'adjusted': {'mean': 0.0362}},
    'rejected': [{'name': '03', 'reason': 'it is blurred'}], 'warnings': ['few boards'],
}  # fmt: skip


def report(folder: Path, *options: object) -> Page:
    target = folder.parent / 'page.html'
    args = ['report', folder, '--output', target, *options]
    assert main([str(arg) for arg in args]) == 0
    return Page(target.read_text())


@pytest.fixture(scope='module')
def page(surveyed: Path) -> Page:
    rig, date = surveyed.parent / 'rig', '2026-05-11'
    names = '--site', EVIL, '--client', 'Quarry Ltd', '--author', 'A. Surveyor'
    logo = surveyed / '000000_left.png'
    return report(surveyed, '--calibration', rig, '--date', date, *names, '--logo', logo)


def test_everything_that_the_files_hold_is_in_the_report(surveyed: Path, page: Page) -> None:
    summary, tie, measured = (
        json.loads((surveyed / name).read_text())
        for name in ('summary.json', TIE_FILE, 'measurements.json')
    )
    texts = ['Quarry Ltd', 'A. Surveyor', '11 May 2026']
    for one in measured['measurements']:
        texts.append(one['name'])
        for value in one.values():
            if isinstance(value, dict):
                quantity = Quantity(value['value'], value['sigma'], value['unit'])
                texts.append(str(quantity).replace('+-', '±'))
    for point in tie['points']:
        texts += [f'{value:.3f}' for value in point['place']]
        for key in ('residual_m', 'left_out_m', 'error_m'):
            pairs = zip(
                point.get(key, []), point.get(key.replace('_m', '_sigma_m'), []), strict=True
            )
            texts += [f'{1e3 * off:+.1f} ± {1e3 * sigma:.1f}' for off, sigma in pairs]
    assert {key for point in tie['points'] for key in point} >= {'residual_m', 'error_m'}
    scale = tie['scale_estimated']
    texts.append(f'{scale["value"]:.5f} ± {scale["sigma"]:.5f}')
    (frame,) = summary['frames']
    texts += [f'{100 * frame["matched"]:.1f} %', str(frame['points']), 'the range is small']
    texts += [f'{frame["depth_m"][name]:.2f}' for name in ('min', 'median', 'max')]
    texts += [f'baseline {summary["baseline_m"]:.3f} m', f'{summary["focal_px"]:.1f} px']
    texts += [
        'a_3.png and b_3.png',
        f'3 of {EVIL} images',
        'torn at 17 s',
        '1 image pair was left out',
    ]
    texts += ['1002.34 ± 1.2 mm', '1650.25 ± 4.6 px', '607.50 px', '39.1 mm', '60.2 mm']
    texts += ['2 boards with 57 marks', '0.057 px', '0.036 px', '10 days before the survey']
    texts += [
        'it is blurred',
        'few boards',
        '1.502 ± 0.003 m',
        '1.500 m',
        '12.4 m',
        '+0.7',
        'passed',
    ]
    assert [text for text in texts if ' '.join(text.split()) not in page.text] == []
    assert 'Not stated' not in page.text
    # left and right image, maps of disparity, sigma and validity, 3 measurements, cloud, logo
    assert page.tags.count('img') == 5 + 3 + 1 + 1


def test_a_report_needs_no_network_and_takes_no_text_for_html(page: Page) -> None:
    assert all(address.startswith('data:image/') for address in page.addresses)
    assert page.tags.count('script') == 3  # the points, what they are, and the viewer
    assert page.text.count('<script>alert("1")</script>') >= 7
    assert not re.search(r'https?:|@import|url\(', page.data['style '])
    assert '<' not in page.data['style ']


def test_the_view_holds_the_points_of_the_cloud(surveyed: Path, page: Page) -> None:
    xyz, rgb, sigma = points_of(page)
    table = PointTable.of_file(surveyed / '000000.ply').placed(read_placement(surveyed / TIE_FILE))
    chunks = list(table.chunks())
    true = np.concatenate([chunk.xyz for chunk in chunks])
    assert xyz.shape == true.shape
    assert np.abs(xyz - true).max() < 1e-3
    assert (rgb == np.concatenate([chunk.rgb for chunk in chunks])).all()
    stated = np.concatenate([chunk.scalars['sigma_z'] for chunk in chunks])
    assert np.abs(sigma - stated)[stated < 6.5].max() < 6e-5


def test_the_cloud_is_thinned_to_the_size_of_the_file(
    surveyed: Path, page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    small = report(surveyed, '--max-size', 0.8)
    assert 0.7e6 < (surveyed.parent / 'page.html').stat().st_size <= 0.8e6
    few, every = points_of(small)[0], points_of(page)[0]
    assert 1000 <= len(few) < len(every)
    assert f'{len(few)} of {len(every)} points' in small.text
    known = {tuple(point) for point in np.round(every, 2)}
    assert np.mean([tuple(point) in known for point in np.round(few, 2)]) > 0.8
    assert main(['report', str(surveyed), '--max-size', '0.1']) == 2
    assert 'no room for the cloud' in capsys.readouterr().err


def test_what_is_not_there_is_said(bare: Path) -> None:
    found = report(bare)
    for what in (
        'site: --site', 'client: --client', 'author: --author', 'date: images have no time',
        'measurements: nothing was measured', 'tie to the site', 'right image: reconstruct',
        'calibration: the summary does not say', 'check distance: calibrate',
    ):  # fmt: skip
        assert f'Not stated: {what}' in found.text, what
    assert 'x right, y down, z forward' in found.text
    assert 'Nothing is missing' not in found.text


def test_a_calibration_that_was_replaced_is_not_stated(surveyed: Path) -> None:
    folder = MeasuredFolder(surveyed)
    rig = surveyed.parent / 'rig'
    source = {'calibration': {'left.yaml': 'other'}, 'calibrated_in': str(rig)}
    folder.summary['source'] = source
    found = ReportSources(folder, ReportDetails()).calibration
    assert isinstance(found, str) and 'is not the one that was used' in found
    source['calibrated_in'] = str(rig / 'gone')
    found = ReportSources(folder, ReportDetails()).calibration
    assert isinstance(found, str) and 'there is no calibration.json' in found


@pytest.mark.parametrize(
    ('name', 'text', 'message'),
    [
        ('measurements.json', '{"measurements": 3}', 'measurements.json in '),
        ('measurements.json', '[]', 'is not what our commands write; measure again'),
        (TIE_FILE, '{', 'is not valid JSON'),
        ('check.json', '{"date": 1}', 'not as our commands write it'),
        ('summary.json', '{}', 'is not the summary of frames'),
        ('summary.json', '{"frames": [3]}', 'is damaged: frame 0 has another index'),
        (TIE_FILE, '{"axes": "ENH", "points": 1}', f'{TIE_FILE} in '),
        ('000000.ply', 'ply', 'is not a cloud of this program'),
    ],
)
def test_damaged_files_are_named(
    surveyed: Path, tmp_path: Path, name: str, text: str, message: str,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    folder = tmp_path / 'out'
    shutil.copytree(surveyed, folder)
    (folder / name).write_text(text)
    assert main(['report', str(folder)]) == 1
    assert message in capsys.readouterr().err
    assert not (folder / 'report.html').exists()


@pytest.mark.parametrize(
    ('options', 'status', 'message'),
    [
        (['--frames', '7'], 1, 'has no frame 7'),
        (['--logo', 'logo.gif'], 2, 'must be a PNG or JPEG file'),
        (['--logo', 'none.png'], 1, 'none.png'),
        (['--output', 'nowhere/page.html'], 1, 'nowhere'),
    ],
)
def test_wrong_options_are_said(
    bare: Path, options: list[str], status: int, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['report', str(bare), *options]) == status
    assert message in capsys.readouterr().err


def test_the_part_around_picks_shows_what_is_there() -> None:
    image = np.zeros((600, 900, 3), np.uint8)
    places = np.array([[400.0, 250.0], [500.0, 320.0]])
    for x, y in places.astype(int).tolist():
        cv2.circle(image, (x, y), 4, (255, 255, 255), -1)
    part, moved = cut_out(image, places)
    assert part.shape == (360, 480, 3)
    rows = [part[round(y), round(x)].min() for x, y in moved]
    assert min(rows) == 255 and part.mean() < 10
    apart = np.linalg.norm(moved[1] - moved[0])
    assert 0.3 * 480 < apart < 0.8 * 480
