# SPDX-License-Identifier: MIT
"""``stiffgen verify --kinds``: all kernels on the smallest robots; a folder's robot names the kinds that it is not."""

from __future__ import annotations

from pathlib import Path

import pytest

import stiffgen
from stiffgen.cli import main
from stiffgen.cli.kinds import KINDS, check_kinds, lacking_kinds
from stiffgen.core.errors import StiffgenError
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.kernels import chain_kernels
from support.project import ROOT

IN_CI = (
    "slide before a turning joint",
    "mimic beside the path",
    "two tips",
    "mimic on a floating base with a tool at run time",
)
"""Kinds that hold all others: the last two are several at once."""


@pytest.mark.slow
@pytest.mark.parametrize("names", [IN_CI, pytest.param(tuple(KINDS), marks=pytest.mark.wide)], ids=["in CI", "all"])
def test_all_kernels_agree_on_every_kind(
    names: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("stiffgen.cli.kinds.KINDS", {name: KINDS[name] for name in names})
    assert main(["verify", "--kinds"]) == 0
    out = capsys.readouterr().out
    for name in names:
        assert f"{name}: " in out


def test_each_smallest_robot_is_of_its_kind(tmp_path: Path) -> None:
    """Check that the smallest robots have the kinds named, and together all functions of the iiwa 14."""
    chains = {name: kind.chain(tmp_path) for name, kind in KINDS.items()}
    for name, chain in chains.items():
        assert name not in lacking_kinds(chain)
    assert "mimic on the path" in lacking_kinds(chains["slide"])
    functions = {each.function for chain in chains.values() for each in chain_kernels(chain, KernelOptions())}
    arm = stiffgen.load_chain(ROOT / "urdf" / "iiwa14.urdf")
    assert {each.function for each in chain_kernels(arm, KernelOptions())} <= functions


def test_an_arm_lacks_all_but_turning_joints(chain: stiffgen.Chain) -> None:
    assert lacking_kinds(chain) == [name for name in KINDS if name != "turning joint"]


def test_chosen_functions_are_compared_alone() -> None:
    checks = check_kinds(["forward_kinematics"])
    assert {check.kernel.rpartition(": ")[2].rpartition("forward")[1] for check in checks} == {"forward"}
    assert all(check.passed for check in checks) and len(checks) == len(KINDS) + 1  # two tips
    with pytest.raises(StiffgenError, match="no_such: no function of any kind of robot"):
        check_kinds(["no_such"])


def test_nothing_to_verify_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify"]) == 2
    assert "Give a robot's folder or file, or --kinds" in capsys.readouterr().err
