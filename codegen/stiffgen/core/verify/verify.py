# SPDX-License-Identifier: MIT
"""Run the command ``stiffgen verify DIR``: every comparison of a folder, one step after the other."""

from __future__ import annotations

import ctypes
import math
import warnings
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path

from stiffgen.core.errors import PotentialError, StiffgenError, listed
from stiffgen.core.family import part
from stiffgen.core.folder import temporary_folder
from stiffgen.core.manifest import MANIFEST
from stiffgen.core.opened import GeneratedRobot, open_robot
from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.verify.folder.bounds import check_bounds
from stiffgen.core.verify.folder.files import (
    check_c_tables,
    check_files,
    check_functions,
    check_python_tables,
    check_text,
    check_urdf,
    load_module,
    print_again,
)
from stiffgen.core.verify.folder.widths import build_widths
from stiffgen.core.verify.kernels.batches import LONG, check_c_batches, check_stacks
from stiffgen.core.verify.kernels.formulas import check_against_casadi, check_far_angles
from stiffgen.core.verify.kernels.missing import missing_functions
from stiffgen.core.verify.kernels.not_finite import check_not_finite
from stiffgen.core.verify.kernels.oracles import check_oracles, check_robot
from stiffgen.core.verify.kernels.samples import Samples, argument_samples
from stiffgen.core.verify.result import Check, Kernels, attempted, one_by_one
from stiffgen.rooms import optional

Comparison = Callable[[], list[Check]]


def verify(
    folder: str | Path,
    *,
    urdf: str | Path | None = None,
    count: int | None = None,
    seed: int = 0,
    trust_potentials: bool = False,
    other_version: bool = False,
    progress: Callable[[str], None] = lambda step: None,
) -> list[Check]:
    """Verify a robot's folder against independent references.

    Files against the digests in the manifest; the manifest's chain against the URDF, if it is given; names and limits
    against the chain; every function against independent oracles and against the CasADi function it was printed from;
    stacks and C batches of every length, with steps of every kind, against single calls; C++, NAME_sensor.h, CasADi,
    PyTorch and JAX against these; NaN, infinity and numbers that overflow; no memory but the arguments'; the controller
    against its law, its limits and its reaction to faults. A comparison that the folder calls for and that cannot be
    made does not pass.

    Args:
        folder: what ``stiffgen generate`` wrote.
        urdf: the file that it was generated from. Without it the chain in the manifest is believed.
        count: number of random postures within the limits (default: 200 up to 7 joints, fewer for more, at least 10).
        seed: of the random generator, not negative.
        trust_potentials: run the source of the potentials in the folder's manifest.json, which these need.
        other_version: accept that the text of a folder of another version is not compared.
        progress: called with a few words before each step.

    Returns:
        One record a comparison.

    Raises:
        OutputError: the folder is none of stiffgen's, is damaged, or is not compiled.
        DescriptionError, ChainError: the URDF has no such chain.
        StiffgenError: ``count`` or ``seed`` is out of range.
        PotentialError: the folder has potentials that are not trusted.

    """
    if seed < 0 or (count is not None and count < 1):
        raise StiffgenError("the seed must not be negative, and there must be at least one posture")
    robot = open_robot(folder, trust_potentials=trust_potentials)
    _require_trust(robot)
    count = default_count(robot.chain) if count is None else count
    checks = check_files(robot)
    if not checks[0].passed:
        return [*checks, Check("functions", "not run", math.inf, 0.0, "nothing of a folder with other files is run")]
    load_module(robot)
    with temporary_folder("verify") as build, warnings.catch_warnings():
        # Asymmetric stiffnesses and far angles are tried on purpose.
        warnings.filterwarnings("ignore", ".*(its symmetric part is used|are the positions in degrees)", UserWarning)
        steps = _steps(robot, None if urdf is None else Path(urdf), count, seed, build, other_version=other_version)
        for number, (title, step) in enumerate(steps, start=1):
            progress(f"{title} ({number} of {len(steps)})")
            checks += attempted(title, step)
    return checks


def _require_trust(robot: GeneratedRobot) -> None:
    """Refuse a folder with potentials whose source may not be run."""
    sealed = [each.name for each in robot.springs.potentials if each.is_sealed]
    if sealed:
        raise PotentialError(
            f"{robot.folder}: verification runs the source of the potentials in manifest.json ({listed(sealed)}); read "
            "it, then pass --trust-potentials, or trust_potentials=True in Python"
        )


def default_count(chain: Chain) -> int:
    """Return the number of configurations for a chain: the cost of one grows with the cube of its joints."""
    return max(10, min(200, round(200 * (7 / len(chain.joints)) ** 2)))


def _steps(
    robot: GeneratedRobot, urdf: Path | None, count: int, seed: int, build: Path, *, other_version: bool
) -> list[tuple[str, Comparison]]:
    """Return the steps and their titles; what several steps need is made by the first that asks."""
    chain, kernels, table, springs = robot.chain, robot.kernels, robot.table, robot.springs
    # Stacks use the batch functions if there are any; the oracles must see the single functions, too.
    single = {name: one_by_one(kernel) for name, kernel in kernels.items()}
    missing = missing_functions(robot)
    pool = argument_samples(chain, LONG, seed, springs)
    texts = cache(partial(print_again, robot))
    libraries = cache(partial(build_widths, robot, build))
    rounding, bounds = part("rounding.certified"), list[tuple[str, Comparison]]()
    if rounding:
        of_bounds = (single, kernels), robot, pool
        bounds.append(("certified bounds", lambda: rounding.check_folder(*of_bounds, texts()[MANIFEST])))
    steps: list[tuple[str, Comparison]] = [
        ("printing again", lambda: [check_functions(robot), check_text(robot, texts(), other_version=other_version)]),
        ("names and limits", lambda: [check_python_tables(robot)]),
        ("names and limits in C", lambda: check_c_tables(robot, libraries())),
        (
            "differentiating and comparing",
            lambda: check_oracles(table, springs) + check_robot(missing | single, chain, count, seed, springs, table),
        ),
        ("comparing with CasADi", lambda: check_against_casadi(single, chain, min(count, 50), seed, springs)),
        ("angles many turns away", lambda: check_far_angles(single, chain, seed, springs)),
        ("stacks of every length", lambda: check_stacks(kernels, single, table, chain, pool)),
        *bounds,
        ("NaN and infinity", lambda: check_not_finite(kernels, table, pool, robot.scalar)),
    ]
    of_languages = robot, single, pool, build / "languages", other_version
    steps += _steps_of_rooms(of_languages, texts, libraries, seed)
    loops, derivatives, masses = map(part, ("loops.oracles", "derivatives.check", "dynamics.masses"))
    if chain.loops:
        projected = min(count, 50)
        steps.append(
            (
                "projecting closed loops",
                lambda: loops.check_loops(missing | single, chain, projected, seed, springs, table),
            )
        )
    if springs.derivatives:
        steps.append(
            ("differences of what has derivatives", lambda: derivatives.check_derivatives(single, table, chain, pool))
        )
    of_batches = robot.name, single, table, chain, pool, robot.scalar
    steps.append(("batches in C", lambda: check_c_batches(libraries(), *of_batches)))
    steps.append(("bounds of memory", lambda: _check_memory(libraries(), robot, pool)))
    if urdf is not None:
        file = urdf
        steps.insert(1, ("reading the URDF", lambda: [check_urdf(chain, file)]))
        states = Samples(chain, 5, seed)
        if masses:
            steps.insert(2, ("masses of the URDF", lambda: masses.check_masses(single, table, chain, file, states)))
    return steps


def _steps_of_rooms(
    of_languages: tuple[GeneratedRobot, Kernels, Mapping[Argument, FloatArray], Path, bool],
    texts: Callable[[], Mapping[str, str]],
    libraries: Callable[[], Mapping[str, ctypes.CDLL]],
    seed: int,
) -> list[tuple[str, Comparison]]:
    """Return the steps of rooms that may have been taken out: other languages, the controller."""
    robot, build = of_languages[0], of_languages[3].parent
    steps: list[tuple[str, Comparison]] = []
    languages = optional("lab.languages.check")
    if languages is not None:
        steps.append(("other languages", lambda: languages.check_languages(*of_languages, libraries(), texts())))
    controller = optional("control.sessions")
    if controller is not None:
        steps += [
            ("stepping the controller", lambda: controller.check_controller(robot, seed)),
            ("hostile sessions", lambda: controller.check_sessions(robot, texts(), seed, build / "sessions")),
        ]
    return steps


def _check_memory(
    libraries: Mapping[str, ctypes.CDLL], robot: GeneratedRobot, pool: Mapping[Argument, FloatArray]
) -> list[Check]:
    """Check the accesses of one build."""
    library = next(iter(libraries.values()))
    return check_bounds(library, robot.name, robot.table, robot.chain, pool, robot.scalar)
