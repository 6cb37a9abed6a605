# SPDX-License-Identifier: MIT
"""Family manipulability: manipulability and its gradient."""
