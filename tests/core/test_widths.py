# SPDX-License-Identifier: MIT
"""A fault in the code of one vector width is found by ``verify`` and by the self-check of that build."""

from __future__ import annotations

from pathlib import Path

import pytest

from stiffgen.core.opened import open_robot
from stiffgen.core.verify.folder.widths import WIDTHS, build_widths
from stiffgen.core.verify.kernels.batches import check_c_batches
from stiffgen.core.verify.kernels.samples import argument_samples
from stiffgen.core.verify.result import one_by_one
from support.folders import copy_folder, restamp

HALVES = {2: "1, 3", 4: "2, 6, 3, 7", 8: "4, 12, 5, 13, 6, 14, 7, 15"}
"""Numbers that one round of the transpose takes from two vectors, by the doubles per vector."""


@pytest.mark.usefixtures("unoptimised")
@pytest.mark.parametrize("lanes", [2, *(pytest.param(each, marks=pytest.mark.slow) for each in HALVES if each > 2)])
def test_a_wrong_transpose_is_found_in_the_width_that_has_it(lanes: int, robot_folder: Path, tmp_path: Path) -> None:
    """Seed a wrong transpose in one width: its self-check and its batches fail, those of other widths pass."""
    width = next(each for each in WIDTHS if each.lanes == lanes)
    if not width.is_available:
        pytest.skip(f"the processor has no {width.name}")
    folder = copy_folder(robot_folder, tmp_path)
    source = folder / "iiwa14_lanes.h"
    order = HALVES[lanes].split(", ")
    order[0], order[-1] = order[-1], order[0]
    right, wrong = (f"#define UPPER_HALVES {each}\n" for each in (HALVES[lanes], ", ".join(order)))
    text = source.read_text()
    assert text.count(right) == 1
    source.write_text(text.replace(right, wrong))
    restamp(folder)
    robot = open_robot(folder)
    (tmp_path / "build").mkdir()
    libraries = build_widths(robot, tmp_path / "build")
    assert {name: bool(library.iiwa14_batch_self_check()) for name, library in libraries.items()} == {
        name: name == width.name for name in libraries
    }
    table = tuple(kernel for kernel in robot.table if kernel.qualified_name == "hybrid_jacobian")
    single = {name: one_by_one(kernel) for name, kernel in open_robot(robot_folder).kernels.items()}
    pool = argument_samples(robot.chain, 40, 0)

    def failed(names: list[str]) -> bool:
        chosen = {name: libraries[name] for name in names}
        checks = check_c_batches(chosen, robot.name, single, table, robot.chain, pool, robot.scalar)
        return not all(check.passed for check in checks)

    assert failed(list(libraries))
    assert not failed([name for name in libraries if name != width.name]), "looking at other widths misses the fault"
