# SPDX-License-Identifier: MIT
"""Random valid robots agree with Pinocchio and with differentiation; random broken files are refused or read."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stiffgen.core.errors import StiffgenError
from stiffgen.core.loading import chain_between
from stiffgen.core.robot.chain import Chain, ChainOptions
from stiffgen.core.robot.reader import read_description
from stiffgen.core.robot.selection import select
from stiffgen.core.symbolic.kernels import KERNELS
from stiffgen.core.symbolic.model import casadi_function
from stiffgen.core.verify.kernels.oracles import check_kernels
from stiffgen.core.verify.kernels.references import References
from stiffgen.core.verify.result import as_results
from support.chain_checks import disagreements
from support.pinocchio_oracle import PinocchioChain
from support.random_urdf import Plain, Robot, broken_files, random_robot, robots

FEW = settings(derandomize=True, deadline=None, suppress_health_check=list(HealthCheck))


@pytest.fixture(scope="module")
def file(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("random") / "robot.urdf"


def chain_of(robot: Robot, file: Path) -> Chain:
    file.write_text(robot.text, encoding="utf-8")
    return chain_between(read_description(file), ChainOptions(tip=robot.tip, base=robot.base))


@settings(FEW, max_examples=12)
@given(robot=robots(), seed=st.integers(0, 999))
def test_random_chains_agree_with_pinocchio(file, robot, seed):
    check_against_pinocchio(file, robot, seed)


@pytest.mark.wide(instead="test_random_chains_agree_with_pinocchio")
@settings(FEW, max_examples=30)
@given(robot=robots(), seed=st.integers(0, 999))
def test_more_random_chains_agree_with_pinocchio(file, robot, seed):
    check_against_pinocchio(file, robot, seed)


def check_against_pinocchio(file, robot, seed):
    chain = chain_of(robot, file)
    oracle = PinocchioChain(robot.text, robot.tip, robot.base)
    assert disagreements(chain, oracle, np.random.default_rng(seed), most=7) == {}


@settings(FEW, max_examples=100)
@given(data=broken_files(), leaf=st.integers(0, 9))
def test_broken_files_are_refused_or_read(file, data, leaf):
    """Read random broken files: a chain or a message with the file's name, never another exception."""
    file.write_bytes(data)
    try:
        description = read_description(file)
        chain_between(description, ChainOptions(tip=description.leaves[leaf % len(description.leaves)]))
    except StiffgenError as error:
        assert str(error).startswith("robot.urdf:")


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.wide) for seed in range(2, 6))])
def test_stiffness_against_differentiation(file, seed):
    """Verify the CasADi function of each kernel by the oracles of a generated folder."""
    chain = chain_of(random_robot(Plain(seed), 5), file)

    def over_samples(kernel):
        """Return the CasADi function of a kernel over samples, one after the other, as the compiled one takes them."""
        function, shapes = casadi_function(chain, kernel), [result.array(chain).shape for result in kernel.results]

        def stacks(*arguments):
            rows = [as_results(function(*each)) for each in zip(*arguments, strict=True)]
            stacked = [
                np.stack([np.asarray(one).reshape(shape) for one in column])
                for column, shape in zip(zip(*rows, strict=True), shapes, strict=True)
            ]
            return stacked[0] if len(stacked) == 1 else stacked

        return stacks

    kernels = {kernel.qualified_name: over_samples(kernel) for kernel in KERNELS}
    failed = [check for check in check_kernels(kernels, References(chain, 5, seed)) if not check.passed]
    assert failed == []


def test_the_generator_makes_every_kind_of_robot(file):
    """Prismatic, continuous, mimic, odd axes, base inside the tree, tip before the end, missing inertials."""
    seen = set()
    for seed in range(40):
        robot = random_robot(Plain(seed), 12)
        chain = chain_of(robot, file)
        seen |= {joint.type for joint in chain.joints}
        seen |= {"mimic"} if chain.coupled else set()
        seen |= (
            {"master off the chain"}
            if {c.name for c in chain.coordinates} - {j.name for j in chain.without_side_joints().joints}
            else set()
        )
        seen |= {"odd axis"} if any(0 < abs(v) < 1 for joint in chain.joints for v in joint.axis) else set()
        description = read_description(file)
        seen |= {"base inside"} if chain.base != description.root else set()
        seen |= {"tip inside"} if chain.tip not in description.leaves else set()
        seen |= {"massless"} if chain.massless else set()
        seen |= {"many"} if chain.dof > 8 else set()
    assert seen == {
        "revolute", "continuous", "prismatic", "mimic", "master off the chain", "odd axis", "base inside", "tip inside",
        "massless", "many",
    }  # fmt: skip


NAMES = re.compile(
    r"(?<=[< ])(axis|effort|inertia|ixx|limit|lower|mass|mimic|multiplier|offset|origin|rpy|type|upper|value|velocity"
    r"|xyz)"
    r"(?=[ =>])"
)
BREAKS = {  # what is broken, and by what
    "misspelt": (NAMES, lambda found: found[:-2] + found[:-3:-1]),
    "no number": (re.compile(r'(?<==)"-?[0-9.][^"]*"'), lambda found: '"x"'),
    "type": (re.compile(r'(?<=type=)"[a-z]+"'), lambda found: '"wheel"'),
    "mimic": (re.compile(r'(?<=<mimic joint=)"[^"]*"'), lambda found: '"ghost"'),
}


@pytest.mark.parametrize("kind", BREAKS)
def test_a_fault_refuses_the_chain_or_does_not_change_it(kind, file):
    """Whatever is broken in a sound robot: a chain that is given all the same is the sound one."""
    pattern, broken = BREAKS[kind]
    random = Plain(len(kind))
    refused = beside = 0
    for seed in range(60, 75):
        robot = random_robot(Plain(seed), 5)
        text, options = robot.text, ChainOptions(tip=robot.tip, base=robot.base)
        sound = chain_of(robot, file)
        for found in (random.pick(list(pattern.finditer(text))) for _ in range(3) if pattern.search(text)):
            file.write_text(text[: found.start()] + broken(found[0]) + text[found.end() :])
            try:
                description = read_description(file)
                selection, chain = select(description, options), chain_between(description, options)
            except StiffgenError:
                refused += 1
                continue
            beside += bool(selection.beside)
            assert replace(chain, digest="") == replace(sound, digest=""), (found, text)
    assert refused and (beside or kind == "mimic"), "a broken <mimic> might move the mass of any joint"
