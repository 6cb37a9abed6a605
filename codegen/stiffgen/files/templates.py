# SPDX-License-Identifier: MIT
"""Expansion of xacro templates to URDF, by the package xacrodoc in a process of its own."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from stiffgen.core.errors import DescriptionError, printable, shell_word
from stiffgen.core.robot.description import Expansion, Input, Reading
from stiffgen.core.robot.files import exists, is_folder
from stiffgen.files.confined import answer_of

_MOST_WARNINGS = 5


def expand(path: Path, reading: Reading) -> Expansion:
    """Expand a template.

    Raises:
        DescriptionError: the template is faulty, or an argument, a file or a package is missing.
        MissingExtraError: xacrodoc is not installed.

    """
    file = str(path.resolve())
    folders = [str(each) for each in reading.package_path]
    request = {"file": file, "arguments": dict(reading.arguments or {}), "package_path": folders}
    answer = answer_of("expansion.py", path.name, request, "xacrodoc", "xacro", "a xacro template")
    if "error" in answer:
        raise DescriptionError(path.name, [printable(answer["error"], 2000)])
    packages = {name: Path(folder) for name, folder in answer["packages"].items()}
    return Expansion(
        answer["text"].encode(),
        portable_inputs(file, answer["files"], packages),
        tuple(f"xacro: {printable(each, 200)}" for each in answer["warnings"][:_MOST_WARNINGS]),
        tuple((name, default) for name, default in answer["parameters"]),
    )


def check_package_path(path: Path, reading: Reading) -> None:
    """Refuse folders of packages that do not exist, also where the file needs none: a command may be mistyped.

    Raises:
        DescriptionError: a folder does not exist, is a file, or its name is empty.

    """
    for folder in reading.package_path:
        if not str(folder):  # Path("") is the working folder, for instance of a variable that a script has not set
            raise DescriptionError(path.name, ["--package-path is empty; name a folder (the working folder: .)"])
        if not is_folder(folder):
            fault = "is not a folder" if exists(folder) else "does not exist"
            raise DescriptionError(path.name, [f"--package-path {shell_word(str(folder))}: {fault}"])


def portable_inputs(
    file: str, digests: Iterable[tuple[str, str]], packages: Mapping[str, Path] | None = None
) -> tuple[Input, ...]:
    """Return the files that a file includes, from their paths and digests, without the machine's folders."""
    names = {_portable(Path(each), Path(file).parent, packages or {}): digest for each, digest in digests}
    names.pop(Path(file).name, None)
    return tuple(Input(name, digest) for name, digest in sorted(names.items()))


def _portable(path: Path, folder: Path, packages: Mapping[str, Path]) -> str:
    """Return a file's name without the machine's folders: in its package, or beside the template."""
    resolved = path.resolve()
    for name, root in packages.items():
        if resolved.is_relative_to(root) and not folder.is_relative_to(root):
            return f"package://{name}/{resolved.relative_to(root).as_posix()}"
    return Path(os.path.relpath(resolved, folder)).as_posix()
