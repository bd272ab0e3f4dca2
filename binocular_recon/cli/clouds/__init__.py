# SPDX-License-Identifier: Apache-2.0
"""Commands that turn images into clouds and disparity maps, or show them to other programs.

The work is in `apps`, the chain in `stereo`; here is what a person types, and what is printed.
Nothing is exported.
"""
