# SPDX-License-Identifier: MIT
"""NaN or infinity in: NaN in every entry that depends on it, and never another number elsewhere."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest

import stiffgen
from stiffgen import open_robot
from stiffgen.core.symbolic.kernels import KERNELS
from stiffgen.core.symbolic.model import casadi_function
from stiffgen.core.verify.kernels.not_finite import STACK, check_not_finite
from stiffgen.core.verify.kernels.samples import Samples, argument_samples
from stiffgen.core.verify.result import as_results
from support.chains import chain_urdf, replaced
from support.project import kernels_of


@cache
def dependence(chain, kernel, index):
    """Which entries of the results depend on which entries of an argument, from the expression graph."""
    function = casadi_function(chain, kernel)
    symbols = [ca.SX.sym(f"x{k}", *function.sparsity_in(k).shape) for k in range(function.n_in())]
    row_major = ca.vertcat(*(ca.vec(each.T) for each in as_results(function(*symbols))))
    pattern = ca.jacobian_sparsity(row_major, ca.vec(symbols[index].T))
    return np.array(ca.DM(pattern, 1)) != 0


def flat(value):
    return np.concatenate([np.ravel(each) for each in as_results(value)])


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda kernel: kernel.qualified_name)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_every_dependent_entry_is_nan(kernel, value, chain, robot):
    """Spoil one entry of one argument: exactly the entries of the result that depend on it become NaN."""
    samples = Samples(chain, 1, seed=2)
    arguments = [samples[argument][0] for argument in kernel.arguments]
    ufunc = kernels_of(robot, chain)[kernel.qualified_name]
    clean = flat(ufunc(*arguments))
    for index, argument in enumerate(arguments):
        depends = dependence(chain, kernel, index)  # (entries of the result, entries of the argument), bool
        for entry in range(argument.size):
            spoiled = [np.array(a) for a in arguments]
            spoiled[index].flat[entry] = value
            with np.errstate(invalid="ignore"):
                found = flat(ufunc(*spoiled))
            assert np.isnan(found[depends[:, entry]]).all()
            others = found[~depends[:, entry]]
            assert (np.isnan(others) | (others == clean[~depends[:, entry]])).all()


def test_zeros_do_not_hide_a_nan(robot):
    """Let NaN meet exact zeros of the Jacobian and of other arguments: it is not hidden."""
    K = np.zeros((6, 6))
    for value in (np.nan, np.inf):
        with np.errstate(invalid="ignore"):
            wrench = np.zeros(6)
            wrench[2] = value
            assert np.isnan(robot.hybrid.joint_stiffness(np.zeros(7), wrench, K)).all()
            K[0, 0] = value
            assert np.isnan(robot.hybrid.joint_stiffness(np.zeros(7), np.zeros(6), K)).all()
            K[0, 0] = 0


@pytest.mark.usefixtures("unoptimised")
def test_an_infinite_slide_is_nan(tmp_path):
    """Make a sliding coordinate infinite, which enters linearly: the results are NaN, not infinite."""
    urdf = tmp_path / "slide.urdf"
    urdf.write_text(
        '<robot name="slide"><link name="a"/><link name="b"/><link name="c"/>'
        '<joint name="s" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="1 0 0"/></joint>'
        '<joint name="t" type="continuous"><parent link="b"/><child link="c"/><axis xyz="0 0 1"/></joint></robot>'
    )
    slide = open_robot(stiffgen.generate(urdf, output=tmp_path, kernels="spatial", controller=False)).module
    with np.errstate(invalid="ignore"):
        assert np.isnan(slide.forward_kinematics([np.inf, 0])[0, 3])
        assert np.isnan(slide.spatial.jacobian([-np.inf, 0])[1, 1])
    assert slide.forward_kinematics([2.0, 0])[0, 3] == 2.0


OTHERS = ("rotation_vector", "quaternion", "coupled", "bounded")


@pytest.mark.usefixtures("unoptimised")
def test_what_overflows_is_nan(tmp_path):
    check_overflow("rpr", ("quaternion",), tmp_path)


@pytest.mark.slow
@pytest.mark.usefixtures("unoptimised")
@pytest.mark.parametrize("types", ["rpr", *(pytest.param(types, marks=pytest.mark.wide) for types in ("prpm", "rrm"))])
def test_what_overflows_is_nan_with_every_spring(types, tmp_path):
    check_overflow(types, OTHERS, tmp_path)


def check_overflow(types, springs, tmp_path):
    """Fail if a result is infinite, however large the arguments of slides, mimic joints and springs are."""
    urdf = tmp_path / "chain.urdf"
    urdf.write_text(chain_urdf(types))
    opened = open_robot(stiffgen.generate(urdf, output=tmp_path, springs=springs, controller=False))
    pool = argument_samples(opened.chain, STACK, 4, opened.springs)
    failed = [check for check in check_not_finite(opened.kernels, opened.table, pool) if not check.passed]
    assert failed == []


@pytest.mark.slow
@pytest.mark.usefixtures("unoptimised")
def test_what_overflows_is_nan_with_two_tips(tmp_path):
    """Sums over tips, and a tool given at run time."""
    branch = (
        '<link name="side"/><joint name="aside" type="prismatic"><parent link="upper"/><child link="side"/>'
        '<axis xyz="0 1 0"/><limit lower="0" upper="1" effort="5" velocity="1"/></joint></robot>'
    )
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(replaced(("</robot>", branch)))
    options = {"tip": ["finger", "side"], "runtime_tool": True, "controller": False}
    folder = stiffgen.generate(urdf, output=tmp_path, **options)
    opened = open_robot(folder)
    pool = argument_samples(opened.chain, STACK, 4, opened.springs)
    failed = [check for check in check_not_finite(opened.kernels, opened.table, pool) if not check.passed]
    assert failed == []
