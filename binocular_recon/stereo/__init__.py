# SPDX-License-Identifier: Apache-2.0
"""From a stereo pair to a point cloud: rectify, match, filter, triangulate."""
