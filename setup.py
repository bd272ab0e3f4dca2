# SPDX-License-Identifier: Apache-2.0
"""Build and installation; ``package.xml`` states the same for ROS."""

from collections import defaultdict
from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = 'binocular_recon'
# The file names suffice: importing a node needs ROS.
NODES = sorted(path.stem for path in Path(PACKAGE, 'nodes').glob('*_node.py'))

share = defaultdict(list)
for folder in ('bags', 'config', 'launch', 'rviz'):
    for path in sorted(Path(folder).rglob('*')):
        if path.is_file() and '__pycache__' not in path.parts:
            share[f'share/{PACKAGE}/{path.parent.as_posix()}'].append(path.as_posix())

setup(
    name=PACKAGE,
    version='0.1.0',
    description='Accurate 3-D point clouds of large scenes from a long-baseline stereo rig',
    license='Apache-2.0',
    packages=find_packages(include=[PACKAGE, f'{PACKAGE}.*']),
    package_data={PACKAGE: ['py.typed']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
        *share.items(),
    ],
    python_requires='>=3.10',
    install_requires=[
        'numba>=0.61',  # earlier ones mix up the types of calls from several threads
        'numpy>=1.26,<3',
        'opencv-python-headless>=4.6.0.66,<6',
        'PyYAML>=6',
        'rosbags>=0.11.9,<0.12',
        'scipy>=1.11.4',
    ],
    extras_require={'test': ['pytest', 'pytest-timeout']},
    zip_safe=False,
    entry_points={
        'console_scripts': [
            f'binocular-recon = {PACKAGE}.cli.main:main',
            f'play_bag = {PACKAGE}.cli.play:main',
            *(f'{node} = {PACKAGE}.nodes.{node}:main' for node in NODES),
        ],
    },
)
