# SPDX-License-Identifier: MIT
"""Compile the library of NAME.jax, with the headers of XLA that jax installs."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from stiffgen.core.emit.build import FORWARDS, build_wrapper
from stiffgen.core.errors import BuildError


def build_jax(folder: Path, name: str) -> None:
    """Compile the library of NAME.jax alone, for a folder that was generated where jax was missing.

    Raises:
        BuildError: jax or a compiler is missing, or the compiler failed.

    """
    if not headers():
        raise BuildError("jax is not installed")
    build_wrapper(folder, name, "jax")


def compiler_options() -> list[str]:
    """Return the compiler's options for NAME_jax.c."""
    return [*FORWARDS, *(f"-I{include}" for include in headers())]


def headers() -> list[str]:
    """Return the folder of XLA's headers that jax installs; none without jax.

    The folder is jax.ffi.include_dir(), found without loading JAX: its threads would disturb a process that forks.
    """
    package = importlib.util.find_spec("jaxlib")
    if package is None or package.origin is None:
        return []
    headers = Path(package.origin).parent / "include"
    return [str(headers)] if (headers / "xla" / "ffi" / "api" / "c_api.h").exists() else []
