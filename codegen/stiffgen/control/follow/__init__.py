# SPDX-License-Identifier: MIT
"""Maker of joint positions from poses: tables of its fields, and its C."""
