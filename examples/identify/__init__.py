# SPDX-License-Identifier: MIT
"""Which stiffness does an arm have at the tool, and where is the tool? Learned from a recording by gradient descent."""
