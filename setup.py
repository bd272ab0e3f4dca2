# SPDX-License-Identifier: Apache-2.0
"""Build and installation; ``package.xml`` states the same for ROS."""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path
from typing import Any

from setuptools import find_packages, setup

PACKAGE = 'binocular_recon'
# The file names suffice: importing a node needs ROS.
NODES = sorted(path.stem for path in Path(PACKAGE, 'nodes').glob('*_node.py'))
ADDRESSES = {'repository': 'Source', 'issues': 'Issues', 'documentation': 'Documentation'}


def maintainers() -> dict[str, str]:
    """Return the table of MAINTAINERS.md: what each field is set to, '' where it is not yet."""
    text = Path(__file__).with_name('MAINTAINERS.md').read_text(encoding='utf-8')
    rows = re.findall(r'^\| ([\w-]+) \|(.*)\|$', text, re.MULTILINE)
    return {field: value.strip() for field, value in rows[1:]}


def long_description(repository: str) -> str:
    """Return the README; once the repository has an address, its links lead there."""
    text = Path('README.md').read_text(encoding='utf-8')
    if repository:
        text = re.sub(r'(!\[[^]]*\])\((?!https?:)', rf'\1({repository}/raw/HEAD/', text)
        text = re.sub(r'\]\((?!https?:|#)', f']({repository}/blob/HEAD/', text)
    return text


def shared_files() -> list[tuple[str, list[str]]]:
    """Return what goes to ``share/`` beside ``package.xml``, by folder."""
    share = defaultdict(list)
    for folder in ('bags', 'config', 'launch', 'rviz'):
        for path in sorted(Path(folder).rglob('*')):
            if path.is_file() and '__pycache__' not in path.parts:
                share[f'share/{PACKAGE}/{path.parent.as_posix()}'].append(path.as_posix())
    return list(share.items())


def arguments() -> dict[str, Any]:
    """Return the arguments of ``setup``."""
    facts = maintainers()
    return {
        'name': PACKAGE,
        'version': '0.1.0',
        'description': 'Accurate 3-D point clouds of large scenes from a long-baseline stereo rig',
        'long_description': long_description(facts['repository']),
        'long_description_content_type': 'text/markdown',
        'maintainer': facts['maintainer'],
        'maintainer_email': facts['e-mail'] or None,
        'project_urls': {name: facts[field] for field, name in ADDRESSES.items() if facts[field]},
        'license': 'Apache-2.0',
        'keywords': ['calibration', 'photogrammetry', 'point cloud', 'ROS 2', 'stereo', 'survey'],
        'classifiers': [
            'Development Status :: 4 - Beta',
            'Environment :: Console',
            'Intended Audience :: Developers',
            'Intended Audience :: Science/Research',
            'Operating System :: POSIX :: Linux',
            'Programming Language :: Python :: 3 :: Only',
            'Programming Language :: Python :: 3.10',
            'Programming Language :: Python :: 3.11',
            'Programming Language :: Python :: 3.12',
            'Programming Language :: Python :: 3.13',
            'Programming Language :: Python :: Implementation :: CPython',
            'Topic :: Scientific/Engineering :: GIS',
            'Topic :: Scientific/Engineering :: Image Processing',
            'Typing :: Typed',
        ],
        'packages': find_packages(include=[PACKAGE, f'{PACKAGE}.*']),
        'package_data': {PACKAGE: ['py.typed', 'drawing/assets/*', 'viewer/page/*']},
        'data_files': [
            ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
            (f'share/{PACKAGE}', ['package.xml']),
            *shared_files(),
        ],
        'python_requires': '>=3.10',
        'install_requires': [
            'lz4>=4,<5',
            # Before 0.61 it mixes up the types of calls from several threads; docs/numba.md says
            # why there is an upper bound and how to raise it.
            'numba>=0.61,<0.69',
            'numpy>=1.26,<3',
            'opencv-python-headless>=4.6.0.66,<6',
            'PyYAML>=6',
            'rosbags>=0.11.9,<0.12',
            'scipy>=1.11.4',
        ],
        'extras_require': {
            'cluster': ['dask>=2024.8', 'distributed>=2024.8'],
            'e57': ['pye57>=0.4.13,<0.5'],
            'merge': ['small_gicp>=1.0,<2'],
            'onnx': ['onnxruntime>=1.20'],
            'survey': ['laspy[lazrs]>=2.5.4,<3', 'pyproj>=3.6.1,<4'],
            'video': ['av>=12'],
            'view': ['viser>=1.1,<2'],
            'test': ['packaging', 'pytest', 'pytest-timeout'],
        },
        'zip_safe': False,
        'entry_points': {
            'console_scripts': [
                f'binocular-recon = {PACKAGE}.cli.main:main',
                f'play_bag = {PACKAGE}.cli.clouds.play:main',
                *(f'{node} = {PACKAGE}.nodes.executables:{node}' for node in NODES),
            ],
        },
    }


if __name__ == '__main__':
    setup(**arguments())
