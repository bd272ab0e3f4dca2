# SPDX-License-Identifier: Apache-2.0
"""The services of `calibration_node` and what they are made of.

`services` does what each service promises and words its answer; `steps` holds the checks of a
capture, `newest_pair` the image pair that it takes, `camera_drivers` passes a calibration on.
Only the last one needs ROS. Nothing is exported.
"""
