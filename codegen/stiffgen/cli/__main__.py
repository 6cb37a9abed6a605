# SPDX-License-Identifier: MIT
"""Run the command line as ``python -m stiffgen.cli``."""

import sys

from stiffgen.cli import main

sys.exit(main())
