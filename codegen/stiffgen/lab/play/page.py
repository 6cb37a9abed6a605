# SPDX-License-Identifier: MIT
"""The playground's page: a robot's folder becomes one HTML file that needs no server and no network."""

from __future__ import annotations

import base64
import html
import json
import math
import re
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

from stiffgen._version import __version__
from stiffgen.core.errors import OutputError, printable
from stiffgen.core.family import part
from stiffgen.core.folder import unwritable, write_atomically
from stiffgen.core.opened import GeneratedRobot, open_robot
from stiffgen.core.robot.chain import Chain, Tip
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.kernels import Kernel
from stiffgen.lab.play.linkage import drawn_joints
from stiffgen.lab.play.wasm import compile_wasm

KERNELS = (
    "forward_kinematics",
    "hybrid_jacobian",
    "hybrid_joint_stiffness",
    "hybrid_joint_stiffness_uncorrected",
    "spring_wrench",
    "spring_task_stiffness",
    "spring_energy",
    "spring_torque",
    "spring_joint_stiffness",
)
"""Functions that the page calls for each tip: qualified names without the tip. The kernel table has the shapes."""

MASSES = ("mass_matrix", "bias_forces")
"""Functions of the whole tree that the page calls where the robot has masses and no closed loops."""

OF_LOOPS = ("close", "motors_jacobian")
"""Functions of the whole robot that the page calls where the robot has closed loops."""

OF_MOTORS = ("motors_torque", "motors_joint_stiffness")
"""Functions that the page calls for each tip of a robot with closed loops."""

OF_PAIR = ("pair_wrench", "bimanual_energy", "bimanual_torque", "bimanual_joint_stiffness")
"""Functions that the page calls for the first pair of tips of a robot without closed loops."""

SCRIPTS = (
    "algebra.js", "kernels.js", "chain.js", "mechanics.js", "twoarms.js", "swing.js", "compliance.js", "solids.js",
    "figures.js", "drives.js", "panels.js", "swingpanel.js", "view.js", "compliancepanel.js", "drivepanel.js",
    "twoarmspanel.js", "values.js", "matrixpanel.js", "motorpanel.js", "looppanel.js", "controls.js", "presets.js",
    "main.js",
)  # fmt: skip
"""Modules of the page, each after the modules that it imports."""

_LBR = [f"A{k}" for k in range(1, 8)]
_PAPERS_POSTURE = (70.45, 55.35, -36.13, -94.85, 2.43, 11.60, 139.89)
"""Configuration of the KUKA LBR on the paper's recorded trajectory [deg]."""


def write_page(
    folder: str | Path, output: str | Path | None = None, progress: Callable[[str], None] | None = None
) -> Path:
    """Write the playground of a generated robot.

    Args:
        folder: a folder that ``stiffgen generate`` wrote. Its Python module is not needed.
        output: the file to write (default: NAME.html).
        progress: called with each step.

    Returns:
        The file.

    Raises:
        OutputError: the folder is not from stiffgen or from another version, or the file cannot be written.
        BuildError: clang or wasm-ld is missing or failed.

    """
    tell = progress or (lambda step: None)
    robot = open_robot(folder)
    robot.require_doubles("the playground")
    target = Path(f"{robot.name}.html") if output is None else Path(output)
    if target.is_dir():
        raise OutputError(f"{printable(str(target), 200)}: is a folder; give the name of a file, as --output play.html")
    tell(f"compiling {robot.name} for WebAssembly")
    text = page_text(robot)
    tell(f"writing {target.name}")
    try:
        write_atomically(target, text)
    except OSError as error:
        raise unwritable(target, error) from error
    return target


def page_text(robot: GeneratedRobot) -> str:
    """Return the page: HTML with style, script, the robot's data and its kernels in it.

    Raises:
        OutputError, BuildError: as :func:`write_page`.

    """
    data = page_data(robot)
    wasm = compile_wasm(_source(robot), [*data["functions"], f"{robot.name}_self_check"])
    name = html.escape(robot.name)
    parts = {
        "TITLE": name,
        "VERSION": html.escape(__version__),
        "STYLE": _asset("style.css"),
        "DATA": json.dumps(data, ensure_ascii=True, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
        "WASM": base64.b64encode(wasm).decode(),
        "SCRIPT": script(),
    }
    return re.sub(r"\{\{([A-Z]+)\}\}", lambda found: parts[found[1]], _asset("page.html"))


def _number(limit: float) -> float | None:
    """Return a limit as JSON has it: null for none."""
    return limit if math.isfinite(limit) else None


def _tips_and_functions(robot: GeneratedRobot) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Return the tips with the names of their functions in C, and the arrays of every function by that name."""
    chain, table = robot.chain, {kernel.qualified_name: kernel for kernel in robot.table}
    whole = OF_LOOPS if chain.loops else tuple(name for name in MASSES if all(each in table for each in MASSES))
    of_robot = {name: f"{robot.name}_{name}" for name in whole}
    functions = {called: _arrays(table[name], chain) for name, called in of_robot.items()}
    tips = []
    for tip in chain.tips:
        names = dict(of_robot)
        for role in (*KERNELS, *(OF_MOTORS if chain.loops else ())):
            qualified = f"{tip.name}_{role}" if tip.name else role
            if qualified not in table:
                raise OutputError(
                    f"{robot.folder}: has no function {qualified}, which the playground calls; generate it again"
                )
            names[role] = f"{robot.name}_{qualified}"
            functions[names[role]] = _arrays(table[qualified], chain)
        tips.append(_tip(tip) | {"kernels": names})
    return tips, functions


def _pair_and_functions(robot: GeneratedRobot) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the first pair's tips and names of functions as the page's data has them, and the functions' arrays.

    Both are empty for a robot without pairs or their functions, and for one with closed loops.
    """
    chain, words = robot.chain, robot.springs.pairs
    if not words or chain.loops:
        return {}, {}
    pair = part("pair.way").pairs_of(chain, words)[0]
    table = {kernel.qualified_name: kernel for kernel in robot.table}
    kinds = [role.partition("_") for role in OF_PAIR]
    called = {f"{kind}_{quantity}": f"{pair.group(kind)}_{quantity}" for kind, _, quantity in kinds}
    if not all(each in table for each in called.values()):
        return {}, {}
    names = {role: f"{robot.name}_{each}" for role, each in called.items()}
    functions = {names[role]: _arrays(table[each], chain) for role, each in called.items()}
    return {"pair": {"tips": [chain.tips.index(tip) for tip in (pair.first, pair.second)], "kernels": names}}, functions


def page_data(robot: GeneratedRobot) -> dict[str, Any]:
    """Return the page's data of its robot: functions with their arrays, joints, coordinates, tips, springs' axes.

    Raises:
        OutputError: the folder lacks a function that the page calls.

    """
    chain = robot.chain
    tips, functions = _tips_and_functions(robot)
    pair, of_pair = _pair_and_functions(robot)
    placement = robot.springs
    joints, ends = drawn_joints(chain)
    return {
        "name": robot.name,
        "functions": functions | of_pair,
        "tips": tips,
        "joints": joints,
        "loops": {"actuated": chain.actuated, "start": chain.start, "ends": ends} if chain.loops else None,
        "coordinates": [
            {
                "name": each.name,
                "prismatic": each.type == "prismatic",
                "lower": _number(each.lower),
                "upper": _number(each.upper),
            }
            for each in chain.coordinates
        ],
        "floating": chain.floating,
        "runtimeTool": chain.runtime_tool,
        "axes": {
            "translation": placement.placement.translation_axes or "base",
            "rotation": placement.placement.rotation_axes,
        },
        "paper": _papers_posture(chain),
        **pair,
    }


def script() -> str:
    """Join the page's modules, without imports from each other and without the word export."""
    parts = []
    for file in SCRIPTS:
        text = re.sub(r'^import \{[^}]*\} from "\./\w+\.js";\n', "", _asset(file), flags=re.MULTILINE)
        parts.append(f"// ---- {file}\n{re.sub('^export ', '', text, flags=re.MULTILINE).strip()}\n")
    return "\n".join(parts)


def _asset(file: str) -> str:
    return (files("stiffgen.lab.play") / "page" / file).read_text(encoding="utf-8")


def _source(robot: GeneratedRobot) -> Path:
    source = robot.folder / f"{robot.name}.c"
    if not source.is_file():
        raise OutputError(f"{source}: is missing; generate the folder again")
    return source


def _arrays(kernel: Kernel, chain: Chain) -> dict[str, list[tuple[str, tuple[int, ...]]]]:
    def named(arguments: tuple[Argument, ...]) -> list[tuple[str, tuple[int, ...]]]:
        return [(argument.name, argument.array(chain).shape) for argument in arguments]

    return {"arguments": named(kernel.arguments), "results": named(kernel.results)}


def _tip(tip: Tip) -> dict[str, Any]:
    return {"link": tip.link, "joint": tip.joint, "rotation": tip.rotation, "translation": tip.translation}


def _papers_posture(chain: Chain) -> list[float] | None:
    """Return the paper's posture [rad], for a KUKA LBR; else None."""
    if [*chain.coordinate_names] != _LBR or chain.coupled or chain.floating:
        return None
    posture = [math.radians(angle) for angle in _PAPERS_POSTURE]
    inside = all(each.lower <= q <= each.upper for q, each in zip(posture, chain.coordinates, strict=True))
    return posture if inside else None
