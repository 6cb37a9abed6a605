# SPDX-License-Identifier: MIT
"""The registry of backends: a new one is a folder and a line here. The controller's may have been taken out."""

from __future__ import annotations

from stiffgen.emit.c.backend import C
from stiffgen.emit.casadi.backend import CASADI
from stiffgen.emit.cpp.backend import CPP
from stiffgen.emit.cuda.backend import CUDA
from stiffgen.emit.jax.backend import JAX
from stiffgen.emit.package.backend import PACKAGE
from stiffgen.emit.python.backend import PYTHON
from stiffgen.emit.torch.backend import TORCH
from stiffgen.rooms import optional

_CONTROLLER = optional("controller.backend")

BACKENDS = (
    C,
    CPP,
    PYTHON,
    PACKAGE,
    CUDA,
    CASADI,
    JAX,
    TORCH,
    *((_CONTROLLER.CONTROLLER,) if _CONTROLLER else ()),
)
"""Backends in the order in which their files stand in the manifest."""
