# SPDX-License-Identifier: Apache-2.0
"""``reconstruct LEFT RIGHT``: image files and videos give what the same pairs in a bag give."""

from __future__ import annotations

import json
import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from binocular_recon.apps.frame_formats import FRAME_FORMATS
from binocular_recon.camera import StereoRig
from binocular_recon.cli.main import main
from binocular_recon.errors import ImageError
from binocular_recon.images import to_bgr8
from binocular_recon.io.calibration_yaml import write_rig
from binocular_recon.io.pairs.stereo_video import StereoVideo, VideoPair
from binocular_recon.io.pairs.video import Video, VideoFrame
from binocular_recon.io.pfm import read_pfm
from binocular_recon.rotations import rotation
from binocular_recon.stereo.rectification import Rectifier
from test.bag_tools import HEIGHT, WIDTH, image_pair, rig, stereo_records, write_bag
from test.frame_results import contents
from test.replay.reconstruction import RANGE, frames_of, reconstruct

FRAMES = 4


@pytest.fixture(scope='module')
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('rig')
    write_rig(folder, rig())
    return folder


@pytest.fixture(scope='module')
def of_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return what the pairs give that stand in a bag."""
    folder = tmp_path_factory.mktemp('bag')
    assert reconstruct(write_bag(folder / 'bag', stereo_records(FRAMES)), folder / 'out') == 0
    return folder / 'out'


def write_images(folder: Path, frames: int = FRAMES) -> tuple[str, str]:
    """Write the pairs of the bag as files; return the folders of left and right."""
    for index in range(frames):
        for side, image in zip(('left', 'right'), image_pair(index), strict=True):
            (folder / side).mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(folder / side / f'{side}_{9 + index}.png'), image)
    return str(folder / 'left'), str(folder / 'right')


def run(calibration: Path, output: Path, *words: str) -> int:
    option = ['--calibration', str(calibration), '--output', str(output)]
    return main(['reconstruct', *words, *option, *RANGE])


def summary_of(output: Path) -> Any:
    return json.loads((output / 'summary.json').read_text())


def test_files_give_the_clouds_of_the_bag_and_are_continued(
    calibration: Path, of_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sides = write_images(tmp_path)
    output = tmp_path / 'out'
    # a folder, and a pattern
    words = sides[0], f'{sides[1]}/right_*.png'
    assert run(calibration, output, *words) == 0
    said = capsys.readouterr().err
    assert (
        '4 pairs by the number in their names: left_9.png with right_9.png to left_12.png with'
        ' right_12.png; taken as raw images\n'
    ) in said
    assert frames_of(output) == FRAMES
    for path in of_bag.glob('*.p[fl][my]'):
        assert (output / path.name).read_bytes() == path.read_bytes()
    summary = summary_of(output)
    assert [text.split(',')[0] for text in summary['source']['files']] == ['4 files'] * 2
    assert summary['frames'][0]['images'] == ['left_9.png', 'right_9.png']
    assert summary['frames'][0]['stamp_ns'] is None
    assert (summary['images_read'], summary['unpaired']) == (2 * FRAMES, 0)
    assert summary['source']['calibrated_in'] == str(calibration)
    # it may lie elsewhere
    moved = shutil.copytree(calibration, tmp_path / 'moved')
    assert run(moved, output, *words) == 0
    assert 'is finished already' in capsys.readouterr().err
    halved = '--rectified', '--every', '2', '--format', 'right'
    assert run(calibration, output, *words, *halved) == 0
    assert 'taken as rectified images' in capsys.readouterr().err
    for index in range(FRAMES // 2):
        path = output / f'{index:06d}_right.png'
        assert (cv2.imread(str(path)) == to_bgr8(image_pair(2 * index)[1])).all()
        path.unlink()
    assert frames_of(output) == FRAMES / 2
    # another file of the same name and size is another input
    cv2.imwrite(f'{sides[0]}/left_9.png', image_pair(7)[0])
    summary['finished'] = False
    (output / 'summary.json').write_text(json.dumps(summary))
    assert run(calibration, output, *words) == 1


def test_images_that_cannot_be_used_are_left_out_one_by_one(
    calibration: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sides = write_images(tmp_path)
    cv2.imwrite(f'{sides[0]}/left_10.png', image_pair(1, (HEIGHT - 8, WIDTH))[0])
    whole = Path(sides[1], 'right_11.png')
    whole.write_bytes(whole.read_bytes()[:-400])
    Path(sides[1], 'right_13.png').write_bytes(b'')
    assert run(calibration, tmp_path / 'out', *sides) == 1
    said = capsys.readouterr().err
    assert 'warning: 1 image has no partner: right/right_13.png' in said
    assert '2 of 4 pairs were left out, the first because' in said
    assert 'left_10.png is 96x64 px, its calibration is for 96x72' in said
    assert '2 frames are in' in said
    assert frames_of(tmp_path / 'out') == 2
    left_out = summary_of(tmp_path / 'out')['left_out']
    assert left_out[1]['images'] == ['left_11.png', 'right_11.png']
    assert 'right_11.png is truncated' in left_out[1]['reason']


@pytest.mark.parametrize(
    ('words', 'status', 'said'),
    [
        (('l', 'r', 'q'), 2, "3 inputs are given, 'l' to 'q'; quote patterns"),
        (('left', 'empty'), 1, 'no images for the right camera: it is empty'),
        (('left', 'right', '--namespace', 'rig'), 2, '--namespace is an option of a bag, not of'),
        (('left', 'right', '--pairing', 'stamps'), 2, '--pairing is an option of a bag'),
        (('left', 'right', '--pair-by', 'time'), 1, 'without an EXIF time'),
        (('left',), 2, 'is a folder of images; give the images of the left and of the right'),
        (('left', 'left'), 1, 'is named for both cameras'),
        (('left', 'film.mp4'), 1, 'are a video and images; give two of one kind'),
        (('bag.mcap', '--pair-by', 'order'), 2, '--pair-by is an option of image files and'),
    ],
)
def test_wrong_arguments(
    calibration: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    status: int,
    said: str,
) -> None:
    write_images(tmp_path, 1)
    (tmp_path / 'empty').mkdir()
    (tmp_path / 'film.mp4').write_bytes(b'')
    monkeypatch.chdir(tmp_path)
    assert run(calibration, tmp_path / 'out', *words) == status
    assert said in capsys.readouterr().err
    assert not list(tmp_path.glob('out/*'))


def test_files_need_a_calibration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['reconstruct', *write_images(tmp_path, 1), '--output', str(tmp_path)]) == 2
    assert 'do not carry their calibration; give --calibration DIR' in capsys.readouterr().err


def test_a_missing_package_is_named_with_the_extra(
    calibration: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / 'film.mp4').write_bytes(b'')
    monkeypatch.setitem(sys.modules, 'av', None)
    assert run(calibration, tmp_path / 'out', str(tmp_path / 'film.mp4')) == 1
    said = capsys.readouterr().err
    assert 'videos need the package av, which is not installed' in said
    assert "pip install 'binocular_recon[video]'" in said


def write_video(path: Path, images: list[Any], *, rate_hz: int = 10, lost: int = -1) -> str:
    """Write a video without loss; the time of a lost frame passes without it."""
    av = pytest.importorskip('av')
    with av.open(str(path), 'w') as container:
        stream = container.add_stream('ffv1', rate=rate_hz)
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt = 'bgr0' if images[0].ndim == 3 else 'gray16le'
        for number, image in enumerate(images):
            if number != lost:
                kind = 'bgr24' if image.ndim == 3 else 'gray16le'
                frame = av.VideoFrame.from_ndarray(image, format=kind)
                frame.pts = number
                for packet in stream.encode(frame):
                    container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    return str(path)


PAIRS = [image_pair(index) for index in range(FRAMES)]


def test_two_videos_and_one_give_the_clouds_of_the_bag(
    calibration: Path, of_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    left = write_video(tmp_path / 'left.mkv', [pair[0] for pair in PAIRS])
    right = write_video(tmp_path / 'right.mkv', [pair[1] for pair in PAIRS])
    both = write_video(tmp_path / 'both.mkv', [np.hstack(pair) for pair in PAIRS])
    for name, words in {
        'time': (left, right),
        'order': (left, right, '--pair-by', 'order'),
        'halves': (both,),
    }.items():
        output = tmp_path / name
        assert run(calibration, output, *words) == 0
        assert frames_of(output) == FRAMES
        for path in of_bag.glob('*.p[fl][my]'):
            assert (output / path.name).read_bytes() == path.read_bytes()
        frame = summary_of(output)['frames'][1]
        assert frame['stamp_ns'] == 100_000_000
        assert frame['images'][0].endswith('.mkv #1')
    said = capsys.readouterr().err
    assert 'paired by their times: left.mkv (96x72 px, 4 frames, 10 per second) with' in said
    assert 'both.mkv (192x72 px, 4 frames, 10 per second) shows left and right side' in said


def test_videos_of_two_sizes(tmp_path: Path) -> None:
    """The right camera has a larger image: each video has the size of its own camera."""
    true = rig()
    border = 8
    K = true.right.K + np.array([[0, 0, border], [0, 0, border], [0, 0, 0]])
    width, height = (one + 2 * border for one in true.right.size)
    (tmp_path / 'rig').mkdir()
    write_rig(
        tmp_path / 'rig',
        StereoRig(true.left, replace(true.right, K=K, width=width, height=height)),
    )
    edges = (*[border] * 4, cv2.BORDER_REPLICATE)
    framed = [cv2.copyMakeBorder(pair[1], *edges) for pair in PAIRS]
    left = write_video(tmp_path / 'left.mkv', [pair[0] for pair in PAIRS])
    right = write_video(tmp_path / 'right.mkv', framed)
    assert run(tmp_path / 'rig', tmp_path / 'out', left, right) == 0
    assert frames_of(tmp_path / 'out') == FRAMES
    sides = write_images(tmp_path)
    for index, image in enumerate(framed):
        cv2.imwrite(str(tmp_path / 'right' / f'right_{9 + index}.png'), image)
    assert run(tmp_path / 'rig', tmp_path / 'files', *sides) == 0
    for path in (tmp_path / 'files').glob('*.p[fl][my]'):
        assert (tmp_path / 'out' / path.name).read_bytes() == path.read_bytes()


@pytest.mark.long
def test_two_processes_make_of_videos_what_one_makes(
    calibration: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, 'sched_getaffinity', lambda _: {0, 1})
    left = write_video(tmp_path / 'left.mkv', [pair[0] for pair in PAIRS])
    right = write_video(tmp_path / 'right.mkv', [pair[1] for pair in PAIRS], lost=2)
    assert run(calibration, tmp_path / 'one', left, right) == 0
    assert run(calibration, tmp_path / 'two', left, right, '--jobs', '2') == 0
    alone = contents(tmp_path / 'one')
    assert len(alone['summary']['frames']) == FRAMES - 1
    assert contents(tmp_path / 'two') == alone


@pytest.mark.parametrize('alpha', [-1.0, 0.0, 1.0])
def test_files_state_the_focal_length_of_the_images_whatever_alpha_is(
    tmp_path: Path, alpha: float
) -> None:
    turn, D = rotation(np.array([0.02, -0.03, 0.01])), np.array([-0.2, 0.05, 0, 0, 0.0])
    left, right = rig().left, rig().right
    raw = StereoRig(replace(left, D=D), replace(right, D=D, R=turn @ right.R))
    (tmp_path / 'rig').mkdir()
    write_rig(tmp_path / 'rig', raw)
    focal_px = Rectifier(raw, alpha).rig.left.P[0, 0]
    output = tmp_path / 'out'
    words = [*write_images(tmp_path, 1), '--alpha', f'{alpha}', '--format', 'tiff,png']
    assert run(tmp_path / 'rig', output, *words) == 0
    assert main(['export', str(output), '--format', 'tiff,png']) == 0
    summary = summary_of(output)
    assert summary['focal_px'] == pytest.approx(focal_px, rel=1e-12)
    for folder in (output, output / 'export'):
        for ending in ('depth', 'depth_mm'):
            side = json.loads((folder / f'000000_{ending}.json').read_text())
            assert side['fx'] == pytest.approx(focal_px, rel=1e-12)
    # and the cloud was made with it: depth = focal length x baseline / disparity
    disparity_px = read_pfm(output / '000000_disparity.pfm')
    depth_m = cv2.imread(str(output / '000000_depth.tiff'), cv2.IMREAD_UNCHANGED)
    known = np.isfinite(depth_m)
    assert known.any()
    offset_px = Rectifier(raw, alpha).rig.disparity_offset_px
    expected = focal_px * summary['baseline_m'] / (disparity_px[known] - offset_px)
    np.testing.assert_allclose(depth_m[known], expected, rtol=1e-5)


def test_an_interrupted_video_is_continued(
    calibration: Path, of_bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    left = write_video(tmp_path / 'left.mkv', [pair[0] for pair in PAIRS])
    right = write_video(tmp_path / 'right.mkv', [pair[1] for pair in PAIRS])
    cloud, made = FRAME_FORMATS['ply'], list[str]()

    def interrupt(path: Path, *parts: Any) -> None:
        made.append(path.name)
        if len(made) == 3:
            raise KeyboardInterrupt
        cloud.write(path, *parts)

    monkeypatch.setitem(FRAME_FORMATS, 'ply', cloud._replace(write=interrupt))
    assert run(calibration, tmp_path / 'out', left, right) == 130
    assert frames_of(tmp_path / 'out') == 2
    (tmp_path / 'moved').mkdir()  # where they lie does not matter
    moved = [Path(path).rename(tmp_path / 'moved' / Path(path).name) for path in (left, right)]
    assert run(calibration, tmp_path / 'out', *map(str, moved)) == 0
    assert made == [f'00000{index}.ply' for index in (0, 1, 2, 2, 3)]
    for path in of_bag.glob('*.ply'):
        assert (tmp_path / 'out' / path.name).read_bytes() == path.read_bytes()


def test_a_lost_frame_of_a_video_costs_one_pair(
    calibration: Path, of_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    left = write_video(tmp_path / 'left.mkv', [pair[0] for pair in PAIRS])
    right = write_video(tmp_path / 'right.mkv', [pair[1] for pair in PAIRS], lost=1)
    output = tmp_path / 'out'
    assert run(calibration, output, left, right) == 0
    assert '1 of 7 images has no partner' in capsys.readouterr().out
    images = [frame['images'] for frame in summary_of(output)['frames']]
    assert images[1] == ['left.mkv #2', 'right.mkv #1']
    last = (output / '000002.ply').read_bytes()
    assert last == (of_bag / '000003.ply').read_bytes()
    assert run(calibration, tmp_path / 'order', left, right, '--pair-by', 'order') == 1
    assert 'give --pair-by time' in capsys.readouterr().err


def test_videos_that_are_broken_or_do_not_fit(
    calibration: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lefts, rights = ([pair[k] for pair in PAIRS] for k in (0, 1))
    left = write_video(tmp_path / 'left.mkv', lefts)
    right = write_video(tmp_path / 'right.mkv', rights)
    cut = tmp_path / 'cut.mkv'
    cut.write_bytes(Path(right).read_bytes()[: Path(right).stat().st_size * 3 // 5])
    nothing = tmp_path / 'nothing.mp4'
    nothing.write_bytes(Path(right).read_bytes()[-500:])
    fast = write_video(tmp_path / 'fast.mkv', rights, rate_hz=25)
    half = write_video(tmp_path / 'half.mkv', [image[:, ::2].copy() for image in rights])
    for words, said, frames in (
        ((left, str(cut)), 'cut.mkv is cut off: it has 0.2 s of the 0.4 s it states', 2),
        ((left, str(nothing)), 'nothing.mp4 cannot be read as a video: Invalid data', 0),
        ((left, fast), 'has 10 frames per second and', 0),
        ((left, half), 'half.mkv is 48x72 px, its calibration is for 96x72', 0),
        ((left,), 'side by side, each of which is 48x72 px, its calibration is for 96x72', 0),
        ((left, right, '--pair-by', 'number'), 'frames of videos have no names', 0),
    ):
        output = tmp_path / 'out'
        assert run(calibration, output, *words, '--no-resume') != 0
        assert said in capsys.readouterr().err
        if frames:
            assert frames_of(output) == frames


@pytest.mark.timeout(60)
def test_videos_that_are_playlists_pipes_or_bombs(
    calibration: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    right = write_video(tmp_path / 'right.mkv', [pair[1] for pair in PAIRS])
    (tmp_path / 'itself.mp4').write_text('ffconcat version 1.0\nfile itself.mp4\n')
    (tmp_path / 'list.avi').write_text('#EXTM3U\n#EXTINF:1.0,\nright.mkv\n#EXT-X-ENDLIST\n')
    os.mkfifo(tmp_path / 'pipe.mkv')
    for name in ('itself.mp4', 'list.avi', 'pipe.mkv'):
        assert run(calibration, tmp_path / 'out', str(tmp_path / name), right) == 1
        assert f'{name} cannot be read' in capsys.readouterr().err
    large = write_video(tmp_path / 'large.mkv', [np.zeros((2048, 2048, 3), np.uint8)])
    with Video(Path(large)) as video, Video(Path(right)) as other:
        (frame,) = video.frames()
        pair = VideoPair(0, rig(), ('large #0', 'right #0'), (frame, next(other.frames())))
        with pytest.raises(ImageError, match='large #0 is 2048x2048 px, its calibration is for'):
            pair.images()
    monkeypatch.setattr('binocular_recon.io.pairs.video.MOST_PIXELS', 2048 * 2047)
    with Video(Path(large)) as video:
        assert list(video.frames()) == []
        assert 'large.mkv cannot be decoded' in video.damage[0]


def test_each_video_has_the_size_of_its_own_camera(tmp_path: Path) -> None:
    left, right = (
        write_video(tmp_path / f'{number}.mkv', [pair[number] for pair in PAIRS])
        for number in (0, 1)
    )
    half = write_video(tmp_path / 'half.mkv', [pair[1][::2, ::2].copy() for pair in PAIRS])
    raw = replace(
        rig().right, D=np.array([0.01, 0, 0, 0, 0]), width=WIDTH // 2, height=HEIGHT // 2
    )
    other = replace(rig(), right=raw)
    with Video(Path(left)) as video, Video(Path(right)) as whole, Video(Path(half)) as small:
        frames = next(video.frames()), next(small.frames())
        images = VideoPair(0, other, ('left #0', 'half #0'), frames).images()
        assert [image.shape[:2] for image in images] == [(72, 96), (36, 48)]
        StereoVideo(video, small, other, 'order')
        with pytest.raises(ImageError, match=r'1\.mkv is 96x72 px, its calibration is for 48x36'):
            StereoVideo(video, whole, other, 'order')


def test_frames_of_16_bits_keep_them_and_damaged_ones_are_refused(tmp_path: Path) -> None:
    grey = np.arange(HEIGHT * WIDTH, dtype=np.uint16).reshape(HEIGHT, WIDTH) * 9
    with Video(Path(write_video(tmp_path / 'grey.mkv', [grey]))) as video:
        frames = [frame.image('grey') for frame in video.frames()]
    np.testing.assert_array_equal(frames[0], grey)
    damaged = VideoFrame(3, 0, SimpleNamespace(is_corrupt=True))
    with pytest.raises(ImageError, match=r'grey\.mkv #3 is damaged; record it again'):
        damaged.image('grey.mkv #3')
