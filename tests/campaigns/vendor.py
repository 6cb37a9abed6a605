# SPDX-License-Identifier: MIT
"""Compare robots of makers' repositories with Pinocchio and MuJoCo, without an option that the folder answers itself.

    python tests/campaigns/vendor.py FOLDER [WORD ...] [--tips 6] [--entries 66]

FOLDER holds repositories as their makers lay them out, and robots.json: a list of records with file, arguments (args)
packages and format. Nothing of it is committed. Packages of the file's own repository are found without
--package-path; only another maker's repository is given by the option. WORDs choose entries whose file contains one.

xacrodoc with xacro's own evaluator expands a template for the oracle, Pinocchio reads the result. MuJoCo reads an MJCF
file from a copy in which a small mesh stands in for each missing one. Each chain to a leaf (at most --tips for each
file) is compared as in robots_table.py. A refusal is listed with the reason and whose fault it is. The exit code is 1
if a value disagrees or stiffgen refuses what is not the file's fault. Without FOLDER the campaign says so and ends.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from campaigns.robots_table import compared, load, tips_of
from stiffgen.core.errors import StiffgenError
from stiffgen.core.loading import describe
from stiffgen.core.robot.description import Reading
from stiffgen.core.robot.selection import possible_tips

BLAME = {
    r"no rigid body has this inertia": "the file: impossible inertia (--accept-inertia)",
    r"its inertia comes from the mesh": "the set: it has no meshes",
    r"has no single coordinate": "the robot: a joint with several coordinates",
    r"couples more than two joints|is not linear": "the file: a coupling that is not linear",
    r"the oracle refuses": "the oracle",
    r"is negative|occurs twice|does not exist": "the file",
}
"""Whose fault a refusal is, by words of its reason; without an entry it is stiffgen's."""
_CORNERS = [(x, y, z) for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)]
_FACES = [(0, 2, 1), (1, 2, 3), (4, 5, 6), (5, 7, 6), (0, 1, 4), (1, 5, 4), (2, 6, 3), (3, 6, 7), (0, 4, 2), (2, 4, 6)]
_FACES += [(1, 3, 5), (3, 7, 5)]


@dataclass
class Entry:
    """Results of one entry: chains that agree, those without masses, refusals and wrong values."""

    name: str
    agreed: int = 0
    without_masses: int = 0
    refused: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)

    @property
    def is_read(self) -> bool:
        return bool(self.agreed or self.without_masses)


def check(folder: Path, record: dict[str, Any], most_tips: int, scratch: Path) -> Entry:
    """Compare the chains of one entry, to its first tips, with an independent reader."""
    path = folder / record["file"]
    arguments = {str(name): str(value) for name, value in record["args"].items()}
    own = Path(*Path(record["file"]).parts[:2])
    others = tuple(folder / each for each in record["packages"] if not own.is_relative_to(each))
    entry = Entry(" ".join([record["file"], *(f"{name}:={value}" for name, value in arguments.items())]))
    try:
        description = describe(path, Reading(arguments=arguments, package_path=others))
    except StiffgenError as error:
        entry.refused.append(" ".join(str(error).split()))
        return entry
    oracle = independent(path, record, folder, scratch)
    possible = set(possible_tips(description))
    leaves = [leaf for leaf in tips_of(description) if leaf in possible]
    for k, leaf in enumerate(leaves[:most_tips]):
        try:
            chain, refused = load(description, leaf)
        except StiffgenError as error:
            if "no moving joint" not in str(error):
                entry.refused.append(" ".join(str(error).split()))
            continue
        try:
            errors = compared(oracle, chain, np.random.default_rng(k + 1), 12 if k == 0 else 0)
        except ValueError as error:
            entry.refused.append(f"not compared, the oracle refuses: {' '.join(str(error).split())}")
            continue
        if errors:
            entry.wrong.append(f"to {leaf}: {errors}")
        elif refused:
            entry.without_masses += 1
            entry.refused.append(refused)
        else:
            entry.agreed += 1
    return entry


_EXPAND = """import json, sys
from xacrodoc import XacroDoc, packages
path, arguments, folders = json.load(sys.stdin)
packages.look_in(folders)
print(XacroDoc.from_file(path, subargs=arguments, resolve_packages=False).to_urdf_string())"""


def expanded(path: Path, arguments: dict[str, str], folder: Path, given: list[str]) -> str:
    """Return the URDF of a template, expanded by xacro's own evaluator with the packages of its repository."""
    repository = folder / Path(*path.relative_to(folder).parts[:2])
    request = json.dumps([str(path), arguments, [str(repository), *(str(folder / each) for each in given)]])
    command = [sys.executable, "-c", _EXPAND]
    return subprocess.run(command, input=request, capture_output=True, text=True, check=True).stdout


def independent(path: Path, record: dict[str, Any], folder: Path, scratch: Path) -> Path:
    """Return a file for the oracle: a template expanded, an MJCF file with stand-ins for its meshes, or a URDF."""
    kind, given = record["format"], record["packages"]
    arguments = {str(name): str(value) for name, value in record["args"].items()}
    if kind == "urdf":
        return path
    target = Path(tempfile.mkdtemp(dir=scratch))
    if kind == "xacro":
        (target / "robot.urdf").write_text(expanded(path, arguments, folder, given))
        return target / "robot.urdf"
    shutil.copytree(path.parent, target / "model")
    copy = target / "model" / path.name
    for place, scale in _missing(copy):
        place.parent.mkdir(parents=True, exist_ok=True)
        _stand_in(place, 0.1 / scale)
    return copy


def _missing(file: Path) -> Iterator[tuple[Path, float]]:
    """Yield the files of meshes and textures that a model names and that do not exist, and their scale."""
    spec = mujoco.MjSpec.from_file(str(file))
    groups = ((spec.meshes, spec.compiler.meshdir), (spec.textures, spec.compiler.texturedir), (spec.hfields, ""))
    for elements, folder in groups:
        for element in elements:
            names = [element.file, *(getattr(element, "cubefiles", None) or [])]
            for name in filter(None, names):
                place = file.parent / folder / name
                if not place.is_file():
                    yield place, float(np.abs(getattr(element, "scale", [1.0])).min())


def _stand_in(place: Path, size: float) -> None:
    """Write a small picture or a cube in place of a file that a description names."""
    if place.suffix.lower() == ".png":
        from PIL import Image  # with matplotlib, of the extra test

        Image.new("RGB", (6, 8)).save(place)
    elif place.suffix.lower() == ".obj":
        corners = [f"v {' '.join(f'{x * size:g}' for x in corner)}" for corner in _CORNERS]
        faces = [f"f {' '.join(str(index + 1) for index in face)}" for face in _FACES]
        place.write_text("\n".join([*corners, *faces, ""]))
    else:
        kind = np.dtype([("normal", "<f4", 3), ("points", "<f4", (3, 3)), ("attribute", "<u2")])
        triangles = np.zeros(len(_FACES), kind)
        triangles["points"] = size * np.array(_CORNERS)[np.array(_FACES)]
        place.write_bytes(bytes(80) + np.uint32(len(_FACES)).tobytes() + triangles.tobytes())


def blame(reason: str) -> str:
    """Return whose fault a refusal is."""
    return next((whose for words, whose in BLAME.items() if re.search(words, reason)), "stiffgen")


def main() -> int:
    """Compare the makers' files with the records of their robots; return 1 if a chain is wrong or stiffgen refuses
    one.
    """
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("words", nargs="*")
    parser.add_argument("--tips", type=int, default=6)
    parser.add_argument("--entries", type=int, default=10_000)
    options = parser.parse_args()
    if not (options.folder / "robots.json").is_file():
        print(f"{options.folder}: has no robots.json; nothing to compare")
        return 0
    warnings.simplefilter("ignore")
    records = json.loads((options.folder / "robots.json").read_text(encoding="utf-8"))
    chosen = [each for each in records if not options.words or any(word in each["file"] for word in options.words)]
    entries = []
    with tempfile.TemporaryDirectory(prefix="vendor.") as scratch:
        for record in chosen[: options.entries]:
            entry = check(options.folder, record, options.tips, Path(scratch))
            entries.append(entry)
            print(f"{entry.agreed:3} agree, {entry.without_masses:3} without masses: {entry.name}", flush=True)
            for text in entry.wrong:
                print(f"      WRONG {text}")
            for reason in dict.fromkeys(entry.refused):
                print(f"      {blame(reason)}: {reason[:200]}")
    wrong = sum(map(len, (entry.wrong for entry in entries)))
    ours = [reason for entry in entries for reason in entry.refused if blame(reason) == "stiffgen"]
    chains = sum(entry.agreed + entry.without_masses for entry in entries)
    print(
        f"{sum(entry.is_read for entry in entries)} of {len(entries)} entries are read; "
        f"{chains} chains agree, {wrong} are wrong"
    )
    return int(bool(wrong or ours or not all(entry.is_read for entry in entries)))


if __name__ == "__main__":
    sys.exit(main())
