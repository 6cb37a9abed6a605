# SPDX-License-Identifier: MIT
"""Schedules of energy.py through the Python class ``Impedance`` in place of the C controller, to compare both.

The class takes the robot's samples as a user gives them: missing samples by ``missed()``, late ones by the time of
their clock, changed configurations by another start. Both run the same compiled code: they agree in every bit.
"""

from __future__ import annotations

import ctypes
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any

import numpy as np

from support.plant.loop import Loop, fill, struct

_VECTORS = ("q", "dq", "q0", "posture_stiffness", "wrench_command", "acceleration", "torque_offset")
_STEP = ctypes.CFUNCTYPE(ctypes.c_int, *[ctypes.c_void_p] * 4)


def module_sources(robot: Path) -> tuple[str, ...]:
    """Return the compiled Python module of a robot's folder, which a loop can use in place of the C files."""
    (module,) = (robot / "python").glob(f"{robot.name}_python*.so")
    return (str(module.resolve()),)


class PythonLayer:
    """Python's controller in a loop, while the context lasts.

    Args:
        loop: of a robot with one tip.
        module: of the same robot's folder.
        by_time: whether samples are told by the time of a clock, in place of their counter.

    """

    def __init__(self, loop: Loop, module: ModuleType, by_time: bool = True) -> None:
        self._loop, self._module, self._by_time = loop, module, by_time
        header = loop.robot / f"{loop.robot.name}_impedance.h"
        self._Input = struct(header, f"{loop.robot.name}_impedance_input", {}, {})
        self._inside = _STEP(self._serve)
        self._first, self._period = 0, 0.0
        self.calls, self.failure = 0, ""

    def __enter__(self) -> PythonLayer:
        address = ctypes.cast(self._inside, ctypes.c_void_p).value
        ctypes.c_void_p.in_dll(self._loop.library, "law_elsewhere").value = address
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        ctypes.c_void_p.in_dll(self._loop.library, "law_elsewhere").value = None

    def _serve(self, config: int, torque: int | None, given: int | None, output: int | None) -> int:
        """Do what law.c asks for. An error of Python cannot pass through C: it ends as a code, and is kept."""
        try:
            if given is None:
                fields = self._fields(config)
                force = np.ctypeslib.as_array((ctypes.c_double * self._loop.n).from_address(torque)) if torque else 0.0
                self._controller = self._module.Impedance(torque=force, errors="ignore", **fields)
                self._first, self._period = -1, float(fields["sample_time"])
            elif output is None:
                self._controller.reset()
            else:
                self._step(self._Input.from_address(given), self._loop.Output.from_address(output))
        except ValueError as error:
            self.failure = self.failure if given is None else str(error)  # C refuses the configuration, too
            return -1
        return 0

    def _fields(self, config: int) -> dict[str, Any]:
        record = self._loop.Config.from_address(config)
        values = ((name, getattr(record, name)) for name, _ in self._loop.Config._fields_)
        return {name: np.array(value) if isinstance(value, ctypes.Array) else value for name, value in values}

    def _step(self, given: Any, output: Any) -> None:
        """Step the controller by its Python class, and fill the record that the C loop expects."""
        self.calls += 1
        if given.sample_valid:
            out = self._controller.step(**self._clock(given), **self._sample(given))
        else:
            out = self._controller.missed(**self._clock(given))
        refused = out.refusal  # of Python: None, or a record with its reason
        rest = {name: out[name] for name in out.names if name != "refusal"}
        fill(output, **rest, refusal=0 if refused is None else int(refused.reason))

    def _sample(self, given: Any) -> dict[str, Any]:
        """Return a sample's values as arguments of ``step``."""
        values: dict[str, Any] = {name: np.array(getattr(given, name)) for name in _VECTORS}
        values |= {f"{kind}_stiffness": np.reshape(getattr(given, f"{kind}_stiffness"), (3, 3))
                   for kind in ("translation", "rotation")}  # fmt: skip
        return {**values, "shaped": bool(given.shaped)}

    def _clock(self, given: Any) -> dict[str, Any]:
        """Return the counter of a call, or its time."""
        if not self._by_time:
            return {"counter": given.counter}
        self._first = given.counter if self._first < 0 else self._first
        return {"time": (given.counter - self._first) % 2**32 * self._period}  # the counter wraps, the clock does not
