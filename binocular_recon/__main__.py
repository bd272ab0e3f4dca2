# SPDX-License-Identifier: Apache-2.0
"""``python -m binocular_recon``: the command line."""

import os
import sys

# `python -m` looks for modules in the current folder first. What lies there, beside a bag that
# somebody sent, is not to be run.
try:
    here = os.getcwd()  # noqa: PTH109 - as Python states it
except OSError:  # it was removed
    here = ''
if sys.path and sys.path[0] in ('', here):
    del sys.path[0]

from binocular_recon.cli.main import main

if __name__ == '__main__':
    sys.exit(main())
