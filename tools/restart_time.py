# SPDX-License-Identifier: Apache-2.0
"""Measure how long a node takes from its start, after it was killed, to its first output.

``.venv/bin/python tools/restart_time.py [NODE]``, on a quiet machine. Prints the time of the
clock and of the processor, s, of some restarts.
"""

from __future__ import annotations

import itertools
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
RESTARTS = 7
TIMEOUT_S = 300.0
os.environ.setdefault(
    'FASTDDS_DEFAULT_PROFILES_FILE', f'{REPOSITORY}/config/fastdds_shared_memory.xml'
)
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')


def main() -> None:
    """Restart a node and print the times."""
    import rclpy  # noqa: F401 - starts Python again with its libraries on the path

    import test  # that of the repository, not Python's own

    test.__path__ = [str(REPOSITORY / 'test')]
    import numpy as np
    from sensor_msgs.msg import Image, PointCloud2
    from stereo_msgs.msg import DisparityImage

    from binocular_recon.io.messages.disparities import fill_disparity
    from test.system.graph import Graph, NodeProcess, wait_until
    from test.system.rig import CameraPair, header, image_pair, raw_rig

    name = sys.argv[1] if len(sys.argv) > 1 else 'match_node'
    rig = raw_rig(width=640, height=480)
    images = image_pair(1, 640, 480)
    output, kind, suffix = {
        'rectify_node': ('/rig/left/image_rect', Image, 'image_raw'),
        'match_node': ('/rig/disparity', DisparityImage, 'image_rect'),
        'wls_filter_node': ('/rig/points2', PointCloud2, 'image_rect'),
        'stereo_node': ('/rig/points2', PointCloud2, 'image_raw'),
    }[name]
    graph = Graph()
    cameras = CameraPair(graph, rig, image=suffix)
    numbers = itertools.count()
    plane, disparity = np.full((480, 640), 12, np.float32), DisparityImage()
    disparities = graph.publisher('/rig/disparity', DisparityImage) if 'wls' in name else None
    times = []
    inbox = graph.inbox(output, kind)
    with tempfile.TemporaryDirectory() as folder:
        for restart in range(RESTARTS):
            node = NodeProcess(name, Path(folder) / f'{restart}.log')
            begun_s = time.monotonic()
            inbox.messages.clear()

            def came() -> bool:
                number = next(numbers)
                cameras.send(number, images)
                if disparities is not None:
                    head = header(number)
                    fill_disparity(disparity, plane, rig, (0, 64), head, step_px=1)
                    disparities.publish(disparity)
                return bool(inbox.messages)

            wait_until(came, 'an output', TIMEOUT_S, every_s=0.1)
            seconds = time.monotonic() - begun_s
            fields = Path(f'/proc/{node.process.pid}/stat').read_text().rpartition(')')[2].split()
            cpu_s = sum(map(int, fields[11:13])) / os.sysconf('SC_CLK_TCK')
            print(f'{name}: {seconds:.2f} s, processor {cpu_s:.2f} s', flush=True)
            times.append((seconds, cpu_s))
            node.process.kill()
            node.process.wait()
    graph.close()
    median = (statistics.median(column) for column in zip(*times[1:], strict=True))
    print('median without the first: {:.2f} s, processor {:.2f} s'.format(*median))


if __name__ == '__main__':
    main()
