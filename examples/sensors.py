# SPDX-License-Identifier: MIT
"""Print the controller's configuration of the sensors, from a recording of the arm at a standstill.

    python examples/sensors.py LOG.csv

LOG.csv has a header and columns q_0, q_1, ... [rad] and dq_0, dq_1, ... [rad/s], one row per sample, some seconds long.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import numpy as np

import stiffgen


def main(arguments: Sequence[str] | None = None) -> int:
    """Print what a recording of positions and velocities tells of the encoders."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", help="recording, CSV with a header")
    options = parser.parse_args(arguments)
    rows = np.genfromtxt(options.log, delimiter=",", names=True)
    q, dq = (
        np.column_stack([rows[name] for name in rows.dtype.names or () if name.startswith(start)])
        for start in ("q_", "dq_")
    )
    try:
        print(stiffgen.estimate_sensors(q, dq).text)
    except stiffgen.StiffgenError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
