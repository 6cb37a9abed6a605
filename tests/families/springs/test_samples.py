# SPDX-License-Identifier: MIT
"""Values of arguments come from their records; a record that lacks something names the line to write."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import stiffgen
from stiffgen.core.errors import StiffgenError
from stiffgen.core.symbolic.arguments import BASE_POSE, TOOL_POSE, Argument, Q
from stiffgen.core.symbolic.choices import KINDS, KernelOptions
from stiffgen.core.symbolic.kernels import KERNELS, chain_kernels
from stiffgen.core.symbolic.quantities import BlockKind, Blocks, Normal
from stiffgen.core.verify.kernels.samples import Samples, argument_samples, symmetric
from support.project import ROOT

POSE = KERNELS[0]
DATA = ROOT / "tests" / "data"


@pytest.mark.parametrize(
    ("record", "line"),
    [
        ({"largest": 5.0}, r"Argument\('load', ...\) has no random values.*write draw="),
        ({"draw": Normal()}, r"Argument\('load', ...\) has no range.*write largest="),
        ({"draw": Normal(), "largest": "forces"}, r"unknown range; ranges are numbers and positions, .*force"),
        ({"draw": Normal(), "blocks": Blocks((BlockKind("", "", "forces"),), lambda k: 0)}, r"unknown range"),
    ],
)
def test_an_argument_without_a_draw_or_a_range_names_the_line_to_write(record: dict, line: str) -> None:
    """Leave random values or range of an argument out: the error names the line to write."""
    load = Argument("load", (3,), "N", "weight at the tip", **record)
    with pytest.raises(StiffgenError, match=rf"kernel forward_kinematics: .*{line}"):
        replace(POSE, arguments=(*POSE.arguments, load))
    complete = replace(load, draw=Normal(), largest=5.0, blocks=None)
    assert replace(POSE, arguments=(*POSE.arguments, complete)).arguments[-1] == complete


@pytest.fixture(scope="module")
def arms() -> stiffgen.Chain:
    return stiffgen.load_chain(
        DATA / "dual_arm.urdf", tip=["left hand", "right-hand"], floating_base=True, runtime_tool=True
    )


def test_tips_share_the_configuration_and_nothing_else(arms: stiffgen.Chain) -> None:
    """Draw samples of several tips: they share the configuration alone."""
    samples = Samples(arms, 4, 3)
    (tools,) = {a for k in chain_kernels(arms) for a in k.arguments if a.each == TOOL_POSE}
    left, right = samples.of_tip(0), samples.of_tip(1)
    assert np.array_equal(samples[tools], np.stack([left[TOOL_POSE], right[TOOL_POSE]], axis=1))
    assert not np.array_equal(left[TOOL_POSE], right[TOOL_POSE])
    for argument in (Q, BASE_POSE):
        assert np.array_equal(left[argument], right[argument])
    rotations = samples[tools][..., :3, :3]
    assert np.allclose(rotations @ np.swapaxes(rotations, -1, -2), np.eye(3))


def test_stiffnesses_differ_from_their_symmetric_parts(chain: stiffgen.Chain) -> None:
    """Draw stiffnesses: all are asymmetric. Before, a batch that read all of Kt passed."""
    pool = argument_samples(chain, 3, 0, KernelOptions(springs=KINDS))
    of_stiffness = {argument: values for argument, values in pool.items() if argument.symmetric_part}
    names = {argument.name for argument in of_stiffness}
    assert names == {"task_stiffness", "translation_stiffness", "rotation_stiffness", "stiffness"}
    for values in of_stiffness.values():
        off = np.abs(values - symmetric(values))[:, ~np.eye(values.shape[-1], dtype=bool)]
        assert (off > 0.25).all()


def test_matrices_that_are_solved_are_well_conditioned(chain: stiffgen.Chain) -> None:
    pool = argument_samples(chain, 200, 0, KernelOptions(springs=KINDS))
    names = ("translation_stiffness", "rotation_stiffness", "stiffness")
    positive = [symmetric(pool[argument]) for argument in pool if argument.name in names]
    assert len(positive) == 3
    assert all(np.linalg.cond(values).max() < 1e3 for values in positive)
