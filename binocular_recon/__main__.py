# SPDX-License-Identifier: Apache-2.0
"""``python -m binocular_recon``: the command line."""

import sys

from binocular_recon.cli.main import main

if __name__ == '__main__':
    sys.exit(main())
