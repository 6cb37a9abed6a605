"""Wrapper for CasADi: the compiled functions of this package as ``casadi.Function``, for Opti and solvers.

Names, shapes and the order of arguments are those of ``stiffgen.StiffnessModel``. Functions have first derivatives
only, gradients none: a solver must approximate second derivatives (IPOPT: ``hessian_approximation="limited-memory"``).
"""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

import casadi

from . import _c
from ._functions import NAME, Function, namespaces

_LIBRARY = Path(__file__).parent / f"{NAME}_casadi{'.pyd' if os.name == 'nt' else '.so'}"
if not _LIBRARY.exists():
    raise ImportError(f"{NAME}.casadi: its library is not compiled; run 'stiffgen generate --derivatives' again")
if ctypes.c_char_p.in_dll(ctypes.CDLL(str(_LIBRARY)), f"{NAME}_casadi_sources").value != _c.SOURCES.encode():
    raise ImportError(f"{NAME}.casadi: its library was compiled from other sources; run 'stiffgen generate' again")
_importer = casadi.Importer(str(_LIBRARY), "dll")


def _external(function: Function) -> casadi.Function:
    return casadi.external(f"{NAME}_casadi_{function.name}", _importer)


globals().update(namespaces(_external))
