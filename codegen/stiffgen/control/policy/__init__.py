# SPDX-License-Identifier: MIT
"""Policy port: proposals of slow commanders, made into a command for each step."""
