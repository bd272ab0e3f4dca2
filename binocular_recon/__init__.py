# SPDX-License-Identifier: Apache-2.0
"""Accurate 3-D point clouds of large scenes from a long-baseline stereo rig."""

__version__ = '0.1.0'
