# SPDX-License-Identifier: Apache-2.0
"""The frames of a run: computed one after the other, or at the same time, to the same bits.

`frame_loop` reads the pairs in their order, hands them to a place where frames are computed, and
puts what comes back into the output folder in the same order. A place takes a `FrameTask` and
returns a future of its `FrameOutcome`: `places` has this process, `local_processes` several of
them, whose loop is `worker`, and `dask_cluster` those of other machines. What a frame takes over
from those before it (`stream_state`) is decided in the order of the frames, before a pair is
handed out where the images say it, and after it came back where its result does.
"""
