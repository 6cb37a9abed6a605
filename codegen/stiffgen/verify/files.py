# SPDX-License-Identifier: MIT
"""A folder against its manifest, its tables against its chain, and its chain against the URDF."""

from __future__ import annotations

import ctypes
import hashlib
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from stiffgen.opened import GeneratedRobot
from stiffgen.robot.chain import Chain, load_chain
from stiffgen.verify.result import Check, faultless

LIMITS = ("lower", "upper", "velocity", "effort")


def check_files(robot: GeneratedRobot) -> list[Check]:
    """The digests of all files, and the signatures of all functions, as the manifest has them."""
    faults = []
    for file, digest in robot.manifest["files"].items():
        try:
            text = (robot.folder / file).read_bytes().replace(b"\r\n", b"\n")
        except OSError:
            faults.append(f"{file} is missing")
            continue
        if hashlib.sha256(text).hexdigest() != digest:
            faults.append(f"{file} was changed")
    signatures = {kernel.qualified_name: kernel.signature(robot.chain) for kernel in robot.table}
    listed = {name: entry["signature"] for name, entry in robot.manifest["kernels"].items()}
    return [
        faultless("files", "SHA-256 in the manifest", faults),
        faultless("functions", "kernel table", sorted(f"{n}" for n in signatures.keys() ^ listed.keys()) + [
            f"{name}: {listed[name]}" for name in signatures.keys() & listed.keys() if signatures[name] != listed[name]
        ]),
    ]  # fmt: skip


def check_urdf(chain: Chain, urdf: Path) -> Check:
    """The manifest's chain is the one of the URDF file, read again with the same base, tips, tool and locks.

    Raises:
        DescriptionError, ChainError: the URDF cannot be read, or no longer has such a chain.

    """
    links = [tip.link for tip in chain.tips]
    fresh = load_chain(
        urdf,
        tip=links[0] if len(links) == 1 else links,
        base=chain.base,
        masses=chain.masses,
        tool=chain.tool,
        runtime_tool=chain.runtime_tool,
        lock=dict(chain.locked),
        floating_base=chain.floating,
    )
    names = [field.name for field in fields(Chain) if field.name not in ("source", "digest")]
    faults = [name for name in names if getattr(fresh, name) != getattr(chain, name)]
    return faultless("chain", f"{urdf.name}, read again", faults)


def check_tables(robot: GeneratedRobot, library: ctypes.CDLL | None) -> list[Check]:
    """Names and limits, in Python and in C, against the chain."""
    chain, module = robot.chain, robot.module
    rows: dict[str, list[float]] = {
        limit: [getattr(coordinate, limit) for coordinate in chain.coordinates] for limit in LIMITS
    }
    joints = [coordinate.name for coordinate in chain.coordinates]
    links = [tip.link for tip in chain.tips]
    checks = [faultless("constants in Python", "chain", _python_faults(module, chain, rows, joints, links))]
    if library is not None:
        n, number = len(chain.coordinates), np.ctypeslib.as_ctypes_type(robot.scalar.dtype)
        faults = [
            f"{robot.name}_{limit}"
            for limit in LIMITS
            if not np.array_equal(
                np.array((number * n).in_dll(library, f"{robot.name}_{limit}")),
                np.array(rows[limit], robot.scalar.dtype),
            )
        ]
        if _strings(library, f"{robot.name}_joints", n) != joints:
            faults.append(f"{robot.name}_joints")
        if len(links) > 1 and _strings(library, f"{robot.name}_tips", len(links)) != links:
            faults.append(f"{robot.name}_tips")
        checks.append(faultless("constants in C", "chain", faults))
        check: Callable[[], int] = library[f"{robot.name}_self_check"]
        checks.append(Check("self-check", "sines, NaN", float(check()), 0.0))
    return checks


def _python_faults(
    module: Any, chain: Chain, rows: dict[str, list[float]], joints: list[str], links: list[str]
) -> list[str]:
    faults = [limit.upper() for limit in LIMITS if not np.array_equal(getattr(module, limit.upper()), rows[limit])]
    expected: dict[str, Any] = {"DOF": chain.dof, "JOINTS": tuple(joints), "BASE": chain.base}
    if len(links) == 1:
        expected["TIP"] = links[0]
    for name, value in expected.items():
        found = getattr(module, name)
        if (tuple(found) if isinstance(value, tuple) else found) != value:
            faults.append(name)
    return faults


def _strings(library: ctypes.CDLL, name: str, count: int) -> list[str]:
    return [(text or b"").decode() for text in (ctypes.c_char_p * count).in_dll(library, name)]
