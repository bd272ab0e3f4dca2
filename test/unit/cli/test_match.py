# SPDX-License-Identifier: Apache-2.0
"""``match``: two image files to a disparity map."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from binocular_recon.cli.main import main
from binocular_recon.io.image_files import write_image_file
from binocular_recon.io.pfm import read_pfm
from test.bag_tools import image_pair


def test_match_writes_raw_disparity(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, image in zip(('left', 'right'), image_pair(3), strict=True):
        write_image_file(tmp_path / f'{name}.png', image)
    files = [str(tmp_path / name) for name in ('left.png', 'right.png', 'new/d.pfm', 'new/d.png')]
    words = [
        'match',
        *files[:2],
        '--max-disparity',
        '15',
        '--output',
        files[2],
        '--heat-map',
        files[3],
    ]
    assert main(words) == 0
    disparity_px = read_pfm(Path(files[2]))
    assert np.isfinite(disparity_px).all()
    # points are 6 px farther right in the left image than in the right one
    inner = disparity_px[8:-8, 24:-8]
    assert np.median(np.abs(inner - 6)) < 0.05
    assert np.mean(np.abs(inner - 6) < 0.5) > 0.98
    assert Path(files[3]).stat().st_size > 1000
    assert '100.0% with a disparity' in capsys.readouterr().out


def test_match_refuses_images_that_do_not_fit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    left, right = image_pair(0)
    write_image_file(tmp_path / 'left.png', left)
    write_image_file(tmp_path / 'right.png', right[:, :-3])
    (tmp_path / 'file').write_text('')
    common = ['--max-disparity', '15']
    out = ['--output', str(tmp_path / 'd.pfm')]
    pair = [str(tmp_path / 'left.png'), str(tmp_path / 'right.png')]
    for words, status, message in (
        ([pair[0], str(tmp_path / 'gone.png'), *out], 1, 'gone.png cannot be read'),
        ([*pair, *out], 1, '(72, 96) and right (72, 93)'),
        ([pair[0], pair[0], '--output', str(tmp_path / 'file/d.pfm')], 1, 'file'),
        ([*pair, *out, '--min-disparity', '15'], 2, 'above the smallest disparity, 15 px, got 15'),
    ):
        assert main(['match', *words, *common]) == status
        text = capsys.readouterr().err
        assert message in text
        assert text.count('\n') == 1
    assert not (tmp_path / 'd.pfm').exists()
