# SPDX-License-Identifier: Apache-2.0
"""The .ini files of ROS's camera_calibration_parsers, and the ost.txt of cameracalibrator."""

from __future__ import annotations

from typing import Any

# Lines of such a file, and the names of what follows them in camera files in YAML.
_NAMES = {
    'width': 'image_width',
    'height': 'image_height',
    'camera matrix': 'camera_matrix',
    'distortion': 'distortion_coefficients',
    'rectification': 'rectification_matrix',
    'projection': 'projection_matrix',
}
_IMAGE = '[image]'


def is_ini(head: bytes) -> bool:
    """Return whether a file that begins so is one of them."""
    return any(line.strip() == _IMAGE.encode() for line in head.splitlines())


def ini_values(text: str) -> dict[str, Any]:
    """Return the values of a file under the names of camera files in YAML."""
    values: dict[str, Any] = {}
    words: dict[str, list[str]] = {name: [] for name in _NAMES.values()}
    name = ''
    for line in map(str.strip, text.splitlines()):
        if line.startswith('['):
            name = ''
            if line not in (_IMAGE, '[externals]'):
                values['camera_name'] = line.strip('[]')
        elif line in _NAMES:
            name = _NAMES[line]
        elif name and not line.startswith(('#', ';')):
            words[name] += line.split()
    for name, found in words.items():
        if found:
            single = name.startswith('image') and len(found) == 1
            values[name] = found[0] if single else {'data': found}
    return values
