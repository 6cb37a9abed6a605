# SPDX-License-Identifier: MIT
"""Package: the build and the README of a folder."""
