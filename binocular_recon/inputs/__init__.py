# SPDX-License-Identifier: Apache-2.0
"""What inputs state and what they hold, where the two may differ.

`camera_checks` knows the faults of camera infos and the names that mean the same, and
`camera_reading` which of their members count. `levels` finds black and white of images whose type
does not say them. `clocks` compares the clocks of
cameras and `queues` holds messages that wait for their partners. `options` holds the options of
these, a part of `config`.
"""
