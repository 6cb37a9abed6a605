# SPDX-License-Identifier: MIT
"""Compare a folder's files with its manifest, its tables with its chain, and its chain with the URDF."""

from __future__ import annotations

import ctypes
import hashlib
import json
import re
import sys
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from stiffgen.core.emit.render import render
from stiffgen.core.errors import printable
from stiffgen.core.folder import temporary_folder
from stiffgen.core.loading import read_chain
from stiffgen.core.manifest import MANIFEST
from stiffgen.core.opened import GeneratedRobot
from stiffgen.core.options import options_of_manifest
from stiffgen.core.robot.chain import Chain, ChainOptions
from stiffgen.core.verify.result import Check, faultless, not_compared

LIMITS = ("lower", "upper", "velocity", "effort")


def check_files(robot: GeneratedRobot) -> list[Check]:
    """Compare every file of the folder with the digests in the manifest, before any of them is run.

    Files that the manifest does not list are faults. Compiled modules and Python's caches are exempt: the
    comparisons of values run the module of kernels, and :func:`load_module` reads no cache.
    """
    faults = []
    for file, digest in robot.manifest["files"].items():
        path = robot.folder / file
        if ".." in Path(file).parts or Path(file).is_absolute() or not path.is_file():
            faults.append(f"{printable(file)} is missing")
            continue
        text = path.read_bytes().replace(b"\r\n", b"\n")
        if hashlib.sha256(text).hexdigest() != digest:
            faults.append(f"{printable(file)} was changed")
    faults += [f"{printable(file)} is not in the manifest" for file in _unlisted(robot)]
    return [faultless("files", "SHA-256 in the manifest", faults)]


def _unlisted(robot: GeneratedRobot) -> list[str]:
    """Return the files of the folder that the manifest does not list, without modules compiled from its sources."""
    known = {MANIFEST, *robot.manifest["files"]}
    compiled = re.compile(rf"{robot.name}_(python|casadi|jax)(\.[\w-]+)?\.(so|pyd)")
    paths = (file for file in robot.folder.rglob("*") if file.is_symlink() or not file.is_dir())
    files = [file.relative_to(robot.folder) for file in paths]  # a link to a folder is a package that Python imports
    return sorted(
        str(file)
        for file in files
        if file.as_posix() not in known and not compiled.fullmatch(file.name) and file.parent.name != "__pycache__"
    )


def check_functions(robot: GeneratedRobot) -> Check:
    """Compare the functions and signatures in the manifest with the kernel table."""
    signatures = {kernel.qualified_name: kernel.signature(robot.chain) for kernel in robot.table}
    listed = {name: entry["signature"] for name, entry in robot.manifest["kernels"].items()}
    faults = sorted(signatures.keys() ^ listed.keys())
    faults += [
        f"{name}: {listed[name]}" for name in signatures.keys() & listed.keys() if signatures[name] != listed[name]
    ]
    return faultless("functions", "kernel table", faults)


def print_again(robot: GeneratedRobot) -> dict[str, str]:
    """Print the files of the folder with this generator, from the chain and the options in its manifest."""
    return render(robot.chain, robot.name, options_of_manifest(robot.manifest, robot.springs))


def check_text(robot: GeneratedRobot, texts: Mapping[str, str], *, other_version: bool = False) -> Check:
    """Compare every file with the text that this generator prints; one of another version is not compared.

    ``other_version`` accepts that.
    """
    listed = robot.manifest["files"].keys() | {MANIFEST}
    faults = [f"{file} is missing" for file in texts.keys() - listed]
    faults += [f"{file} differs" for file in texts.keys() & listed if not is_printed(robot, file, texts[file])]
    made, own = robot.manifest["versions"], json.loads(texts[MANIFEST])["versions"]
    if made != own:
        reason = f"the folder was made by {_words(made)}, not by {_words(own)}"
        reason += f" ({_some(sorted(faults))})" if faults else ""
        reason += "; verify with these versions, or accept that with --other-version"
        return not_compared("text", "printed again", reason, is_accepted=other_version)
    return faultless("text", "printed again", sorted(faults))


def _words(versions: Mapping[str, Any]) -> str:
    """Return packages with their versions as text."""
    return ", ".join(f"{printable(str(name), 20)} {printable(str(number), 20)}" for name, number in versions.items())


def _some(faults: list[str]) -> str:
    return "; ".join(faults[:8]) + (f" and {len(faults) - 8} more" if len(faults) > 8 else "")


def is_printed(robot: GeneratedRobot, file: str, text: str) -> bool:
    """Return whether a file of the folder holds this text, with line ends of any system."""
    return (robot.folder / file).read_bytes().replace(b"\r\n", b"\n") == text.encode()


def load_module(robot: GeneratedRobot) -> None:
    """Import the folder's Python package from its sources, never from bytecode beside them."""
    prefix = sys.pycache_prefix
    with temporary_folder("bytecode") as empty:
        sys.pycache_prefix = str(empty)
        try:
            _ = robot.module
        finally:
            sys.pycache_prefix = prefix


def check_urdf(chain: Chain, urdf: Path) -> Check:
    """Compare the manifest's chain with that of the robot's file, read again with the same base, tips, tool and locks.

    Raises:
        DescriptionError, ChainError: the URDF cannot be read, or no longer has such a chain.

    """
    fresh = read_chain(urdf, _options_of(chain))
    compared = [field.name for field in fields(Chain) if field.name not in ("source", "digest", "inputs")]
    faults = [name for name in compared if getattr(fresh, name) != getattr(chain, name)]
    return faultless("chain", f"{urdf.name}, read again", faults)


def _options_of(chain: Chain) -> ChainOptions:
    """Return the options with which a chain was read."""
    links = [tip.link for tip in chain.tips]
    ends = [end for loop in chain.loops for end in (loop.first, loop.second)]
    moved = {joint.coordinate - chain.base_joints for end in ends for joint in end.joints}
    return ChainOptions(
        tip=links[0] if len(links) == 1 else links,
        base=chain.base,
        masses=chain.masses,
        tool=chain.tool,
        runtime_tool=chain.runtime_tool,
        lock=dict(chain.locked),
        floating_base=chain.floating,
        ignore=chain.ignored,
        accept_inertia=[each.link for each in chain.accepted],
        arguments=dict(chain.arguments),
        close_loops=not all(loop.option for loop in chain.loops),
        loop=[loop.option for loop in chain.loops if loop.option],
        sensor=chain.sensor.option if chain.sensor else None,
        actuated=[chain.coordinates[k].name for k in chain.actuated if k in moved],
    )


def check_python_tables(robot: GeneratedRobot) -> Check:
    """Compare names and limits in Python with the chain."""
    faults = _python_faults(robot.module, robot.chain, *_tables(robot.chain))
    return faultless("constants in Python", "chain", faults)


def check_c_tables(robot: GeneratedRobot, libraries: Mapping[str, ctypes.CDLL]) -> list[Check]:
    """Compare names and limits in C with the chain; run the self-check of every build."""
    checks = []
    for library in list(libraries.values())[:1]:
        checks.append(faultless("constants in C", "chain", _c_faults(library, robot, *_tables(robot.chain))))
    for width, library in libraries.items():
        calls = [f"{robot.name}_self_check", *([f"{robot.name}_batch_self_check"] if robot.has_batches else [])]
        wrong = sum(int(library[call]()) for call in calls)
        checks.append(Check("self-check", f"sines, NaN, transpose; {width}", float(wrong), 0.0))
    return checks


def _tables(chain: Chain) -> tuple[dict[str, list[float]], list[str], list[str]]:
    """Return the limits of the coordinates by name, the coordinates' names, and the tip links."""
    rows = {limit: [float(getattr(each, limit)) for each in chain.coordinates] for limit in LIMITS}
    return rows, [*chain.coordinate_names], [tip.link for tip in chain.tips]


def _c_faults(
    library: ctypes.CDLL, robot: GeneratedRobot, rows: dict[str, list[float]], joints: list[str], links: list[str]
) -> list[str]:
    """Return the tables of a C library that differ from the chain's."""
    n, number = len(joints), np.ctypeslib.as_ctypes_type(robot.scalar.dtype)
    faults = []
    for limit in LIMITS:
        values = np.array((number * n).in_dll(library, f"{robot.name}_{limit}"))
        if not np.array_equal(values, np.array(rows[limit], robot.scalar.dtype)):
            faults.append(f"{robot.name}_{limit}")
    if _strings(library, f"{robot.name}_joints", n) != joints:
        faults.append(f"{robot.name}_joints")
    if len(links) > 1 and _strings(library, f"{robot.name}_tips", len(links)) != links:
        faults.append(f"{robot.name}_tips")
    return faults


def _python_faults(
    module: Any, chain: Chain, rows: dict[str, list[float]], joints: list[str], links: list[str]
) -> list[str]:
    """Return the constants of a Python module that differ from the chain's."""
    faults = [limit.upper() for limit in LIMITS if not np.array_equal(getattr(module, limit.upper()), rows[limit])]
    expected: dict[str, Any] = {"DOF": chain.dof, "JOINTS": tuple(joints), "BASE": chain.base}
    if len(links) == 1:
        expected["TIP"] = links[0]
    if chain.loops:
        expected["ACTUATED"] = tuple(joints[k] for k in chain.actuated)
        if not np.array_equal(module.START, chain.start):
            faults.append("START")
    for name, value in expected.items():
        constant = getattr(module, name)
        if (tuple(constant) if isinstance(value, tuple) else constant) != value:
            faults.append(name)
    return faults


def _strings(library: ctypes.CDLL, name: str, count: int) -> list[str]:
    """Return an array of C strings."""
    return [(text or b"").decode() for text in (ctypes.c_char_p * count).in_dll(library, name)]
