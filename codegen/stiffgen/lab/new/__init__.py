# SPDX-License-Identifier: MIT
"""``stiffgen new``: a small project of the user's own around a generated robot."""
