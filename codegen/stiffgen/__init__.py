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
    RecordingError,
    StiffgenError,
)
from stiffgen.generate import generate
from stiffgen.robot.chain import Chain, Tool, load_chain
from stiffgen.symbolic.model import StiffnessModel

__all__ = [
    "Analysis",
    "BuildError",
    "Chain",
    "ChainError",
    "DescriptionError",
    "DescriptionWarning",
    "EmptyRecordingError",
    "MissingExtraError",
    "OutputError",
    "RecordingError",
    "StiffgenError",
    "StiffnessModel",
    "Tool",
    "__version__",
    "analyze",
    "generate",
    "load_chain",
]
