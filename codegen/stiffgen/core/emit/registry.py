# SPDX-License-Identifier: MIT
"""The registry of backends: a new one is a folder and a line here. The controller's may have been taken out."""

from __future__ import annotations

from stiffgen.core.emit.c.backend import C
from stiffgen.core.emit.casadi.backend import CASADI
from stiffgen.core.emit.cpp.backend import CPP
from stiffgen.core.emit.package.backend import PACKAGE
from stiffgen.core.emit.python.backend import PYTHON
from stiffgen.families.cuda.backend import CUDA
from stiffgen.families.jax.backend import JAX
from stiffgen.families.torch.backend import TORCH
from stiffgen.rooms import optional

_CONTROLLER = optional("control.backend")

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
