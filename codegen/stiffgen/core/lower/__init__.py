# SPDX-License-Identifier: MIT
"""Lower programs to loops over arrays with storage; bound the rounding errors of what is printed."""
