# SPDX-License-Identifier: MIT
"""The tests, as a package that comes before one of the same name that other projects install."""
