# SPDX-License-Identifier: Apache-2.0
"""The stages of the chain as parts of nodes: what is made of a frame, reported and published.

A stage belongs to a `FrameNode`, whose options, health and outputs it uses: `rectification`,
`matching` and `filtering`. The nodes of one stage read their messages and hand arrays to it;
`stereo_node` hands the arrays of one stage to the next.
"""
