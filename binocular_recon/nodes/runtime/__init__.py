# SPDX-License-Identifier: Apache-2.0
"""What all nodes share: topics and their QoS, parameters, pairing, diagnostics, start and end.

`base_node` is the base of every node, `frame_node` that of nodes which process frames: sets of
messages with matching stamps. `endpoints` creates publishers and subscriptions with their QoS,
`parameters` and `options` declare parameters, `worker` runs jobs in a thread of their own,
`health` counts and remembers problems for the publisher in `diagnostics`, `process` runs a node
until it is interrupted.
"""
