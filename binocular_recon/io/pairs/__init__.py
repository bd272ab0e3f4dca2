# SPDX-License-Identifier: Apache-2.0
"""Image pairs from files: folders, patterns, single images and videos.

`file_lists` finds the files that a person names. `file_pairs` decides which of them belong
together, by the number in their names, by their order or by their times, which `capture_times`
reads; `stereo_files` yields the pairs. `video` decodes videos, `stereo_video` pairs the frames of
two, or splits those of one. `io.bags` does the same for recordings.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.io.pairs.file_lists import find_files, is_video
    from binocular_recon.io.pairs.file_pairs import PAIR_BY, FilePairs, pair_files
    from binocular_recon.io.pairs.stereo_files import StereoFiles
    from binocular_recon.io.pairs.stereo_video import SideBySideVideo, StereoVideo

__all__ = [
    'PAIR_BY',
    'FilePairs',
    'SideBySideVideo',
    'StereoFiles',
    'StereoVideo',
    'find_files',
    'is_video',
    'pair_files',
]

__getattr__ = lazy_exports(__name__, __file__)
