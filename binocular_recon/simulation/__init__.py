# SPDX-License-Identifier: Apache-2.0
"""Scenes and rigs whose truth is known."""
