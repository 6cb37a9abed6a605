# SPDX-License-Identifier: MIT
"""Expansion of xacro templates to URDF, by the package xacrodoc in a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from stiffgen.errors import DescriptionError, MissingExtraError, printable
from stiffgen.robot.description import Input, Reading

_SCRIPT = Path(__file__).with_name("expansion.py")
_SECONDS = 300  # of the clock; expansion.py bounds the processor time
_MOST_WARNINGS = 5


@dataclass(frozen=True)
class Expansion:
    """URDF text of a template, the other files that went into it, and warnings of xacro."""

    text: bytes
    inputs: tuple[Input, ...] = ()
    warnings: tuple[str, ...] = ()


def expand(path: Path, reading: Reading) -> Expansion:
    """Expand a template.

    Raises:
        DescriptionError: the template is faulty, or an argument, a file or a package is missing.
        MissingExtraError: xacrodoc is not installed.

    """
    if find_spec("xacrodoc") is None:
        raise MissingExtraError(
            f"{printable(path.name)}: is a xacro template, and xacrodoc, which expands it, is not installed: "
            "pip install 'stiffgen[xacro]'"
        )
    file = str(path.resolve())
    for folder in reading.package_path:
        if not Path(folder).is_dir():
            raise DescriptionError(path.name, [f"--package-path {printable(str(folder), 200)}: is not a folder"])
    answer = _answer(path.name, file, reading.arguments, [str(each) for each in reading.package_path])
    if "missing" in answer:
        raise MissingExtraError(
            f"{printable(path.name)}: xacrodoc cannot be imported ({printable(answer['missing'], 200)}); "
            "install it again: pip install 'stiffgen[xacro]'"
        )
    if "error" in answer:
        raise DescriptionError(path.name, [printable(answer["error"], 600)])
    packages = {name: Path(folder) for name, folder in answer["packages"].items()}
    inputs = {_portable(Path(each), Path(file).parent, packages): digest for each, digest in answer["files"]}
    inputs.pop(Path(file).name, None)
    return Expansion(
        answer["text"].encode(),
        tuple(Input(each, digest) for each, digest in sorted(inputs.items())),
        tuple(f"xacro: {printable(each, 200)}" for each in answer["warnings"][:_MOST_WARNINGS]),
    )


def _answer(name: str, file: str, arguments: Mapping[str, str], package_path: list[str]) -> dict[str, Any]:
    """Run expansion.py and return its answer."""
    request = json.dumps({"file": file, "arguments": dict(arguments), "package_path": package_path})
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "PYTHONIOENCODING": "utf-8"}
    try:
        done = subprocess.run(
            [sys.executable, str(_SCRIPT)],
            input=request,
            capture_output=True,
            encoding="utf-8",
            env=environment,
            timeout=_SECONDS,
            check=False,
        )
        answer = json.loads(done.stdout)
    except (subprocess.TimeoutExpired, ValueError) as error:
        raise DescriptionError(
            name, ["does not expand within the time and memory of a template; correct what repeats in it"]
        ) from error
    assert isinstance(answer, dict)
    return answer


def _portable(path: Path, folder: Path, packages: Mapping[str, Path]) -> str:
    """Return a file's name without the machine's folders: in its package, or beside the template."""
    resolved = path.resolve()
    for name, root in packages.items():
        if resolved.is_relative_to(root) and not folder.is_relative_to(root):
            return f"package://{name}/{resolved.relative_to(root).as_posix()}"
    return Path(os.path.relpath(resolved, folder)).as_posix()
