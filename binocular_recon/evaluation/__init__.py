# SPDX-License-Identifier: Apache-2.0
"""Accuracy against ground truth and time against OpenCV, measured side by side."""
