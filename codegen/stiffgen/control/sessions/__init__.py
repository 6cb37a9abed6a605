# SPDX-License-Identifier: MIT
"""Sessions that compare a folder's controller with a library of it that is compiled anew, and with its law."""

from stiffgen.control.sessions.check import check_controller
from stiffgen.control.sessions.sessions import check_sessions

__all__ = ["check_controller", "check_sessions"]
