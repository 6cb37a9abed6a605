"""Every single entry of dJ^T/dq matters: perturb each one and see the suite's checks fail.

The checks are those of ``stiffgen verify`` (:func:`stiffgen.verify.check_kernels`), run on the compiled kernels
with one entry of the derivative falsified, and all that is made from it: the contraction, and the joint stiffness
put together the way the generated code does it, one half computed and mirrored. It stays symmetric throughout.
"""

from __future__ import annotations

import itertools
import re

import numpy as np
import pytest

from c_program import run_kernels
from stiffgen.connection import REPRESENTATIONS
from stiffgen.verify import References, check_kernels, gamma_F, kernels_of, relative_error

PERTURBATION = 1e-6


@pytest.fixture(scope="module")
def references(chain):
    return References(chain, count=2, seed=11)


def memoised(kernels):
    """The unfalsified kernels see the same inputs 294 times over."""
    cache = {}

    def wrap(name, function):
        def call(*arguments):
            key = (name, *(np.asarray(a).tobytes() for a in arguments))
            if key not in cache:
                cache[key] = function(*arguments)
            return cache[key]

        return call

    return {name: wrap(name, function) for name, function in kernels.items()}


def falsified(kernels, rep, entry):
    """The kernels with dJ^T/dq off at one entry (i, b, k)."""
    i, b, k = entry
    derivative, jacobian = kernels[f"{rep}_jacobian_transpose_derivative"], kernels[f"{rep}_jacobian"]

    def wrong_derivative(q):
        value = np.array(derivative(q))
        value[..., i, b, k] += PERTURBATION
        return value

    def kinematic(q, wrench):
        return np.einsum("sibk,sk->sbi", wrong_derivative(q), wrench)

    def uncorrected(q, wrench, K):
        J = jacobian(q)
        return kinematic(q, wrench) + np.swapaxes(J, 1, 2) @ K @ J

    def stiffness(q, wrench, K):
        full = uncorrected(q, wrench, K + gamma_F(rep, wrench))
        half = np.triu(full) if rep != "body" else np.tril(full)
        return half + np.swapaxes(half, 1, 2) - np.eye(full.shape[-1]) * full

    return kernels | {
        f"{rep}_jacobian_transpose_derivative": wrong_derivative,
        f"{rep}_kinematic_stiffness": kinematic,
        f"{rep}_joint_stiffness_uncorrected": uncorrected,
        f"{rep}_joint_stiffness": stiffness,
    }


def failures(checks):
    return {(check.kernel, check.oracle) for check in checks if not check.passed}


@pytest.mark.parametrize("rep", REPRESENTATIONS)
def test_no_entry_can_be_wrong_unnoticed(rep, chain, robot, references):
    kernels = memoised(kernels_of(robot, chain))
    assert failures(check_kernels(kernels, references)) == set()
    n, missed, blind = chain.dof, [], 0
    for entry in itertools.product(range(n), range(n), range(6)):
        found = failures(check_kernels(falsified(kernels, rep, entry), references))
        i, b, _ = entry
        expected = {
            (f"{rep}_jacobian_transpose_derivative", "differentiated Jacobian"),
            (f"{rep}_kinematic_stiffness", "differentiated Jacobian . F"),
            (f"{rep}_joint_stiffness_uncorrected", "formula on differentiated Jacobian"),
        }
        read = b <= i if rep != "body" else b >= i  # entry [b, i] of the stiffness: the half that is computed
        if read:
            expected.add((f"{rep}_joint_stiffness", "formula on differentiated Jacobian"))
            if rep != "spatial":
                expected.add((f"{rep}_joint_stiffness", "Hessian of a potential"))
        if not expected <= found:
            missed.append((entry, expected - found))
        if (f"{rep}_joint_stiffness", "bitwise symmetry") not in found:
            blind += 1
    assert missed == []
    assert blind == n * n * 6  # symmetry alone would have caught none of them


OPERATOR = re.compile(r" ([-+]) (?![^\[]*\])")


def sign_mutants(source, rep):
    """The C source with one + or - of the representation's kernels exchanged, for every one of them."""
    inside = False
    offset = 0
    for line in source.splitlines(keepends=True):
        if re.match(rf"void iiwa14_{rep}_(?!\w+_batch)", line):
            inside = True
        elif line.startswith("}"):
            inside = False
        if inside and not line.lstrip().startswith(("/*", "for", "void")):
            for match in OPERATOR.finditer(line):
                at = offset + match.start(1)
                yield line.strip(), source[:at] + ("-" if match[1] == "+" else "+") + source[at + 1 :]
        offset += len(line)


@pytest.mark.parametrize("rep", REPRESENTATIONS)
def test_no_sign_in_the_generated_c_can_be_wrong(rep, golden, robot_folder, tmp_path):
    """Exchange one sign of the printed kernels at a time, compile, and compare with the golden values."""
    samples = golden[:2]
    general = np.random.default_rng(4).normal(size=(6, 6)) * 100
    calls, expected = [], []
    for sample in samples:
        values = sample.by[rep]
        J = values["jacobian"]
        conventional = values["kinematic_stiffness"] + J.T @ general @ J
        for name, arguments, value in (
            ("kinematic_stiffness", (sample.q, sample.wrench), values["kinematic_stiffness"]),
            ("connection_correction", (sample.wrench,), values["gamma_F"]),
            ("joint_stiffness", (sample.q, sample.wrench, sample.task_stiffness), values["joint_stiffness"]),
            ("joint_stiffness_uncorrected", (sample.q, sample.wrench, general), conventional),
        ):
            calls.append((f"{rep}_{name}", arguments, 49 if value.shape == (7, 7) else 36))
            expected.append(value)
        calls.append((f"{rep}_jacobian_transpose_derivative", (sample.q,), 294))
        expected.append((values["kinematic_stiffness"], sample.wrench))

    def agrees(found, wanted):
        if isinstance(wanted, tuple):
            wanted, wrench = wanted
            found = np.einsum("ibk,k->bi", found.reshape(7, 7, 6), wrench)
        return relative_error(found.reshape(1, *wanted.shape), wanted[None]) <= 1e-12

    def passes(source):
        mutant = tmp_path / "mutant"
        mutant.mkdir(exist_ok=True)
        (mutant / "iiwa14.h").write_text((robot_folder / "iiwa14.h").read_text())
        (mutant / "iiwa14.c").write_text(source)
        found = run_kernels(mutant, "iiwa14", calls, "cc", "c99", ["-O0"], tmp_path)
        return all(agrees(f, w) for f, w in zip(found, expected, strict=True))

    source = (robot_folder / "iiwa14.c").read_text()
    assert passes(source)
    mutants = list(sign_mutants(source, rep))
    assert len(mutants) > 50
    assert [line for line, mutant in mutants if passes(mutant)] == []
