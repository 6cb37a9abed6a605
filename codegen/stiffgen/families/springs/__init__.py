# SPDX-License-Identifier: MIT
"""Family springs: potentials of the tip."""
