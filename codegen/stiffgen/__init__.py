# SPDX-License-Identifier: MIT
"""stiffgen: symmetric joint-space stiffness of a robot arm, generated from its URDF."""

# Every public name is imported when it is first used: the generator's libraries take most of a second to load.

from importlib import import_module
from importlib.machinery import ModuleSpec
from sys import meta_path
from typing import TYPE_CHECKING

from stiffgen._version import __version__

if TYPE_CHECKING:
    from stiffgen.core.errors import (
        BuildError,
        ChainError,
        DescriptionError,
        DescriptionWarning,
        EmptyRecordingError,
        MissingExtraError,
        OutputError,
        PotentialError,
        RecordingError,
        StiffgenError,
    )
    from stiffgen.core.generate import generate
    from stiffgen.core.loading import load_chain
    from stiffgen.core.opened import GeneratedRobot, open_robot
    from stiffgen.core.options import GenerationOptions
    from stiffgen.core.robot.chain import Chain, Sensor, Tool
    from stiffgen.core.symbolic.choices import KernelOptions
    from stiffgen.core.symbolic.measured import MeasuredStiffness, StiffnessResidual, measured_stiffness
    from stiffgen.core.symbolic.model import StiffnessModel
    from stiffgen.core.symbolic.placement import Placement
    from stiffgen.families.jax.build import build_jax
    from stiffgen.files.cache import load
    from stiffgen.lab import drive  # noqa: F401
    from stiffgen.lab.analyze.analysis import Analysis, analyze
    from stiffgen.lab.analyze.sensors import SensorProperties, estimate_sensors
    from stiffgen.lab.arms.hands import HeldWrench, internal_wrench, relative_compliance
    from stiffgen.lab.arms.loaded import BucklingLoad, Settled, buckling_load, settle
    from stiffgen.lab.arms.loads import (
        ExternalWrench,
        StiffnessDeviation,
        external_wrench,
        stiffness_deviation,
        tip_covariance,
    )
    from stiffgen.lab.arms.moving import move_stiffness
    from stiffgen.lab.arms.postures import find_postures
    from stiffgen.lab.arms.series import in_series, tip_compliance_in_series
    from stiffgen.lab.arms.softness import compliance_determinant_gradient, compliance_gradient
    from stiffgen.lab.calibrate.calibration import Calibration, read_calibration, tare
    from stiffgen.lab.laws import law_preset
    from stiffgen.lab.measure.friction import JointFriction, estimate_friction

__all__ = [
    "Analysis",
    "BucklingLoad",
    "BuildError",
    "Calibration",
    "Chain",
    "ChainError",
    "DescriptionError",
    "DescriptionWarning",
    "EmptyRecordingError",
    "ExternalWrench",
    "GeneratedRobot",
    "GenerationOptions",
    "HeldWrench",
    "JointFriction",
    "KernelOptions",
    "MeasuredStiffness",
    "MissingExtraError",
    "OutputError",
    "Placement",
    "PotentialError",
    "RecordingError",
    "Sensor",
    "SensorProperties",
    "Settled",
    "StiffgenError",
    "StiffnessDeviation",
    "StiffnessModel",
    "StiffnessResidual",
    "Tool",
    "__version__",
    "analyze",
    "buckling_load",
    "build_jax",
    "compliance_determinant_gradient",
    "compliance_gradient",
    "estimate_friction",
    "estimate_sensors",
    "external_wrench",
    "find_postures",
    "generate",
    "in_series",
    "internal_wrench",
    "law_preset",
    "load",
    "load_chain",
    "measured_stiffness",
    "move_stiffness",
    "open_robot",
    "read_calibration",
    "relative_compliance",
    "settle",
    "stiffness_deviation",
    "tare",
    "tip_compliance_in_series",
    "tip_covariance",
]

_HOMES = {
    "lab.analyze.analysis": ("Analysis", "analyze"),
    "lab.measure.friction": ("JointFriction", "estimate_friction"),
    "lab.analyze.sensors": ("SensorProperties", "estimate_sensors"),
    "files.cache": ("load",),
    "lab.laws": ("law_preset",),
    "lab.calibrate.calibration": ("Calibration", "read_calibration", "tare"),
    "families.jax.build": ("build_jax",),
    "core.generate": ("generate",),
    "lab.arms.loaded": ("BucklingLoad", "Settled", "buckling_load", "settle"),
    "core.loading": ("load_chain",),
    "lab.arms.loads": (
        "ExternalWrench",
        "StiffnessDeviation",
        "external_wrench",
        "stiffness_deviation",
        "tip_covariance",
    ),
    "core.opened": ("GeneratedRobot", "open_robot"),
    "core.options": ("GenerationOptions",),
    "lab.arms.postures": ("find_postures",),
    "core.robot.chain": ("Chain", "Sensor", "Tool"),
    "lab.arms.hands": ("HeldWrench", "internal_wrench", "relative_compliance"),
    "lab.arms.series": ("in_series", "tip_compliance_in_series"),
    "lab.arms.softness": ("compliance_determinant_gradient", "compliance_gradient"),
    "core.symbolic.measured": ("MeasuredStiffness", "StiffnessResidual", "measured_stiffness"),
    "core.symbolic.model": ("StiffnessModel",),
    "lab.arms.moving": ("move_stiffness",),
    "core.symbolic.choices": ("KernelOptions", "Placement"),
}
"""Module of each public name; all others are in ``core.errors``."""
_HOME = dict.fromkeys(__all__, "core.errors") | {name: home for home, names in _HOMES.items() for name in names}
_MODULES = {"drive": "lab.drive", "errors": "errors", "style": "style"}
"""Public modules."""


def __getattr__(name: str) -> object:
    """Import a public name."""
    if name not in _HOME and name not in _MODULES:
        raise AttributeError(f"module 'stiffgen' has no attribute '{name}'")
    module = import_module(f"stiffgen.{_HOME.get(name) or _MODULES[name]}")
    value: object = module if name in _MODULES else getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return all public names, imported or not, and none of the modules that this file or others imported."""
    return [*__all__, "__doc__", "__file__", "__name__", "__path__"]


class _RobotFinder:
    """Finder of robots' modules, which pickles name: the cache's by their digests, others by their folders' paths."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """Return the specification of a robot's module; None for another module."""
        if not name.startswith("stiffgen._robot_") or name.count(".") > 1:
            return None
        home = "core.opened" if name.startswith("stiffgen._robot_in_") else "files.cache"
        spec: ModuleSpec = import_module(f"stiffgen.{home}").spec_of(name)
        return spec


meta_path.append(_RobotFinder())
