# SPDX-License-Identifier: MIT
"""Family derivatives: gradients in reverse mode."""
