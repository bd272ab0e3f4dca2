# SPDX-License-Identifier: Apache-2.0
"""The other ends of the nodes for measurements of running ones: cameras and a listener.

Each is a process of its own, ``python -m binocular_recon.nodes.live.producer`` and
``... .listener``, that takes commands on stdin and writes one JSON object a line to stdout; the
program that measures (`evaluation.speed.live`) needs no ROS itself.
"""
