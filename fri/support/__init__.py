# SPDX-License-Identifier: MIT
"""Builds, sessions and checks that several tests of FRI share."""
