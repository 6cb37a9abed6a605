# SPDX-License-Identifier: MIT
"""Episodes of plant, sensors and controller, compiled from C; Python sets them up and reads what was measured.

The structs of the headers are read from the headers: their fields are here under the same names, with the same units.
"""

from __future__ import annotations

import ctypes
import re
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from support.plant.statics import Springs

HERE = Path(__file__).resolve().parent
LAW = HERE / "law.c"
"""The generated controller."""
MAKERS_LAW = HERE / "makers_law.c"
"""The controller behind Settle, Press and Follow, which are told lies; needs :func:`makers_of` a robot."""
FREE = HERE / "free.c"
"""Law without a controller: the arm floats; needs ``sources=KERNELS``."""
KERNELS = ("iiwa14.c", "iiwa14_batch.c")
"""C files of the robot that the plant uses."""
N = 7
Q0 = np.array([0.3, 0.6, -0.4, -1.3, 0.2, 0.9, -0.5])
"""Joint positions of the failures in the controller's issue [rad]."""
BASE = {
    "sample_time": 1e-3,
    "delay_samples": 0,
    "motor_inertia": 0.1,
    "heaviest_wrench": (100.0, 20.0),
    "tank_initial": 10.0,
    "tip_velocity_limit": (0.5, 1.5),
}
"""Careful configuration of the closed-loop tests: a small tank hides little; the rotors are those of ``episode``."""
_TYPES = {
    "double": ctypes.c_double,
    "int": ctypes.c_int,
    "int32_t": ctypes.c_int32,
    "uint32_t": ctypes.c_uint32,
    "uint64_t": ctypes.c_uint64,
}


def struct(header: Path, name: str, known: dict[str, Any], sizes: dict[str, int]) -> type[ctypes.Structure]:
    """Return the C struct of that name as ctypes sees it; ``known`` has the structs that it contains."""
    text = re.sub(r"/\*.*?\*/", "", header.read_text(), flags=re.DOTALL)
    (body,) = re.findall(r"typedef struct(?: \w+)? \{([^{}]*)\}\s*" + name + ";", text)
    fields: list[tuple[str, Any]] = []
    for declaration in filter(None, (part.strip() for part in body.split(";"))):
        kind, names = declaration.split(None, 1)
        for entry in names.split(","):
            found = re.fullmatch(r"(\w+)((?:\[[^]]+\])*)", entry.strip())
            assert found, f"{header.name}: {declaration}"
            base: Any = known[kind] if kind in known else _TYPES[kind]
            for size in reversed(re.findall(r"\[([^]]+)\]", found[2])):
                base = base * _number(size, sizes)
            fields.append((found[1], base))
    return type(name, (ctypes.Structure,), {"_fields_": fields})


def _number(text: str, sizes: dict[str, int]) -> int:
    product = 1
    for factor in text.split("*"):
        factor = factor.strip()
        product *= sizes[factor] if factor in sizes else int(factor)
    return product


def fill(target: ctypes.Structure, **values: Any) -> Any:
    """Set fields; a scalar fills an array field."""
    for name, value in values.items():
        old = getattr(target, name)
        if isinstance(old, ctypes.Array):
            array = np.ctypeslib.as_array(old)
            array[...] = np.asarray(value, dtype=array.dtype).reshape(-1) if np.size(value) > 1 else value
        else:
            setattr(target, name, value)
    return target


def makers_of(robot: Path) -> dict[str, Any]:
    """Return sources and flags of a loop with ``MAKERS_LAW``."""
    parts = ("impedance", "follow", "settle", "press")
    headers = [word for part in parts for word in ("-include", f"{robot.name}_{part}.h")]
    sources = tuple(f"{robot.name}{part}.c" for part in ("", "_batch", *(f"_{part}" for part in parts)))
    return {"sources": sources, "flags": ("-O1", "-march=native", *headers)}


@dataclass(frozen=True)
class _Kind:
    """Kind of a robot: numbers of tips and pairs, tools, entries of the joints with a motor, flags for the plant."""

    tips: int
    pairs: int
    tools: bool
    motors: list[int]
    flags: list[str]


def _kind(robot: Path) -> _Kind:
    """Read from the generated files how many tips and pairs a robot has, whether it takes tools, and its motors."""
    name = robot.name
    header = (robot / f"{name}.h").read_text()
    (dof,) = re.findall(rf"#define {name.upper()}_DOF (\d+)", header)
    scopes = re.findall(rf"^void {name}_(\w*)forward_kinematics\(", header, re.MULTILINE)
    tools = re.search(r"forward_kinematics\([^;]*tool_pose", header) is not None
    flags, motors = (["-DPLANT_TOOLS"] if tools else []), list(range(int(dof)))
    if len(scopes) > 1:
        flags += [f"-DPLANT_{place}={name}_{scope}" for place, scope in zip(("FIRST", "SECOND"), scopes, strict=True)]
    if f"#define {name.upper()}_MOTORS" in header:
        text = (robot / f"{name}_impedance.c").read_text()
        (start,), (found,) = (
            re.findall(rf"static const \w+ loop_{array}\[\w+\] = {{([^}}]*)}}", text) for array in ("start", "motors")
        )
        flags, motors = [*flags, f"-DPLANT_START={start}"], [int(k) for k in found.split(",")]
    pairs = len(re.findall(rf"^void {name}_bimanual_energy\(", header, re.MULTILINE))
    flags += ["-DPLANT_PAIR"] * pairs
    return _Kind(len(scopes), pairs, tools, motors, flags)


class Loop:
    """A control law in the loop.

    Args:
        folder: where to compile; a library that another process compiled there is used again.
        robot: folder of a generated robot, whose tips' paths hold all joints; one tip or two, perhaps closed loops.
        law: C file that implements law.h on the robot's controller.
        sources: C files or libraries of the robot's folder; its kernels and its controller if None.
        home: posture far from limits and singular poses [rad], where episodes start; of the motors of closed loops.

    """

    def __init__(
        self,
        folder: Path,
        robot: Path,
        law: Path = LAW,
        sources: tuple[str, ...] | None = None,
        flags: tuple[str, ...] = ("-O1", "-march=native"),
        home: ArrayLike = Q0,
    ) -> None:
        """Compile plant, law and robot into one library, and read the ctypes records of their headers."""
        path, name = folder / "loop.so", robot.name
        self.robot = robot
        self.home = np.array(home, dtype=float)
        self.n = len(self.home)
        kind = _kind(robot)
        self.tips, self.tools, self.motors = kind.tips, kind.tools, kind.motors
        sources = sources or tuple(f"{name}{part}.c" for part in ("", "_batch", "_impedance"))
        plant = (HERE / file for file in ("plant.c", "robot.c", "episode.c"))
        files = [*plant, law, *(robot / source for source in sources)]
        names = [f"-DROBOT={name}", f"-DUPPER={name.upper()}", f"-DPLANT_N={self.n}", *kind.flags]
        names += ["-include", f"{name}.h"]
        names += ["-include", f"{name}_impedance.h"] if law == LAW else []
        folders = [f"-I{HERE}", f"-I{robot}"]
        command = ["gcc", "-std=c99", *flags, "-shared", "-fPIC", *folders, *names, *map(str, files), "-lm"]
        if not path.exists():
            subprocess.run([*command, "-o", str(path)], check=True)
        self.library = ctypes.CDLL(str(path))
        sizes = {"N": self.n, "TIPS": self.tips, "TWISTS": self.tips + kind.pairs}
        sizes["SPRINGS"] = sizes["TWISTS"] + kind.pairs
        known: dict[str, Any] = {}
        for header, record in (
            (HERE / "plant.h", "plant_t"),
            (HERE / "episode.h", "segment_t"),
            (HERE / "episode.h", "episode_t"),
            (HERE / "episode.h", "summary_t"),
            (HERE / "episode.h", "row_t"),
            (HERE / "law.h", "sample_t"),
            (HERE / "law.h", "command_t"),
        ):
            known[record] = struct(header, record, known, sizes)
        self._known = known
        if law == FREE:
            self.Config: Any = ctypes.c_int
            self.Output: Any = ctypes.c_int
        else:
            header = robot / f"{name}_impedance.h"
            self.Config = struct(header, f"{name}_impedance_config", known, sizes)
            self.Output = struct(header, f"{name}_impedance_output", known, sizes)
        self.Segment, self.Episode, self.Summary = known["segment_t"], known["episode_t"], known["summary_t"]
        self.Row = known["row_t"]
        for record in ("config", "state", "output"):
            getattr(self.library, f"law_{record}_size").restype = ctypes.c_size_t
        assert self.library.law_config_size() == ctypes.sizeof(self.Config)
        assert self.library.law_output_size() == ctypes.sizeof(self.Output)
        self.lower, self.upper, self.velocity, self.effort = (
            np.array((ctypes.c_double * (max(self.motors) + 1)).in_dll(self.library, f"{name}_{array}"))[self.motors]
            for array in ("lower", "upper", "velocity", "effort")
        )
        self.state = ctypes.create_string_buffer(self.library.law_state_size())

    def pose(self, q: ArrayLike) -> np.ndarray:
        """Return the pose of the first tip (4, 4) at q."""
        return self._kernel("robot_poses", 16 * self.tips, q, None)[:16].reshape(4, 4)

    def jacobian(self, q: ArrayLike) -> np.ndarray:
        """Return the hybrid Jacobian (6, n) of the first tip at q."""
        return self._kernel("robot_jacobian", 6 * self.n, q).reshape(6, self.n)

    def mass_matrix(self, q: ArrayLike) -> np.ndarray:
        """Return the links' mass matrix (n, n) at q."""
        count = ctypes.c_int(1)
        return self._kernel("robot_mass_matrices", self.n**2, count, q).reshape(self.n, self.n)

    def bias(self, q: ArrayLike, v: ArrayLike) -> np.ndarray:
        """Return Coriolis and centrifugal forces (n) of the plant."""
        return self._kernel("plant_bias", self.n, q, v)

    def _kernel(self, name: str, size: int, *arguments: Any) -> np.ndarray:
        """Call a function of the plant on arrays, numbers and NULL (None); return its result."""
        result = np.empty(size)
        arrays = [x if x is None or isinstance(x, ctypes.c_int) else np.ascontiguousarray(x, dtype=float)
                  for x in (*arguments, result)]  # fmt: skip
        pointers = (x.ctypes.data_as(ctypes.c_void_p) if isinstance(x, np.ndarray) else x for x in arrays)
        getattr(self.library, name)(*pointers)
        return result

    def springs(self, wanted: ArrayLike, translation: ArrayLike, rotation: ArrayLike, joint: float) -> Springs:
        """Return the springs of a segment, for their statics."""
        wanted = np.asarray(wanted, dtype=float)
        gains = spring_gains(translation, rotation)
        equilibrium = self.pose(wanted)
        return Springs(self.pose, self.jacobian, equilibrium, wanted, gains["translation"], gains["rotation"], joint)

    def config(self, **values: Any) -> Any:
        """Return the default configuration with BASE, and some fields set."""
        if self.Config is ctypes.c_int:
            return self.Config()
        return self.default(**(BASE | values))

    def default(self, **values: Any) -> Any:
        """Return the default configuration with some fields set."""
        config = self.Config()
        self.library.law_default_config(ctypes.byref(config))
        return fill(config, **values)

    def episode(self, **values: Any) -> Any:
        """Return an episode: 1 ms, rotors of 0.1 kg m^2, exact sensors, no delay, rest at home; ``values`` override."""
        plant: dict[str, Any] = {
            "motor": 0.1,
            "substeps": 1,
            "clamp_force": 2e4,
            "clamp_moment": 500.0,
            "clamp_damping": 2e-3,
        }
        names = {name for name, _ in self.Episode._fields_[0][1]._fields_}
        plant |= {name: values.pop(name) for name in list(values) if name in names}
        limits = {"velocity_limit": self.velocity, "effort": self.effort, "rate": 10 * self.effort}
        first = {"sample_time": 1e-3, "q": self.home, **limits}
        episode = fill(self.Episode(), **(first | values))
        fill(episode.plant, **plant)
        return episode

    def segment(self, base: Any = None, **values: Any) -> Any:
        """Return the segment ``base`` with some fields changed and no reset; default: home, the paper's springs.

        Stiffness and wrench command of one tip are those of all tips and pairs.
        """
        new = self.Segment()
        if base is None:
            first = {
                "wanted": self.home,
                "translation": np.diag([700.0, 700, 800]),
                "rotation": np.diag([30.0, 30, 30]),
                "joint": 1.0,
            }
            values = first | values
        else:
            ctypes.memmove(ctypes.byref(new), ctypes.byref(base), ctypes.sizeof(new))
            new.reset = new.restart = 0
        for name in ("translation", "rotation", "wrench_command"):
            if np.size(values.get(name, 0.0)) > 1:
                values[name] = np.tile(np.ravel(values[name]), len(getattr(new, name)) // np.size(values[name]))
        return fill(new, **values)

    def segments(self, *parts: dict[str, Any]) -> list[Any]:
        """Return segments; each lists only its differences from the one before."""
        made: list[Any] = []
        for part in parts:
            made.append(self.segment(made[-1] if made else None, **part))
        return made

    def stepper(self, config: Any) -> Callable[..., Any]:
        """Run the law alone, for another plant: takes fields of sample_t, returns command_t."""
        assert self.library.law_init(ctypes.byref(config), self.state, None, None) == 0
        sample, command, output = self._known["sample_t"](), self._known["command_t"](), self.Output()

        def step(**values: Any) -> Any:
            sample.counter += 1
            fill(sample, valid=1, **values)
            pointers = (ctypes.byref(part) for part in (self.state, sample, output, command))
            self.library.law_step(*pointers)
            return command

        return step

    def run(
        self,
        samples: int,
        segments: list[Any] | Any,
        episode: Any = None,
        configs: Any = None,
        rows: bool = False,
        outputs: bool = False,
    ) -> Any:
        """Return the summary; with ``rows`` also an array with one row per sample, with ``outputs`` the outputs."""
        episode = episode if episode is not None else self.episode()
        configs = configs if isinstance(configs, list) else [configs if configs is not None else self.config()]
        if isinstance(segments, list):
            segments = (self.Segment * len(segments))(*segments)
        pointers = (ctypes.c_void_p * len(configs))(*(ctypes.addressof(config) for config in configs))
        summary = self.Summary()
        row = (self.Row * samples)() if rows else None
        output = (self.Output * (samples if outputs else 1))()
        ctypes.memset(self.state, 0, len(self.state))
        code = self.library.episode_run(
            ctypes.byref(episode), samples, len(segments), segments, pointers, self.state, output, int(outputs), row,
            ctypes.byref(summary),
        )  # fmt: skip
        assert code == 0, f"initialising returned {code}"
        result = [summary]
        if rows:
            result.append(np.ctypeslib.as_array(row))
        if outputs:
            result.append(np.ctypeslib.as_array(output))
        return result[0] if len(result) == 1 else tuple(result)


def spring_gains(translation: ArrayLike, rotation: ArrayLike) -> dict[str, np.ndarray]:
    """Segment fields of stiffness matrices, (3, 3) each or their diagonals."""
    return {
        name: np.diag(value) if np.ndim(value) == 1 else np.asarray(value)
        for name, value in (("translation", np.asarray(translation)), ("rotation", np.asarray(rotation)))
    }
