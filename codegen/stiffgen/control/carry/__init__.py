# SPDX-License-Identifier: MIT
"""Object that several tips hold: Follow takes them along one way of the object."""
