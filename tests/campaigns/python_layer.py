# SPDX-License-Identifier: MIT
"""Schedules of energy.py through the Python class ``Impedance`` in place of the C controller, to compare both.

The class takes the robot's samples as a user gives them: missing samples by ``missed()``, late ones by the time of
their clock, changed configurations as fields that are set. Both run the same compiled code: they agree in every bit.
"""

from __future__ import annotations

import ctypes
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any

import numpy as np

from support.plant.loop import Loop, fill, struct

_COMMANDS = ("wrench_command", "velocity", "acceleration", "torque_offset", "wrench")
_BY_POSE = 2
"""The header's COMMAND_EQUILIBRIUM."""
_STEP = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)


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
        self._config, self._first = b"", 0
        self.calls, self.failure, self.refused = 0, "", False

    def __enter__(self) -> PythonLayer:
        address = ctypes.cast(self._inside, ctypes.c_void_p).value
        ctypes.c_void_p.in_dll(self._loop.library, "law_elsewhere").value = address
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        ctypes.c_void_p.in_dll(self._loop.library, "law_elsewhere").value = None

    def _serve(self, config: int, given: int | None, output: int | None) -> int:
        """Do what law.c asks for. An error of Python cannot pass through C: it ends as a code, and is kept."""
        try:
            if given is None:
                self._config = ctypes.string_at(config, ctypes.sizeof(self._loop.Config))
                self._controller = self._module.Impedance(self._fields(config), errors="ignore")
                self._first = -1
            elif output is None:
                self._controller.reset()
            else:
                self._step(config, self._Input.from_address(given), self._loop.Output.from_address(output))
        except ValueError as error:
            self.failure = str(error)
            return -1
        return 0

    def _fields(self, config: int) -> dict[str, Any]:
        record = self._loop.Config.from_address(config)
        values = ((name, getattr(record, name)) for name, _ in self._loop.Config._fields_)
        return {name: np.array(value) if isinstance(value, ctypes.Array) else value for name, value in values}

    def _step(self, config: int, given: Any, output: Any) -> None:
        now = ctypes.string_at(config, ctypes.sizeof(self._loop.Config))
        if now != self._config:
            try:
                self._controller.config.update(self._fields(config))
            except ValueError:
                self.refused = True  # C takes it, and its step is a fault
                raise
            self._config = now
        self.calls += 1
        out = self._controller.step(**self._sample(given)) if given.sample_valid else self._controller.missed()
        fill(output, **{name: out[name] for name in out.names})

    def _sample(self, given: Any) -> dict[str, Any]:
        """Return a sample's values as arguments of ``step``."""
        values: dict[str, Any] = {name: np.array(getattr(given, name)) for name in ("q", "dq", *_COMMANDS)}
        values |= {f"{kind}_stiffness": np.reshape(getattr(given, f"{kind}_stiffness"), (3, 3))
                   for kind in ("translation", "rotation")}  # fmt: skip
        if given.command == _BY_POSE:
            values |= {"equilibrium": np.reshape(given.equilibrium, (4, 4)), "posture": np.array(given.q0)}
        else:
            values["q0"] = np.array(given.q0)
        if self._by_time:
            self._first = given.counter if self._first < 0 else self._first
            counted = (given.counter - self._first) % 2**32  # the counter wraps, the clock does not
            return values | {"time": counted * float(self._controller.config.sample_time)}
        return values | {"counter": given.counter}
