# SPDX-License-Identifier: MIT
"""stiffgen: symmetric joint-space stiffness of a robot arm, generated from its URDF."""

# Every public name is imported when it is first used: the generator's libraries take most of a second to load.

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

from stiffgen._version import __version__

if TYPE_CHECKING:
    from stiffgen.analyze.analysis import Analysis, analyze
    from stiffgen.analyze.sensors import SensorProperties, estimate_sensors
    from stiffgen.cache import load
    from stiffgen.calibrate.calibration import Calibration, read_calibration, tare
    from stiffgen.errors import (
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
    from stiffgen.generate import generate
    from stiffgen.loaded import BucklingLoad, Settled, buckling_load, settle
    from stiffgen.loading import load_chain
    from stiffgen.loads import ExternalWrench, StiffnessDeviation, external_wrench, stiffness_deviation, tip_covariance
    from stiffgen.opened import GeneratedRobot, open_robot
    from stiffgen.options import GenerationOptions
    from stiffgen.postures import find_postures
    from stiffgen.robot.chain import Chain, Sensor, Tool
    from stiffgen.series import in_series, tip_compliance_in_series
    from stiffgen.softness import compliance_determinant_gradient, compliance_gradient
    from stiffgen.symbolic.model import StiffnessModel
    from stiffgen.symbolic.moving import move_stiffness
    from stiffgen.symbolic.potentials import KernelOptions
    from stiffgen.symbolic.springs import Placement

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
    "KernelOptions",
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
    "Tool",
    "__version__",
    "analyze",
    "buckling_load",
    "compliance_determinant_gradient",
    "compliance_gradient",
    "estimate_sensors",
    "external_wrench",
    "find_postures",
    "generate",
    "in_series",
    "load",
    "load_chain",
    "move_stiffness",
    "open_robot",
    "read_calibration",
    "settle",
    "stiffness_deviation",
    "tare",
    "tip_compliance_in_series",
    "tip_covariance",
]

_HOMES = {
    "analyze.analysis": ("Analysis", "analyze"),
    "analyze.sensors": ("SensorProperties", "estimate_sensors"),
    "cache": ("load",),
    "calibrate.calibration": ("Calibration", "read_calibration", "tare"),
    "generate": ("generate",),
    "loaded": ("BucklingLoad", "Settled", "buckling_load", "settle"),
    "loading": ("load_chain",),
    "loads": ("ExternalWrench", "StiffnessDeviation", "external_wrench", "stiffness_deviation", "tip_covariance"),
    "opened": ("GeneratedRobot", "open_robot"),
    "options": ("GenerationOptions",),
    "postures": ("find_postures",),
    "robot.chain": ("Chain", "Sensor", "Tool"),
    "series": ("in_series", "tip_compliance_in_series"),
    "softness": ("compliance_determinant_gradient", "compliance_gradient"),
    "symbolic.model": ("StiffnessModel",),
    "symbolic.moving": ("move_stiffness",),
    "symbolic.potentials": ("KernelOptions",),
    "symbolic.springs": ("Placement",),
}
"""Module of each public name; all others are in ``errors``."""
_HOME = dict.fromkeys(__all__, "errors") | {name: home for home, names in _HOMES.items() for name in names}


class _Package(ModuleType):
    """The package, whose functions ``generate`` and ``analyze`` have the names of two of its modules."""

    def __getattr__(self, name: str) -> object:
        """Import a public name."""
        if name not in _HOME:
            raise AttributeError(f"module 'stiffgen' has no attribute '{name}'")
        value: object = getattr(import_module(f"stiffgen.{_HOME[name]}"), name)
        self.__dict__[name] = value
        return value

    def __setattr__(self, name: str, value: object) -> None:
        """Bind a name; a module that is imported does not take the place of the function of its name."""
        if not (name in _HOME and isinstance(value, ModuleType)):
            super().__setattr__(name, value)

    def __dir__(self) -> list[str]:
        """Return all public names, imported or not, and none of the modules that this file or others imported."""
        return [*__all__, "__doc__", "__file__", "__name__", "__path__"]


sys.modules[__name__].__class__ = _Package
