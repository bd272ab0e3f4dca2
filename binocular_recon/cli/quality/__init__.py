# SPDX-License-Identifier: Apache-2.0
"""Commands that measure accuracy and speed, and that simulate what has a known truth.

The work is in `evaluation` and `simulation`; here is what a person types, and the tables that are
printed. `warm-up` prepares a machine for all of them. Nothing is exported.
"""
