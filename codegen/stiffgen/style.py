# SPDX-License-Identifier: MIT
"""Style of the package's figures, under the name that users' scripts have."""

from stiffgen.lab.style import *  # noqa: F403
