# SPDX-License-Identifier: Apache-2.0
"""One module per format of calibrations, each with a class derived from `CalibrationFormat`.

A module knows the names of its format and converts its conventions: which way poses go, where
the first pixel has its centre, the unit of length, the order of coefficients. `FORMATS` in the
registry above lists them.
"""
