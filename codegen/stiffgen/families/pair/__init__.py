# SPDX-License-Identifier: MIT
"""Family pair: springs between two tips."""
