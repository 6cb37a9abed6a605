# SPDX-License-Identifier: MIT
"""Family loops: closed loops in motor coordinates."""
