# SPDX-License-Identifier: MIT
"""Files of others: xacro, MJCF, robots by name, lint."""
