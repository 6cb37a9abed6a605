# SPDX-License-Identifier: MIT
"""Family joints: potentials of the joints."""
