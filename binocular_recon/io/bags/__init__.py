# SPDX-License-Identifier: Apache-2.0
"""Bags: ROS 1, ROS 2 sqlite3 and mcap, read and written without ROS.

`reader` reads messages, also those of damaged files (`_sources`, `_salvage`) and of ROS 1
(`_ros1_conversion`). `writer` writes them. `stereo_topics` finds the topics of a rig, and
`stereo_bag` pairs its images. Only this room imports rosbags.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.io.bags.reader import Bag, BagMessage
    from binocular_recon.io.bags.stereo_bag import StereoBag, StereoFrame
    from binocular_recon.io.bags.stereo_topics import (
        StereoTopics,
        find_stereo_topics,
        name_stereo_topics,
    )
    from binocular_recon.io.bags.writer import BagWriter

__all__ = [
    'Bag',
    'BagMessage',
    'BagWriter',
    'StereoBag',
    'StereoFrame',
    'StereoTopics',
    'find_stereo_topics',
    'name_stereo_topics',
]

__getattr__ = lazy_exports(__name__, __file__)
