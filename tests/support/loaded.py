# SPDX-License-Identifier: MIT
"""Load what commands import when they run: the server of ``support.confined`` imports it once for all its copies."""

import stiffgen.control.sessions
import stiffgen.core.generate
import stiffgen.core.verify.verify  # noqa: F401
