# SPDX-License-Identifier: MIT
"""Robots by name: the descriptions that the package robot_descriptions knows, and copies of MuJoCo Menagerie.

robot_descriptions clones a description's repository into its cache (ROBOT_DESCRIPTIONS_CACHE) on first use. A copy of
Menagerie is a folder with one folder per robot, which the variable MUJOCO_MENAGERIE_PATH names. The package
mujoco_menagerie lists all its robots, and downloads one on first use.
"""

from __future__ import annotations

import contextlib
import difflib
import importlib
import io
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from stiffgen.core.errors import DescriptionError, MissingExtraError, listed, printable
from stiffgen.core.robot.description import Reading
from stiffgen.core.robot.files import exists

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_+-]*")
_BODY = re.compile(rb"<mujoco[\s>](?s:.*)<body[\s>]")
"""Model with a body of its own; a list of keyframes, assets or contacts has none."""
_COMMENT = re.compile(rb"<!--(?s:.*?)-->")
_MENAGERIE, _COPY = "mujoco_menagerie", "copy of Menagerie"
_INSTALL = "install one of them: pip install robot_descriptions"
_LISTED = "'stiffgen inspect --list known'"


@dataclass(frozen=True)
class KnownRobot:
    """Robot that can be named: name, formats, maker, licence (SPDX), and the package that has it."""

    name: str
    formats: str
    maker: str
    licence: str
    package: str


def is_name(source: str | Path) -> bool:
    """Return whether a source is a robot's name: no file of that name exists, and it holds no dot or slash."""
    return isinstance(source, str) and _NAME.fullmatch(source) is not None and not exists(source)


def known_robots(word: str = "") -> list[KnownRobot]:
    """Return the robots whose name or maker contains a word, sorted by name.

    Raises:
        MissingExtraError: no package with descriptions is installed.

    """
    if find_spec("robot_descriptions") is None and _copy_of_menagerie() is None and _menagerie() is None:
        raise MissingExtraError(
            f"neither robot_descriptions nor mujoco_menagerie, which hold descriptions, is installed; {_INSTALL}"
        )
    robots = [*_described(), *_in_menagerie()]
    found = [each for each in robots if word.lower() in f"{each.name} {each.maker}".lower()]
    return sorted(found, key=lambda each: (each.name, each.package))


def find_robot(name: str, reading: Reading) -> tuple[Path, Reading]:
    """Return the file of a named robot, and the settings with its packages and arguments.

    A copy of Menagerie on this machine comes before what a package would download.

    Raises:
        DescriptionError: there is no such robot, or its description cannot be downloaded.
        MissingExtraError: no package with descriptions is installed.

    """
    try:
        robots = {(each.package, each.name) for each in known_robots()}
    except MissingExtraError as error:
        raise MissingExtraError(f"{printable(name)}: is no file; if it is a robot's name: {error}") from error
    copy = _copy_of_menagerie()
    if copy is not None and (_COPY, name) in robots:
        return _menagerie_file(copy / name), reading
    for candidate in (name, f"{name}_description", f"{name}_mj_description"):
        if ("robot_descriptions", candidate) in robots:
            return _downloaded(candidate, reading)
    if (_MENAGERIE, name) in robots:
        return _from_menagerie(name), reading
    names = sorted({_short(each) for _, each in robots})
    near = difflib.get_close_matches(name, names, 5, 0.5) + [each for each in names if name in each]
    hint = f"did you mean {listed(list(dict.fromkeys(near)), 5)}? " if near else ""
    raise DescriptionError(name, [f"is no file and no known robot; {hint}{_LISTED} lists all names"])


def _short(name: str) -> str:
    return name.removesuffix("_description")


def _described() -> Iterator[KnownRobot]:
    """Yield the robots of robot_descriptions; none if it is not installed."""
    if find_spec("robot_descriptions") is None:
        return
    descriptions = importlib.import_module("robot_descriptions._descriptions").DESCRIPTIONS
    for name, each in descriptions.items():
        formats = ", ".join(sorted(str(kind.name) for kind in each.formats if kind.name in ("URDF", "MJCF")))
        if formats:
            licence = each.license_spdx or "not stated"
            yield KnownRobot(name, formats, each.maker or "", licence, "robot_descriptions")


def _downloaded(name: str, reading: Reading) -> tuple[Path, Reading]:
    """Return file and settings of a description; the import of its module downloads what is missing."""
    noise = io.StringIO()
    try:
        with contextlib.redirect_stdout(noise):
            module = importlib.import_module(f"robot_descriptions.{name}")
    except ImportError as error:
        raise MissingExtraError(
            f"robot_descriptions cannot be imported ({printable(str(error), 200)}); install it again with what it "
            "needs: pip install robot_descriptions"
        ) from error
    except Exception as error:  # of git, of the network, of the disk
        reason = printable(" ".join(str(error).split()) or type(error).__name__, 200)
        raise DescriptionError(
            name,
            [
                f"its description cannot be downloaded ({reason}); connect to the network, or set "
                "ROBOT_DESCRIPTIONS_CACHE to a folder that holds it"
            ],
        ) from error
    for attribute in ("URDF_PATH", "XACRO_PATH", "MJCF_PATH"):
        if hasattr(module, attribute):
            path = Path(getattr(module, attribute))
            return path, _with_defaults(module, reading) if attribute == "XACRO_PATH" else reading
    raise DescriptionError(name, [f"has neither URDF, xacro nor MJCF; choose another name: {_LISTED}"])


def _with_defaults(module: Any, reading: Reading) -> Reading:
    """Return settings with the package's own arguments and packages; the user's arguments come first."""
    arguments = dict(getattr(module, "XACRO_ARGS", {})) | dict(reading.arguments or {})
    packages = [*reading.package_path, *getattr(module, "XACRO_PACKAGE_PATHS", {}).values()]
    return replace(reading, arguments=arguments, package_path=(*packages, Path(module.REPOSITORY_PATH)))


def _copy_of_menagerie() -> Path | None:
    """Return the folder of a copy of MuJoCo Menagerie."""
    spec = find_spec(_MENAGERIE)
    places = [os.environ.get("MUJOCO_MENAGERIE_PATH"), *((spec and spec.submodule_search_locations) or [])]
    return next((Path(place) for place in places if place and Path(place).is_dir() and _folders(Path(place))), None)


def _folders(copy: Path) -> list[Path]:
    return [each for each in sorted(copy.iterdir()) if each.is_dir() and list(each.glob("*.xml"))]


def _menagerie() -> Any:
    """Return the package mujoco_menagerie with its list of robots; None if it is not installed, or has none."""
    if find_spec(_MENAGERIE) is None:
        return None
    module = importlib.import_module(_MENAGERIE)
    return module if hasattr(module, "robots") and hasattr(module, "get") else None


def _in_menagerie() -> Iterator[KnownRobot]:
    """Yield the robots of a copy of Menagerie, and those that the package downloads."""
    copy, module = _copy_of_menagerie(), _menagerie()
    folders = _folders(copy) if copy is not None else []
    for each in folders:
        lines = (each / "LICENSE").read_text("utf-8", "replace").split("\n") if (each / "LICENSE").is_file() else []
        first = next((line.strip() for line in lines if line.strip()), "not stated")
        yield KnownRobot(each.name, "MJCF", "", printable(first, 30), _COPY)
    for robot in module.robots() if module is not None else ():
        if str(robot.name) not in [each.name for each in folders]:
            yield KnownRobot(str(robot.name), "MJCF", "", printable(str(robot.license), 30), _MENAGERIE)


def _from_menagerie(name: str) -> Path:
    """Return the default model of a robot that the package mujoco_menagerie downloads."""
    robot = _menagerie().get(name)
    try:
        return Path(robot.path()) / str(robot.entry(robot.default_model).file)
    except Exception as error:  # of the network, of the disk
        reason = printable(" ".join(str(error).split()) or type(error).__name__, 200)
        raise DescriptionError(
            name,
            [
                f"its model cannot be downloaded ({reason}); connect to the network, or set MUJOCO_MENAGERIE_PATH to a "
                "copy of MuJoCo Menagerie"
            ],
        ) from error


def _menagerie_file(folder: Path) -> Path:
    """Return a robot's own file in a folder of Menagerie.

    It is the default model of the package's list if there is one. Else it is named as the folder's last word, or it is
    the first file with a body, beside scenes and variants for MJX.
    """
    module = _menagerie()
    for robot in module.robots() if module is not None else ():
        default = folder / str(robot.entry(robot.default_model).file)
        if robot.name == folder.name and default.is_file():
            return default
    files = sorted(folder.glob("*.xml"))
    bodies = [each for each in files if _BODY.search(_COMMENT.sub(b"", each.read_bytes()))] or files
    robots = [each for each in bodies if "scene" not in each.name] or bodies
    return min(
        robots,
        key=lambda each: ("mjx" in each.stem, not folder.name.endswith(each.stem), len(each.name), each.name),
    )
