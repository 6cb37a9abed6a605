# SPDX-License-Identifier: MIT
"""Set the environment of a test process; import this module before NumPy."""

import os

# Matrices here are small: threads of the linear algebra would only keep the workers from their cores.
for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")
# Folders of single tests are compiled without optimisation, much faster than a release; `robot_folder` is a release.
os.environ.setdefault("CFLAGS", "-O0")
