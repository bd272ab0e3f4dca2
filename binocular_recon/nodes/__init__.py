# SPDX-License-Identifier: Apache-2.0
"""ROS 2 nodes; the only package that imports rclpy and messages.

One module per executable: `rectify_node`, `match_node`, `wls_filter_node`, `calibration_node`
(with `calibration_steps` and `newest_pair`) and `play_bag`. What they share is in `runtime`.
Nothing is exported: nodes are started, not imported.
"""
