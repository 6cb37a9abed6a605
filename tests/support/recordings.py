# SPDX-License-Identifier: MIT
"""Write one recording in every format that ``stiffgen analyze`` reads."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from mcap.writer import CompressionType
from mcap_ros2.writer import Writer

NAMES = ("time", *(f"q_{i}" for i in range(7)), *(f"wrench_{i}" for i in range(6)))
JOINT_STATE = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
"""
WRENCH_STAMPED = """std_msgs/Header header
geometry_msgs/Wrench wrench
================================================================================
MSG: geometry_msgs/Wrench
geometry_msgs/Vector3 force
geometry_msgs/Vector3 torque
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""
HEADER = """================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def draw(count: int, seed: int = 5) -> np.ndarray:
    """Draw rows (count, 14): time, q and wrench of an iiwa, columns as NAMES."""
    random = np.random.default_rng(seed)
    phase = np.arange(count)[:, None] * 0.01
    q = np.linspace(-1, 1, 7) + 0.5 * np.sin(phase + np.arange(7)) + random.normal(size=(count, 7)) * 0.01
    wrench = np.array([5, 10, 20, 3, 2, 1]) * np.sin(phase * np.arange(1, 7) + 1) + random.normal(size=(count, 6)) * 0.1
    return np.hstack([np.arange(count)[:, None] * 0.005, q, wrench])


def write_csv(path: Path, rows: np.ndarray, names: Sequence[str] = NAMES, delimiter: str = ",") -> Path:
    lines = [delimiter.join(names), *(delimiter.join(repr(float(v)) for v in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_parquet(path: Path, rows: np.ndarray, names: Sequence[str] = NAMES, **options: Any) -> Path:
    pa.parquet.write_table(pa.table(dict(zip(names, rows.T.copy(), strict=True))), path, **options)
    return path


def write_npz(path: Path, rows: np.ndarray, *, compressed: bool = False, fortran: bool = False) -> Path:
    order = np.asfortranarray if fortran else np.ascontiguousarray
    save = np.savez_compressed if compressed else np.savez
    save(path, time=rows[:, 0], q=order(rows[:, 1:8]), wrench=order(rows[:, 8:]))
    return path


def stamp(nanoseconds: int) -> SimpleNamespace:
    time = SimpleNamespace(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
    return SimpleNamespace(stamp=time, frame_id="sensor")


def write_mcap(
    path: Path,
    rows: np.ndarray,
    joints: Sequence[str],
    *,
    delay: int = 1_000_000,
    skip: Container[int] = (),
    extra_topics: Iterable[str] = (),
    compressed: bool = True,
    clocks: Callable[[int], tuple[int, int, int]] = lambda index: (0, 0, 0),
) -> Path:
    """Write wrenches ``delay`` ns after their joint positions; omit those of the rows in ``skip``.

    ``clocks`` tells for a row how wrong the clocks of joints, sensor and recorder are [ns].
    """
    with path.open("wb") as file:
        writer: Any = Writer(file, compression=CompressionType.ZSTD if compressed else CompressionType.NONE)
        states = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE + HEADER)
        wrenches = writer.register_msgdef("geometry_msgs/msg/WrenchStamped", WRENCH_STAMPED + HEADER)
        for index, row in enumerate(rows):
            joint_clock, sensor_clock, recorder = clocks(index)
            now = 10**9 + round(row[0] * 1e9)
            measured, logged = now + joint_clock, now + recorder
            # Joints come in another order, with one that is not of the arm; a gripper uses the same topic.
            state = {"name": ["finger", *reversed(joints)], "position": [0.5, *row[7:0:-1]]}
            writer.write_message("/joint_states", states, {"header": stamp(measured), **state}, log_time=logged)
            gripper = {"header": stamp(measured), "name": ["thumb"], "position": [1.0]}
            writer.write_message("/joint_states", states, gripper, log_time=logged)
            if index in skip:
                continue
            f, m = (dict(zip("xyz", row[at : at + 3], strict=True)) for at in (8, 11))
            message = {"header": stamp(now + sensor_clock + delay), "wrench": {"force": f, "torque": m}}
            for topic in ("/wrench", *extra_topics):
                writer.write_message(topic, wrenches, message, log_time=logged + delay)
        writer.finish()
    return path
