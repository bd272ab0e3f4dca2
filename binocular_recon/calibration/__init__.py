# SPDX-License-Identifier: Apache-2.0
"""Calibration of a long-baseline rig from rods in the scene."""
