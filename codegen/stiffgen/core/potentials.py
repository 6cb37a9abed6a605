# SPDX-License-Identifier: MIT
"""Sources of user-defined potentials: a Python file, or the record in a folder's manifest."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stiffgen.core.errors import PotentialError, listed
from stiffgen.core.robot.files import FileError, read_regular
from stiffgen.core.symbolic.choices import Potential

_MAX_SOURCE = 4 * 2**20  # [bytes]


def read_potential(text: str) -> Potential:
    """Run a file and return the function that FILE.py:FUNCTION names.

    Raises:
        PotentialError: no such file or function, or the file fails.

    """
    path, separator, function = text.rpartition(":")
    if not separator or not path or not function:
        raise PotentialError(f"--potential {text}: is not FILE.py:FUNCTION")
    try:
        source = read_regular(path, _MAX_SOURCE).decode("utf-8")
    except FileError as error:
        raise PotentialError(f"--potential {text}: {error}; name a Python file") from error
    except (OSError, UnicodeDecodeError) as error:
        raise PotentialError(f"--potential {path}: cannot be read ({getattr(error, 'strerror', error)})") from error
    return potential_of_source(source, Path(path).name, function)


def potential_of_source(source: str, file: str, function: str) -> Potential:
    """Run a source text and return one of its functions.

    Raises:
        PotentialError: the text fails, or has no such function.

    """
    names: dict[str, Any] = {"__name__": Path(file).stem, "__file__": file}
    try:
        exec(compile(source, file, "exec"), names)
    except Exception as error:
        raise PotentialError(f"potential {file}: fails when it is run ({type(error).__name__}: {error})") from error
    if not callable(names.get(function)):
        found = [name for name, value in names.items() if inspect.isfunction(value)]
        raise PotentialError(f"potential {file}: has no function '{function}' (it has {listed(found) or 'none'})")
    return Potential(names[function], file, source)


def sealed_potential(record: Mapping[str, Any]) -> Potential:
    """Return a potential of a manifest without running its source: name and parameters alone."""
    name = str(record["function"])

    def refuse(*_: Any) -> Any:
        raise PotentialError(
            f"potential {name}: its source in manifest.json is not run; read it, then pass --trust-potentials, or "
            "trust_potentials=True in Python"
        )

    refuse.__name__ = name
    vars(refuse)["parameters"] = {str(key): tuple(map(int, shape)) for key, shape in record["parameters"]}
    return Potential(refuse, record["file"], record["source"], is_sealed=True)
