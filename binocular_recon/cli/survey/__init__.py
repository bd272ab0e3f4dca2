# SPDX-License-Identifier: Apache-2.0
"""Commands that work on the output folder of ``reconstruct``.

One module per command, as in the folder above: ``measure`` measures between picks,
``georeference`` ties the rig to control points or levels it, ``merge`` makes one cloud of many
frames or stations, ``report`` writes the survey for a client. ``tour`` is what ``demo --survey``
does with them.
"""
