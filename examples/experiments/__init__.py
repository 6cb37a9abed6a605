# SPDX-License-Identifier: MIT
"""What both of the paper's experiments use: the arm in MuJoCo, a trial, figures, and the report."""
