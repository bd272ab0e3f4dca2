# SPDX-License-Identifier: Apache-2.0
"""Image pairs of bags."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from binocular_recon.errors import BagError, CalibrationError, ImageError
from binocular_recon.inputs.options import PairingOptions
from binocular_recon.io.bags.reader import Bag
from binocular_recon.io.bags.stereo_bag import StereoBag, StereoFrame
from binocular_recon.io.bags.stereo_topics import find_stereo_topics
from binocular_recon.io.bags.writer import BagWriter, write_pair
from test.bag_tools import (
    FORMATS,
    PERIOD_NS,
    START_NS,
    Record,
    compressed_message,
    image_message,
    image_pair,
    info_message,
    rig,
    stereo_records,
    write_bag,
)

LEFT, RIGHT = '/left/image_raw', '/right/image_raw'


def infos(stamp_ns: int = START_NS, focal_px: float = 80.0) -> list[Record]:
    cameras = rig(focal_px)
    return [
        ('/left/camera_info', info_message(cameras.left, stamp_ns), stamp_ns),
        ('/right/camera_info', info_message(cameras.right, stamp_ns), stamp_ns),
    ]


def shots(topic: str, stamps_ns: list[int]) -> list[Record]:
    """Return images of one camera, recorded as they were taken."""
    image = image_pair(0)[0 if topic == LEFT else 1]
    return [(topic, image_message(image, stamp), START_NS + stamp) for stamp in stamps_ns]


def pairs_of(path: Path, tolerance_ns: int = 0) -> list[StereoFrame]:
    with Bag(path) as bag:
        return list(StereoBag(bag, find_stereo_topics(bag.topics), tolerance_ns=tolerance_ns))


@pytest.mark.parametrize('fmt', FORMATS)
def test_pairs_of_every_format(tmp_path: Path, fmt: str) -> None:
    pairs = pairs_of(write_bag(tmp_path / 'bag', stereo_records(3), fmt))
    assert [pair.stamp_ns for pair in pairs] == [START_NS + i * PERIOD_NS for i in range(3)]
    for index, pair in enumerate(pairs):
        for image, truth in zip(pair.images(), image_pair(index), strict=True):
            np.testing.assert_array_equal(image, truth)
        assert pair.rig is pairs[0].rig
        assert pair.rig.baseline_m == pytest.approx(0.5, abs=1e-12)
        assert pair.rig.focal_px == 80.0


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    grey = np.random.default_rng(0).integers(0, 65536, (72, 96), np.uint16)
    with BagWriter(tmp_path / 'bag') as writer:
        write_pair(writer, rig(), (grey, grey[:, ::-1]), START_NS)
    (pair,) = pairs_of(tmp_path / 'bag')
    left, right = pair.images()
    np.testing.assert_array_equal(left, grey)
    np.testing.assert_array_equal(right, grey[:, ::-1])
    np.testing.assert_array_equal(pair.rig.right.P, rig().right.P)


def test_stamps_pair_exactly_or_within_the_tolerance(tmp_path: Path) -> None:
    left = shots(LEFT, [0, 100, 200, 300, 400])
    right = shots(RIGHT, [3, 100, 197, 330, 400])
    path = write_bag(tmp_path / 'bag', [*infos(), *left, *right])
    assert [pair.stamp_ns for pair in pairs_of(path)] == [100, 400]
    assert [pair.stamp_ns for pair in pairs_of(path, 3)] == [0, 100, 200, 400]
    assert len(pairs_of(path, 30)) == 5


def test_lost_images_are_counted_and_cost_only_their_partner(tmp_path: Path) -> None:
    records = [r for i, r in enumerate(stereo_records(6)) if i not in (1, 11, 14)]
    with Bag(write_bag(tmp_path / 'bag', records)) as bag:
        stereo = StereoBag(bag, find_stereo_topics(bag.topics))
        assert stereo.expected == 5
        stamps = [(pair.stamp_ns - START_NS) // PERIOD_NS for pair in stereo]
        assert stamps == [1, 3, 4, 5]
        assert (stereo.unpaired, stereo.images_read) == (2, 10)
        early = StereoBag(bag, find_stereo_topics(bag.topics))
        next(iter(early))
        assert early.unpaired == 1  # those not read yet may have partners


def test_stamps_that_never_match_say_by_how_much(tmp_path: Path) -> None:
    records = [*shots(LEFT, [0, 10**8]), *shots(RIGHT, [4 * 10**7, 14 * 10**7])]
    path = write_bag(tmp_path / 'bag', [*infos(), *records])
    with pytest.raises(
        BagError,
        match=r'right/image_raw is 40\.000 ms later .*-sync-tolerance-seconds 0\.04$',
    ):
        pairs_of(path)
    assert len(pairs_of(path, 40_400_000)) == 2


def test_a_silent_camera_is_said(tmp_path: Path) -> None:
    path = write_bag(
        tmp_path / 'bag', [*infos(), *shots(LEFT, list(range(200))), *shots(RIGHT, [10**9])]
    )
    with pytest.raises(BagError, match=r'right/image_raw is 1000\.000 ms later'):
        pairs_of(path)


def test_a_recording_of_a_loop_pairs_in_every_round(tmp_path: Path) -> None:
    one_round = [0, 100, 200, 300]
    left, right = shots(LEFT, one_round * 3), shots(RIGHT, [0, 100, 200] * 3)
    records = infos()
    for round_ in range(3):  # the right camera's last image of each round is missing
        records += left[4 * round_ : 4 * round_ + 4] + right[3 * round_ : 3 * round_ + 3]
    records = [(t, m, START_NS + i) for i, (t, m, _) in enumerate(records)]
    path = write_bag(tmp_path / 'bag', records)
    assert [pair.stamp_ns for pair in pairs_of(path)] == [0, 100, 200] * 3


def test_calibration_may_come_after_the_images_and_may_change(tmp_path: Path) -> None:
    records = [*shots(LEFT, [0, 100, 200, 300]), *shots(RIGHT, [0, 100, 200, 300])]
    records += [(t, m, START_NS + 150) for t, m, _ in infos()]
    records += [(t, m, START_NS + 250) for t, m, _ in infos(focal_px=90.0)]
    pairs = pairs_of(write_bag(tmp_path / 'bag', sorted(records, key=lambda record: record[2])))
    assert [pair.rig.focal_px for pair in pairs] == [80.0, 80.0, 80.0, 90.0]
    assert pairs[0].rig is pairs[2].rig


def test_images_without_a_valid_calibration_are_left_out(tmp_path: Path) -> None:
    records = stereo_records(3)
    for index in (4, 6):
        records[index][1].k[:] = 0
    path = write_bag(tmp_path / 'bag', records)
    with Bag(path) as bag:
        pairs = list(StereoBag(bag, find_stereo_topics(bag.topics)))
        assert [pair.stamp_ns for pair in pairs] == [START_NS, START_NS + 2 * PERIOD_NS]
        (note,) = bag.damage
        assert 'left camera: camera is not calibrated' in note


def test_a_camera_that_is_not_calibrated_is_named(tmp_path: Path) -> None:
    records = stereo_records(1)
    records[2][1].k[:] = 0
    with pytest.raises(CalibrationError, match='right camera: camera is not calibrated'):
        pairs_of(write_bag(tmp_path / 'bag', records))


def test_compressed_images_are_decoded_and_a_cut_one_costs_one_frame(tmp_path: Path) -> None:
    records = infos()
    for index in range(2):
        left, right = image_pair(index)
        records += [
            (f'{LEFT}/compressed', compressed_message(left, index), START_NS + index),
            (f'{RIGHT}/compressed', compressed_message(right, index), START_NS + index),
        ]
    records[2][1].data = records[2][1].data[:900]
    first, second = pairs_of(write_bag(tmp_path / 'bag', records))
    with pytest.raises(ImageError, match='left image is truncated'):
        first.images()
    np.testing.assert_array_equal(second.images()[1], image_pair(1)[1])


def test_a_calibration_from_elsewhere_replaces_the_recorded_one(tmp_path: Path) -> None:
    path = write_bag(tmp_path / 'bag', [*shots(LEFT, [0]), *shots(RIGHT, [0])])
    other = rig(123.0)
    with Bag(path) as bag:
        topics = find_stereo_topics(bag.topics, calibrated=True)
        (pair,) = StereoBag(bag, topics, other)
    assert pair.rig is other


def late(topic: str, ahead_ns: int, frames: int = 8) -> list[Record]:
    """Return images recorded as they were taken, with stamps of a clock that is ahead."""
    image = image_pair(0)[0 if topic == LEFT else 1]
    return [
        (
            topic,
            image_message(image, START_NS + k * PERIOD_NS + ahead_ns),
            START_NS + k * PERIOD_NS,
        )
        for k in range(frames)
    ]


def test_clocks_that_differ_are_measured(tmp_path: Path) -> None:
    ahead_ns = 3_600_060_000_000
    path = write_bag(tmp_path / 'bag', [*infos(), *late(LEFT, 0), *late(RIGHT, ahead_ns)])
    text = (
        r'its clock is 3600060\.000 ms ahead, a constant \(spread 0\.000 ms\); give --stamp-offset'
        r' -3600\.060000, or --pairing arrival if a hardware trigger took them$'
    )
    with pytest.raises(BagError, match=text):
        pairs_of(path)
    for options in (PairingOptions(stamp_offset=-3600.06), PairingOptions(pairing='arrival')):
        with Bag(path) as bag:
            found = list(StereoBag(bag, find_stereo_topics(bag.topics), pairing=options))
        assert [pair.stamp_ns for pair in found] == [START_NS + k * PERIOD_NS for k in range(8)]


@pytest.mark.parametrize('frames', [2, 3, 20])
def test_stamps_that_do_not_advance_are_refused(tmp_path: Path, frames: int) -> None:
    images = image_pair(0)
    records = infos()
    for k in range(frames):
        for topic, image in zip((LEFT, RIGHT), images, strict=True):
            records.append((topic, image_message(image, 0), START_NS + k * PERIOD_NS))
    path = write_bag(tmp_path / 'bag', records)
    text = (
        r'stamps of /left/image_raw do not advance: all are 0\.000000000 s, .* let the driver'
        r' stamp them, or give --pairing arrival'
    )
    with pytest.raises(BagError, match=text):
        pairs_of(path)
    with Bag(path) as bag:
        options = PairingOptions(pairing='arrival')
        assert len(list(StereoBag(bag, find_stereo_topics(bag.topics), pairing=options))) == frames
