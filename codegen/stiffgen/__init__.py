# SPDX-License-Identifier: MIT
"""stiffgen: symmetric joint-space stiffness of a robot arm, generated from its URDF."""

from stiffgen._version import __version__
from stiffgen.analyze.analysis import Analysis, analyze
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
from stiffgen.loading import load_chain
from stiffgen.opened import GeneratedRobot, open_robot
from stiffgen.options import GenerationOptions
from stiffgen.robot.chain import Chain, Tool
from stiffgen.symbolic.model import StiffnessModel
from stiffgen.symbolic.moving import move_stiffness
from stiffgen.symbolic.potentials import SpringOptions
from stiffgen.symbolic.springs import Placement

__all__ = [
    "Analysis",
    "BuildError",
    "Chain",
    "ChainError",
    "DescriptionError",
    "DescriptionWarning",
    "EmptyRecordingError",
    "GeneratedRobot",
    "GenerationOptions",
    "MissingExtraError",
    "OutputError",
    "Placement",
    "PotentialError",
    "RecordingError",
    "SpringOptions",
    "StiffgenError",
    "StiffnessModel",
    "Tool",
    "__version__",
    "analyze",
    "generate",
    "load_chain",
    "move_stiffness",
    "open_robot",
]
