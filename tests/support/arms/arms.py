# SPDX-License-Identifier: MIT
"""Arms of four makers with their sensors, friction and motors, in a loop with this controller or a textbook's law."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import stiffgen
from support.plant.loop import fill, struct
from support.project import ROOT

HERE = Path(__file__).resolve().parent
FLAGS = ("-std=gnu99", "-O1", "-march=native", "-shared", "-fPIC")
_CHOSEN: dict[str, Any] = {"kernels": "hybrid.joint_stiffness,spring,mass_matrix,gravity", "batches": False}
"""What plants and tests call beside the controller's functions: all of them compile four times as long."""
GOOD, LOST, SKIPPED, Q_FROZEN, DQ_FROZEN, DQ_ZERO, DQ_REVERSED, NOT_A_NUMBER, COUNTER_FROZEN, BOTH_FROZEN = range(10)


@dataclass(frozen=True)
class Sensors:
    """Sensors of a maker: resolutions of q [rad] and dq [rad/s], noise of dq [rad/s]; or dq by differences of q."""

    position_quantum: float
    velocity_quantum: float = 0.0
    velocity_noise: float = 0.0
    differences: bool = False


@dataclass(frozen=True)
class Maker:
    """Arm: URDF, tip, a posture far from limits and singular poses [rad], sensors, rotors, friction.

    ``motor`` [kg m^2] and ``friction`` (share of the effort limits) are typical of the gears: strain wave gears behind
    torque sensors for iiwa and Panda, without for UR5 and Kinova. ``springs`` [N m/rad]: joints with torque sensors.
    """

    urdf: Path
    tip: str | None
    posture: tuple[float, ...]
    sensors: Sensors
    motor: float
    friction: float
    springs: float
    config: Mapping[str, Any] = field(default_factory=dict)


_DATA = ROOT / "tests" / "data"
MAKERS = {
    "iiwa14": Maker(ROOT / "urdf" / "iiwa14.urdf", None, (0.3, 0.6, -0.4, -1.3, 0.2, 0.9, -0.5),
                    Sensors(1e-6, differences=True), 0.1, 0.003, 1e4),
    "panda": Maker(_DATA / "panda.urdf", "panda_hand_tcp", (0.0, -0.5, 0.0, -2.1, 0.0, 1.7, 0.8),
                   Sensors(1e-6, velocity_noise=2e-3), 0.1, 0.005, 1.2e4),
    "ur5": Maker(_DATA / "ur5.urdf", "tool0", (0.3, -1.4, 1.6, -1.4, -1.4, 0.3),
                 Sensors(1e-5, 1e-4, 5e-3), 0.2, 0.03, 1.5e4),
    "j2s6s200": Maker(_DATA / "j2s6s200.urdf", "j2s6s200_end_effector", (0.3, 2.9, 1.6, 0.5, 2.0, 0.3),
                      Sensors(1e-4, 0.0, 0.02), 0.5, 0.05, 6e3),
}  # fmt: skip
"""The four arms. Quanta and noise are those of issue reports on each maker's interface, not of a data sheet."""


class Inputs(ctypes.Structure):
    """The struct inputs_t."""

    NAMES = (
        "goal", "pose", "translation", "rotation", "load", "payload", "noise", "offset", "wall", "press",
        "wrench_noise", "sensor",
    )  # fmt: skip
    _fields_ = [(name, ctypes.c_void_p) for name in NAMES]


class Arm:
    """One maker's arm with a controller, compiled.

    Args:
        name: of the arm, in MAKERS.
        folder: where the robot is generated and compiled; what another process left there is used again.
        maker: of an arm that is not in MAKERS.
        flags: of gcc.

    """

    def __init__(self, name: str, folder: Path, maker: Maker | None = None, flags: tuple[str, ...] = FLAGS) -> None:
        """Generate the arm of a maker, compile it with plant and laws, and read the ctypes records of its headers."""
        self.name, self.maker = name, maker or MAKERS[name]
        made = folder / name
        if not (made / f"{name}.h").exists():
            stiffgen.generate(self.maker.urdf, tip=self.maker.tip, name=name, output=folder, **_CHOSEN)
        self.module: ModuleType = stiffgen.open_robot(made).module
        self.n = n = int(self.module.DOF)
        path = folder / f"{name}_arm.so"
        if not path.exists():
            names = (f"-DROBOT={name}", f"-DUPPER={name.upper()}", f"-DJOINTS={n}")
            parts = ("", "_impedance", "_follow", "_settle", "_press")
            headers = [word for part in parts for word in ("-include", f"{name}{part}.h")]
            sources = [HERE / f"{part}.c" for part in ("arms", "laws", "makers")]
            sources += [made / f"{name}{part}.c" for part in parts]
            subprocess.run(["gcc", *flags, *names, f"-I{made}", f"-I{HERE}", *headers, *map(str, sources),
                            "-lm", "-o", str(path)], check=True)  # fmt: skip
        self.library = ctypes.CDLL(str(path))
        known: dict[str, Any] = {}
        self.Plant = struct(HERE / "arms.h", "plant_t", known, {"N": n})
        self.Row = struct(HERE / "arms.h", "row_t", known, {"N": n})
        header = made / f"{name}_impedance.h"
        self.Config = struct(header, f"{name}_impedance_config", known, {})
        self.Output = struct(header, f"{name}_impedance_output", known, {})
        self.posture = np.array(self.maker.posture)
        self.velocity, self.effort = np.array(self.module.VELOCITY), np.array(self.module.EFFORT)
        self.state = ctypes.create_string_buffer(1 << 16)

    def config(self, **values: Any) -> Any:
        """Return the configuration: defaults, what the maker's arm needs, ``values``."""
        config = self.Config()
        self.library.defaults(ctypes.byref(config))
        first = {"motor_inertia": self.maker.motor, "delay_samples": 1}
        return fill(config, **(first | dict(self.maker.config) | values))

    def plant(self, flexible: bool = False, **values: Any) -> Any:
        """Return the plant: friction, sensors and motors of the maker, a sample of delay."""
        maker, sensors = self.maker, self.maker.sensors
        first = {
            "motor": maker.motor, "coulomb": maker.friction * self.effort, "viscous": 0.01 * self.effort,
            "joint_spring": maker.springs * self.effort / self.effort.max() if flexible else 0.0,
            "wall_normal": [0.0, 0.0, 1.0], "wall_damping": 100.0, "stop_stiffness": 2e3, "sample_time": 1e-3,
            "position_quantum": sensors.position_quantum, "velocity_quantum": sensors.velocity_quantum,
            "differences": int(sensors.differences), "delay": 1, "state_period": 1, "clamp_start": -1,
            "effort": self.effort, "rate": 10 * self.effort, "unit": 1.0,
            "wrench_gain": 1.0,
        }  # fmt: skip
        return fill(self.Plant(), **(first | values))

    def run(self, plant: Any, samples: int, config: Any = None, start: ArrayLike | None = None, seed: int = 0,
            **rows: Any) -> np.ndarray:  # fmt: skip
        """Return the rows of an episode; inputs are constant or have a row per sample.

        ``pose`` goes to this controller through the robot's Follow, with ``goal`` as the posture.
        """
        random = np.random.default_rng(seed)
        noise = self.maker.sensors.velocity_noise * random.normal(size=(samples, self.n))
        q = np.array(self.posture if start is None else start, dtype=float)
        goal = np.broadcast_to(np.asarray(rows.get("goal", q), dtype=float), (samples, self.n))
        pose = rows.get("pose")
        if pose is None:
            pose = self.module.forward_kinematics(np.ascontiguousarray(goal))
        elif plant.law == 0 and not plant.makers:
            poses = np.broadcast_to(np.asarray(pose, dtype=float).reshape(-1, 4, 4), (samples, 4, 4))
            goal = self.module.Follow(q, sample_time=plant.sample_time).run(pose=poses, posture=goal).q0
            plant.shaped = 1
        plant.shaped |= plant.makers
        sizes = {"goal": self.n, "pose": 16, "translation": 3, "rotation": 3, "load": 6, "payload": 1,
                 "noise": self.n, "offset": self.n, "wall": 1, "press": 5, "wrench_noise": 6}  # fmt: skip
        values = {"translation": 600.0, "rotation": 30.0, "load": 0.0, "payload": 0.0, "noise": noise, "offset": 0.0,
                  "wall": 0.0, "press": (0.0, 0.0, 1.0, 0.0, 0.0), "wrench_noise": 0.0}  # fmt: skip
        values |= rows | {"goal": goal, "pose": pose}
        arrays: dict[str, np.ndarray] = {}
        for name, size in sizes.items():
            value = np.asarray(values[name], dtype=float)
            if name == "pose":
                value = value.reshape(-1, 16)
            if size == 1 and value.ndim == 1:
                value = value[:, None]
            arrays[name] = np.ascontiguousarray(np.broadcast_to(value, (samples, size)))
        arrays["sensor"] = np.ascontiguousarray(np.broadcast_to(rows.get("sensor", 0), samples), dtype=np.uint8)
        inputs = Inputs(**{name: array.ctypes.data for name, array in arrays.items()})
        result = (self.Row * samples)()
        output = self.Output()
        config = config if config is not None else self.config()
        start_q = np.ascontiguousarray(q)
        code = self.library.run(
            ctypes.byref(plant), ctypes.byref(config), self.state, ctypes.byref(output),
            start_q.ctypes.data_as(ctypes.c_void_p), samples, ctypes.byref(inputs), result,
        )  # fmt: skip
        assert code == 0, f"{self.name}: initialising returned {code}"
        self.output = output
        return np.ctypeslib.as_array(result)
