# SPDX-License-Identifier: Apache-2.0
"""Commands that calibrate a rig, check a calibration, or read that of another program.

The work is in `calibration` and `io.calibrations`; here is what a person types, and what is
printed. Nothing is exported.
"""
