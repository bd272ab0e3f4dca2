# SPDX-License-Identifier: Apache-2.0
"""ROS 2 nodes; the only package that imports rclpy and messages.

Each module ``<name>_node.py`` is a node and an executable: `rectify_node`, `match_node`,
`wls_filter_node` and `calibration_node`, whose services are in the room `calibration`. `registry`
finds them; adding a node means adding such a module. `play_bag` publishes a bag with the `player`.
What all nodes share is in `runtime`. Nothing is exported: nodes are started, not imported.
"""
