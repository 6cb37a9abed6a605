# SPDX-License-Identifier: MIT
"""Errors and warnings of the package, under the name that users' warning filters have."""

from stiffgen.core.errors import *  # noqa: F403
