# SPDX-License-Identifier: MIT
"""The C of springs reads as that of the other kernels: named quantities, each under one name of its own."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest

import stiffgen
from stiffgen.core.emit.c.functions import CFunction, print_kernels
from stiffgen.core.lower.variant import BATCH, CUDA, SINGLE, Variant
from stiffgen.core.symbolic.choices import KINDS, KernelOptions
from stiffgen.core.symbolic.kernels import Kernel
from stiffgen.core.symbolic.placement import Placement
from stiffgen.families.springs.springs import spring
from support.project import ROOT, URDF

DUAL = ROOT / "tests" / "data" / "dual_arm.urdf"
FUNCTIONS = ("energy", "wrench", "task_stiffness", "torque", "joint_stiffness", "linearization")
REMOTE = 0.1, -0.2, 0.3
LOCAL = re.compile(r"^\s*const (?:double|lanes) (\w+) =", re.MULTILINE)


def printed(
    chain: stiffgen.Chain, variant: Variant, placement: Placement, functions: tuple[str, ...] = FUNCTIONS
) -> Iterator[tuple[Kernel, CFunction]]:
    groups = tuple(f"{spring(kind).name}.{name}" for kind in KINDS for name in functions)
    yield from print_kernels(
        chain, "arm", variant, KernelOptions(springs=KINDS, placement=placement, kernels=groups)
    ).kernels


def check(kernel: Kernel, function: CFunction) -> None:
    locals_ = LOCAL.findall("\n".join(function.lines))
    assert [name for name in locals_ if re.fullmatch(r"t\d+", name)] == [], kernel.qualified_name
    assert len(locals_) == len(set(locals_)), kernel.qualified_name


@pytest.mark.parametrize("variant", [SINGLE, BATCH, CUDA])
def test_no_quantity_of_a_spring_is_numbered(variant: Variant) -> None:
    """Print the springs: each local has a name, not a number."""
    chain = stiffgen.load_chain(URDF)
    seen = 0
    for kernel, function in printed(chain, variant, Placement()):
        if kernel.group and kernel.group.startswith("spring"):
            check(kernel, function)
            seen += 1
    assert seen == len(KINDS) * len(FUNCTIONS)


@pytest.mark.parametrize("placement", [Placement("tip", "base", REMOTE), Placement("equilibrium", "tip", REMOTE)])
def test_nor_with_other_axes_and_a_shifted_centre(placement: Placement) -> None:
    for kernel, function in printed(stiffgen.load_chain(URDF), SINGLE, placement, ("task_stiffness",)):
        if kernel.group and kernel.group.startswith("spring"):
            check(kernel, function)


@pytest.mark.slow
def test_nor_of_several_tips() -> None:
    """Print the totals of two tips: no local is declared twice."""
    chain = stiffgen.load_chain(DUAL, tip=["left hand", "right-hand"])
    totals = [pair for pair in printed(chain, SINGLE, Placement()) if pair[0].name.endswith("_total")]
    assert len(totals) == 4 * len(KINDS)
    for kernel, function in totals:
        locals_ = LOCAL.findall("\n".join(function.lines))
        assert len(locals_) == len(set(locals_)), kernel.qualified_name


SYMBOLS = re.findall(
    r"\w+",
    "e f D G W Y L P E eta eps g dg ddg h k form n m hess Z KT sigma Kl Ks Kd N M "
    "Vt kappat softt rhot Vo kappao softo rhoo Ft bentt Fo bento",
)


def test_every_symbol_has_a_comment() -> None:
    """Look up each named quantity of a spring in the C: a comment above defines it."""
    text = [line for _, function in printed(stiffgen.load_chain(URDF), SINGLE, Placement()) for line in function.lines]
    comments = " ".join(line for line in text if line.lstrip().startswith("/*"))
    found = LOCAL.findall("\n".join(text))
    for symbol in SYMBOLS:
        assert any(re.fullmatch(symbol + r"\d*", name) for name in found), symbol
        assert re.search(rf"\b{symbol}\b", comments), symbol
