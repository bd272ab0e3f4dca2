# SPDX-License-Identifier: Apache-2.0
"""What all nodes share: topics and their QoS, parameters, pairing, work, diagnostics, life.

`base_node` is the class they derive from; `endpoints` makes publishers and subscriptions with
their QoS, `parameters` and `options` declare parameters, `worker` runs the work in its own
thread, `health` counts for `/diagnostics`, `process` starts and ends a node.
"""
