"""stiffgen: symmetric joint-space stiffness of a robot arm, generated from its URDF."""

from stiffgen._version import __version__
from stiffgen.chain import Chain, Tool, load_chain
from stiffgen.errors import BuildError, ChainError, DescriptionError, OutputError, StiffgenError
from stiffgen.generate import generate
from stiffgen.model import StiffnessModel

__all__ = [
    "BuildError",
    "Chain",
    "ChainError",
    "DescriptionError",
    "OutputError",
    "StiffgenError",
    "StiffnessModel",
    "Tool",
    "__version__",
    "generate",
    "load_chain",
]
