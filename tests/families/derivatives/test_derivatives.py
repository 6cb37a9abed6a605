# SPDX-License-Identifier: MIT
"""Vector-Jacobian products in C, batches and CUDA."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

import stiffgen
from stiffgen.core.emit.render import render
from stiffgen.core.opened import open_robot
from stiffgen.core.options import GenerationOptions
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.model import casadi_function, folded
from stiffgen.core.verify.kernels.samples import argument_samples
from stiffgen.core.verify.result import BOUND, as_results, relative_error
from stiffgen.core.verify.verify import verify
from support.chains import chain_urdf
from support.cuda_host import HostCuda
from support.exact_tree import tree_urdf
from support.generated_c import merged

OPTIONS = KernelOptions(derivatives=True)


CASES = {"arm": {}, "walker": {"tip": ["left", "right"], "floating_base": True}}
"""Three joints, one sliding and one that mimics; and four joints with two tips on a floating base."""
FEWER = {
    "arm": {
        "kernels": (
            "hybrid.jacobian",
            "hybrid.kinematic_stiffness",
            "hybrid.joint_stiffness",
            "spring.energy",
            "spring.joint_stiffness",
            "limits.torque",
            "mass_matrix",
            "bias_forces",
            "gravity.gradient",
            "manipulability",
        )
    },
    "walker": {"kernels": ("body", "mass_matrix", "gravity")},
}
"""Kernels of every kind; single calls of all of them: test_casadi.py. Of the walker, what has base or tips."""


def urdf_of(case, folder):
    file = folder / "robot.urdf"
    file.write_text(chain_urdf("rpm") if case == "arm" else tree_urdf(3, joints=4))
    return file


@pytest.fixture
def urdf(tmp_path):
    return urdf_of("arm", tmp_path)


def expected(chain, kernel, pool, count):
    """Results of the CasADi function, one array a result, for the first states of the pool."""
    function = casadi_function(chain, kernel)
    folds = [folded(a.array(chain).shape) for a in kernel.arguments]
    rows = []
    for c in range(count):
        one = [pool[a][c].reshape(f) for a, f in zip(kernel.arguments, folds, strict=True)]
        rows.append([np.asarray(each).ravel() for each in as_results(function(*one))])
    return [np.stack(each) for each in zip(*rows, strict=True)]


def test_default_folder_knows_nothing_of_it(urdf):
    texts = render(stiffgen.load_chain(urdf), "arm", GenerationOptions(controller=False))
    public = [text for name, text in texts.items() if not name.endswith(".c")]
    assert len(public) > 8 and not any("vjp" in text for text in public)  # in C: steps of gradients
    assert "derivatives" not in json.loads(texts["manifest.json"])


@pytest.mark.slow
@pytest.mark.usefixtures("unoptimised", "narrowest_width")
@pytest.mark.parametrize(
    ("case", "fewer"),
    [("arm", True), *(pytest.param(*each, marks=pytest.mark.wide) for each in (("arm", False), ("walker", True)))],
)
def test_folder_is_verified(case, fewer, tmp_path, monkeypatch):
    """Against differences and CasADi, with NaN, stacks of every length and the bounds of memory; reopened as it was.

    The frameworks have a test of their own: tests/lab/languages/test_languages.py.
    """
    if fewer:
        monkeypatch.setattr("stiffgen.lab.languages.check.check_wrappers", lambda material: [])
    chosen = {"derivatives": True, "controller": False, **CASES[case], **(FEWER[case] if fewer else {})}
    folder = stiffgen.generate(urdf_of(case, tmp_path), output=tmp_path, name=case, **chosen)
    robot = open_robot(folder)
    assert robot.springs.derivatives
    functions = [kernel for kernel in robot.table if not kernel.is_gradient]
    assert sum(kernel.name.endswith("_vjp") for kernel in functions) * 2 == len(functions)
    assert [check for check in verify(folder, count=5) if not check.passed] == []


@pytest.mark.slow
def test_copies_of_entries_have_names_of_their_own(tmp_path):
    """Print a matrix of eleven columns: entries (1, 11) and (11, 1) have two names."""
    urdf = tmp_path / "chain.urdf"
    urdf.write_text(chain_urdf("r" * 12))
    options = GenerationOptions(derivatives=True, controller=False, kernels=("hybrid", "mass_matrix"))
    source = merged(render(stiffgen.load_chain(urdf), "arm", options), "arm")["arm.c"]
    for body in re.split(r"\n}\n", source):
        outermost = re.findall(r"^    const \w+ (\w+) = ", body, re.MULTILINE)
        assert len(outermost) == len(set(outermost))


@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=pytest.mark.slow if case == "arm" else pytest.mark.wide) for case in CASES]
)
def test_cuda_on_the_host(case, tmp_path):
    """Cotangents lie with each configuration; gradients come back whole."""
    chain = stiffgen.load_chain(urdf_of(case, tmp_path), **CASES[case])
    few = {"derivatives": True, "kernels": ("hybrid", "mass_matrix", "spring.linearization", "gravity.gradient")}
    options = KernelOptions(**few)
    texts = render(chain, "arm", GenerationOptions(cuda=True, controller=False, **few))
    for name in ("arm.cu", "arm_cuda.h"):
        (tmp_path / name).write_text(texts[name])
    host = HostCuda(tmp_path / "arm.cu", "arm", chain, tmp_path, options=options)
    count = 5
    pool = argument_samples(chain, count, 3, options)
    for name, kernel in host.kernels.items():
        if not name.endswith("_vjp"):
            continue
        own = {a: len(a.shape) == 1 or a.per_configuration or a.varying for a in kernel.arguments}
        shared = {a: np.broadcast_to(pool[a][0], pool[a].shape) for a in kernel.arguments if not own[a]}
        wanted = expected(chain, kernel, {**pool, **shared}, count)
        given = [pool[a][:count] if own[a] else pool[a][0] for a in kernel.arguments]
        for found, each in zip(as_results(host(name, *given, spare=2)), wanted, strict=True):
            assert relative_error(found.reshape(count, -1), each) <= BOUND, name
