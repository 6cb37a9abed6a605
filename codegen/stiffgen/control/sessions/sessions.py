# SPDX-License-Identifier: MIT
"""Run sessions of a folder's controller beside the installed generator's; results must be equal in bits.

The reference is compiled on the spot from what this generator prints for the chain in the manifest. A simple arm
follows the reference's torque through hostile sessions (:mod:`~stiffgen.control.sessions.hostile`).
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from stiffgen.control.sessions.companions import compare_companions
from stiffgen.control.sessions.hostile import HostileSession
from stiffgen.control.sessions.library import ControllerLibrary, build_controller
from stiffgen.control.sessions.rules import check_rules
from stiffgen.control.sessions.services import compare_services
from stiffgen.core.opened import GeneratedRobot
from stiffgen.core.robot.chain import Chain
from stiffgen.core.verify.folder.forked import confined
from stiffgen.core.verify.result import Check, faultless

SESSIONS = 90
"""Number of sessions."""


def check_sessions(robot: GeneratedRobot, texts: Mapping[str, str], seed: int, build: Path) -> list[Check]:
    """Compare the C controller in the folder with the table of fields, and in sessions with the one in ``texts``.

    Args:
        robot: the folder.
        texts: the folder's files as this generator prints them.
        seed: of the random generator.
        build: a folder to compile in, which does not exist yet.

    Returns:
        Nothing for a robot without a controller.

    Raises:
        BuildError: no compiler, or it failed.

    """
    if f"{robot.name}_impedance.c" not in texts:
        return []
    files = _build_both(robot, texts, build)
    reference, library = (open_controller(file, robot) for file in files)
    faults = confined(lambda: differences(reference, library, robot.chain, seed))
    beside = confined(lambda: compare_companions(*files, robot.name, robot.chain))
    return [
        *check_rules(library, robot.module, robot.chain),
        faultless("controller: sessions", "this generator's controller, in bits", faults),
        faultless("controller: companions", "this generator's companions, in bits", beside),
    ]


def open_controller(file: Path, robot: GeneratedRobot) -> ControllerLibrary:
    """Load a compiled controller of a folder."""
    springs = robot.springs
    return ControllerLibrary(
        file, robot.name, robot.chain, bounded="bounded" in springs.springs, pairs=len(springs.pairs)
    )


def _build_both(robot: GeneratedRobot, texts: Mapping[str, str], build: Path) -> tuple[Path, Path]:
    """Compile the controller of ``texts``, and the folder's: of the same sources one is a copy, with data of its own.

    Raises:
        BuildError: no compiler, or it failed.

    """
    fresh = build / "printed"
    fresh.mkdir(parents=True)
    sources = {file: text for file, text in texts.items() if file.endswith((".c", ".h")) and "/" not in file}
    for file, text in sources.items():
        (fresh / file).write_text(text, encoding="utf-8")
    reference = build_controller(fresh, robot.name, build / "reference")
    if any(not _holds(robot.folder / file, text) for file, text in sources.items()):
        return reference, build_controller(robot.folder, robot.name, build / "folder")
    copied = build / "folder" / reference.name
    copied.parent.mkdir()
    return reference, shutil.copyfile(reference, copied)


def _holds(file: Path, text: str) -> bool:
    """Return whether a file is there with this text; a folder of another version may lack a file of this one."""
    return file.exists() and file.read_bytes() == text.encode()


def differences(
    reference: ControllerLibrary, library: ControllerLibrary, chain: Chain, seed: int, enough: int = 4
) -> list[str]:
    """Return the differences of a controller from the reference: in functions, then in sessions, up to a number."""
    faults = compare_services(reference, library)
    for number in range(SESSIONS):
        if len(faults) >= enough:
            break
        session = HostileSession(reference, library, chain, np.random.default_rng([seed, number]))
        step = session.find_difference()
        if step is not None:
            faults.append(f"session {number}: step {step}")
    return faults
