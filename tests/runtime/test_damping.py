"""Eigensolver and damping designs of the C runtime against SciPy's eigh and NumPy references."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import scipy.linalg

from support.runtime import WARNINGS, Runtime, compile_c, pencils, residual, symmetric, write_source

ERRORS = {"size": -1, "not_finite": -2, "mass": -3, "not_symmetric": -4, "ratio": -6}


@pytest.fixture(scope="module")
def runtime(tmp_path_factory: pytest.TempPathFactory) -> Runtime:
    return Runtime(tmp_path_factory.mktemp("runtime"))


def test_generalised_eigenproblem_against_scipy(runtime: Runtime) -> None:
    worst = worst_value = worst_basis = 0.0
    for K, M in pencils(1, 1200):
        code, values, vectors = runtime.eigen_generalised(K, M)
        assert code == 0, runtime.text(code)
        assert np.all(np.diff(values) >= 0)
        reference = scipy.linalg.eigh(K, M, eigvals_only=True)
        worst = np.maximum(worst, residual(K, M, values, vectors))  # max() would lose a NaN
        worst_value = np.maximum(worst_value, np.abs(values - reference).max() / max(np.abs(reference).max(), 1e-300))
        worst_basis = np.maximum(worst_basis, np.abs(vectors.T @ M @ vectors - np.eye(len(K))).max())
    assert worst <= 1e-12
    assert worst_value <= 1e-11
    assert worst_basis <= 1e-11


def test_symmetric_eigenproblem_against_numpy(runtime: Runtime) -> None:
    for K, _ in pencils(2, 300):
        code, values, vectors = runtime.eigen_symmetric(K)
        assert code == 0
        scale = max(np.abs(K).max(), 1e-300)
        np.testing.assert_allclose(values, np.linalg.eigvalsh(K), atol=1e-13 * len(K) * scale)
        assert residual(K, np.eye(len(K)), values, vectors) <= 1e-13
        assert np.abs(vectors.T @ vectors - np.eye(len(K))).max() <= 1e-13


def test_closed_form_of_two_joints(runtime: Runtime) -> None:
    K, M = np.array([[2.0, 1.0], [1.0, 2.0]]), np.eye(2)
    _, values, vectors = runtime.eigen_symmetric(K)
    np.testing.assert_allclose(values, [1, 3], rtol=1e-15)
    np.testing.assert_allclose(np.abs(vectors), np.full((2, 2), np.sqrt(0.5)), rtol=1e-15)
    _, damping, _ = runtime.damping_modal(K, M, np.array([0.5, 1.0]))
    expected = 1.0 * np.array([[0.5, -0.5], [-0.5, 0.5]]) + 2 * np.sqrt(3) * np.array([[0.5, 0.5], [0.5, 0.5]])
    np.testing.assert_allclose(damping, expected, rtol=1e-14)


def test_sizes_of_the_entries_do_not_matter(runtime: Runtime) -> None:
    """Squares of the entries would overflow or vanish; powers of two change nothing but the exponent."""
    random = np.random.default_rng(3)
    K, M = symmetric(random, random.normal(size=7)), symmetric(random, random.uniform(0.5, 2, size=7))
    _, values, _ = runtime.eigen_generalised(K, M)
    for power in (-600, -60, 60, 600):
        code, scaled, _ = runtime.eigen_generalised(K * 2.0**power, M)
        assert code == 0
        np.testing.assert_allclose(scaled / 2.0**power, values, rtol=1e-15)


def test_modal_damping_has_the_designed_ratio(runtime: Runtime) -> None:
    """In modal coordinates B is diagonal, 2 zeta sqrt(lambda); nothing where the stiffness is not positive."""
    random = np.random.default_rng(4)
    worst = 0.0
    for K, M in pencils(4, 600):
        n = len(K)
        ratio = random.uniform(0, 1.5, size=n)
        code, B, values = runtime.damping_modal(K, M, ratio)
        assert code == 0
        assert np.array_equal(B, B.T)
        reference, V = scipy.linalg.eigh(K, M)
        positive = np.sqrt(np.maximum(reference, 0))
        # Modes that nearly coincide share their ratio: their order is rounding.
        if np.min(np.diff(reference), initial=np.inf) < 1e-6 * np.abs(reference).max():
            ratio[:] = ratio[0]
            _, B, values = runtime.damping_modal(K, M, ratio)
        modal = V.T @ B @ V
        scale = max(np.sqrt(np.abs(reference).max()), 1e-300)
        worst = np.maximum(worst, np.abs(modal - np.diag(2 * ratio * positive)).max() / scale)
        np.testing.assert_allclose(values, reference, atol=1e-11 * np.abs(reference).max())
    # sqrt turns a rounding of 1e-17 in a zero eigenvalue into 3e-9 of the largest.
    assert worst <= 1e-7


def test_modal_ratio_to_1e9_where_the_stiffness_is_positive(runtime: Runtime) -> None:
    """The symmetric form of the bar: M^-1/2 B M^-1/2 = 2 zeta (M^-1/2 K M^-1/2)^1/2."""
    random = np.random.default_rng(5)
    for _ in range(400):
        n = int(random.integers(1, 33))
        K = symmetric(random, 10 ** random.uniform(0, 3, size=n))
        M = symmetric(random, 10 ** random.uniform(-2, 1, size=n))
        _, B, _ = runtime.damping_modal(K, M, np.full(n, 0.7))
        half = np.asarray(scipy.linalg.fractional_matrix_power(M, -0.5))
        form = half @ K @ half
        modal, W = np.linalg.eigh((form + form.T) / 2)
        reached = W.T @ half @ B @ half @ W / (2 * np.sqrt(np.outer(modal, modal)) ** 0.5)
        assert np.abs(reached - 0.7 * np.eye(n)).max() <= 1e-9


def test_indefinite_stiffness_damps_the_positive_part_and_reports(runtime: Runtime) -> None:
    random = np.random.default_rng(6)
    K = symmetric(random, np.array([-50.0, -2.0, 3.0, 40.0, 500.0]))
    M = symmetric(random, np.array([0.1, 0.4, 1.0, 2.0, 5.0]))
    code, B, values = runtime.damping_modal(K, M, np.ones(5))
    assert code == 0
    assert values[0] < 0 and (values < 0).sum() == 2
    V = scipy.linalg.eigh(K, M)[1]
    modal = V.T @ B @ V
    assert np.abs(modal[:2]).max() <= 1e-12 * modal.max()
    assert np.linalg.eigvalsh(B).min() >= -1e-13 * np.abs(B).max()


def test_factorised_design(runtime: Runtime) -> None:
    random = np.random.default_rng(7)
    for K, M in pencils(8, 200):
        n = len(K)
        ratio = random.uniform(0, 1, size=n)
        code, B = runtime.damping_factorised(K, M, ratio)
        assert code == 0
        values, Q = np.linalg.eigh(K)
        K1 = Q @ np.diag(np.sqrt(np.maximum(values, 0))) @ Q.T
        M1 = np.asarray(scipy.linalg.sqrtm(M)).real
        reference = M1 @ np.diag(ratio) @ K1 + K1 @ np.diag(ratio) @ M1
        # Where K is singular the root of a rounding error stands in both.
        scale = np.sqrt(np.abs(K).max() * np.abs(M).max())
        np.testing.assert_allclose(B, reference, atol=3e-7 * max(scale, 1e-300))
        assert np.array_equal(B, B.T)


def test_factorised_design_equals_modal_for_commuting_matrices(runtime: Runtime) -> None:
    random = np.random.default_rng(9)
    Q = np.linalg.qr(random.normal(size=(6, 6)))[0]
    K, M = (Q @ np.diag(random.uniform(1, 9, size=6)) @ Q.T for _ in range(2))
    K, M = (K + K.T) / 2, (M + M.T) / 2
    ratio = np.full(6, 0.6)
    np.testing.assert_allclose(
        runtime.damping_factorised(K, M, ratio)[1], runtime.damping_modal(K, M, ratio)[1], rtol=1e-11, atol=1e-12
    )


def test_task_damping(runtime: Runtime) -> None:
    random = np.random.default_rng(10)
    for n in (1, 6, 7, 32):
        J, B = random.normal(size=(6, n)), symmetric(random, random.uniform(0, 40, size=6))
        code, result = runtime.damping_task(J, B, 0.1)
        assert code == 0
        np.testing.assert_allclose(result, J.T @ B @ J + 0.1 * np.eye(n), rtol=1e-12, atol=1e-12)
        assert np.array_equal(result, result.T)
        upper = np.triu(B) + np.tril(np.full((6, 6), np.nan), -1)
        assert np.array_equal(runtime.damping_task(J, upper, 0.1)[1], result)


def test_positive_part(runtime: Runtime) -> None:
    for K, M in pencils(11, 120):
        values, V = scipy.linalg.eigh(K, M)
        W = M @ V
        code, result, found = runtime.positive_part(K, M)
        assert code == 0
        np.testing.assert_allclose(found, values, atol=1e-11 * np.abs(values).max())
        scale = np.abs(K).max() * np.linalg.cond(M) + 1e-300
        np.testing.assert_allclose(result, W @ np.diag(np.maximum(values, 0)) @ W.T, atol=1e-12 * scale)
        plain, Q = np.linalg.eigh(K)
        result = runtime.positive_part(K)[1]
        np.testing.assert_allclose(result, Q @ np.diag(np.maximum(plain, 0)) @ Q.T, atol=1e-12 * scale)
    A = symmetric(np.random.default_rng(12), np.array([1.0, 2.0, 3.0]))
    assert np.array_equal(runtime.positive_part(A)[1], A)


def test_nullspace_stiffness_is_dynamically_consistent(runtime: Runtime) -> None:
    random = np.random.default_rng(13)
    for n in (7, 9, 32):
        J, M = random.normal(size=(6, n)), symmetric(random, 10 ** random.uniform(-1, 1, size=n))
        code, K, smallest = runtime.nullspace_stiffness(J, M, 3.0, 1e-6)
        assert code == 0 and smallest > 1e-6
        inverse = np.linalg.inv(M)
        N = np.eye(n) - J.T @ np.linalg.inv(J @ inverse @ J.T) @ J @ inverse
        np.testing.assert_allclose(K, 3.0 * N @ N.T, atol=1e-11 * np.abs(K).max())
        assert np.abs(J @ inverse @ K).max() <= 1e-11 * np.abs(K).max() * np.abs(inverse).max()
        assert np.array_equal(K, K.T)


def test_nullspace_stiffness_of_a_chain_without_redundancy_is_zero(runtime: Runtime) -> None:
    random = np.random.default_rng(14)
    for n in (1, 3, 6):
        M = symmetric(random, random.uniform(1, 2, size=n))
        code, K, _ = runtime.nullspace_stiffness(random.normal(size=(6, n)), M, 3.0, 1e-6)
        assert code == 0
        assert np.abs(K).max() <= 1e-18 + 1e-12


def test_nullspace_stiffness_near_a_singularity(runtime: Runtime) -> None:
    """Finite, bounded and continuous through a rank loss; the lost direction joins the nullspace."""
    random = np.random.default_rng(15)
    J, M = random.normal(size=(6, 7)), np.eye(7)
    lost = J[5].copy()
    values = []
    for t in np.linspace(-1e-2, 1e-2, 2001):
        J[5] = t * lost + J[4]  # rows 4 and 5 become parallel
        code, K, smallest = runtime.nullspace_stiffness(J, M, 1.0, 1e-3)
        assert code == 0
        assert np.linalg.eigvalsh(K)[-1] <= 1 + 1e-9
        values.append((smallest, K.copy()))
    assert min(value[0] for value in values) < 1e-12
    middle = values[1000][1]
    assert np.trace(middle) == pytest.approx(2.0, abs=1e-9)  # one free direction, and the lost one
    steps = [np.abs(b[1] - a[1]).max() for a, b in itertools.pairwise(values)]
    assert max(steps) < 0.05
    planar = J.copy()
    planar[[2, 3, 4]] = 0.0  # directions in which a planar chain cannot move
    code, K, smallest = runtime.nullspace_stiffness(planar, M, 1.0, 1e-3)
    assert code == 0 and smallest > 0
    assert np.trace(K) == pytest.approx(7 - 3, rel=1e-6)


def test_errors(runtime: Runtime) -> None:
    eye = np.eye(3)
    for bad in (np.nan, np.inf, -np.inf):
        K = eye.copy()
        K[1, 1] = bad
        assert runtime.damping_modal(K, eye, np.ones(3))[0] == ERRORS["not_finite"]
        assert runtime.damping_modal(eye, K, np.ones(3))[0] == ERRORS["not_finite"]
        assert runtime.damping_factorised(K, eye, np.ones(3))[0] == ERRORS["not_finite"]
        assert runtime.eigen_symmetric(K)[0] == ERRORS["not_finite"]
        assert runtime.damping_modal(eye, eye, np.array([1, bad, 1]))[0] == ERRORS["ratio"]
        assert runtime.nullspace_stiffness(np.full((6, 3), bad), eye, 1.0, 1e-3)[0] == ERRORS["not_finite"]
    assert runtime.damping_modal(eye, eye, np.array([1, -1e-9, 1]))[0] == ERRORS["ratio"]
    skew = eye.copy()
    skew[0, 1] = 1e-6
    assert runtime.damping_modal(skew, eye, np.ones(3))[0] == ERRORS["not_symmetric"]
    for mass in (np.diag([1.0, 0.0, 1.0]), np.diag([1.0, -1.0, 1.0]), np.ones((3, 3)), np.zeros((3, 3))):
        assert runtime.damping_modal(eye, mass, np.ones(3))[0] == ERRORS["mass"]
        assert runtime.damping_factorised(eye, mass, np.ones(3))[0] == ERRORS["mass"]
        assert runtime.nullspace_stiffness(np.ones((6, 3)), mass, 1.0, 1e-3)[0] == ERRORS["mass"]
    big = np.eye(33)
    assert runtime.eigen_symmetric(big)[0] == ERRORS["size"]
    assert runtime.call("eigen_symmetric", 0, eye, np.ones(3), eye.copy(), np.ones(36)) == ERRORS["size"]
    texts = {runtime.text(code) for code in (*range(-6, 1), -10, -11, *range(-49, -19))}
    assert len(texts) == 7 + 2 + 30
    assert "unknown error" not in texts
    assert runtime.text(12345) == "unknown error"


def test_task_stiffness_check(runtime: Runtime) -> None:
    K = np.diag([700.0, 700, 800, 30, 30, 30])
    assert runtime.call("is_positive_semidefinite6", K)
    assert runtime.call("is_positive_semidefinite6", np.zeros((6, 6)))
    assert runtime.call("is_positive_semidefinite6", np.diag([700.0, 0, 0, 0, 0, 0]))
    random = np.random.default_rng(16)
    for value, good in ((1e-3, True), (-1e-3, False)):
        assert runtime.call("is_positive_semidefinite6", symmetric(random, np.array([value, 1, 2, 3, 4, 5]))) == good
    for bad in (np.nan, np.inf):
        K[2, 3] = K[3, 2] = bad
        assert not runtime.call("is_positive_semidefinite6", K)
    K[2, 3], K[3, 2] = 1.0, 1.001
    assert not runtime.call("is_positive_semidefinite6", K)


@pytest.mark.parametrize("compiler", ["gcc", "clang", "g++", "clang++"])
def test_compiles_without_warnings(compiler: str, tmp_path) -> None:
    language = ("-x", "c++") if compiler.endswith("++") else ("-std=c99",)
    source = write_source(tmp_path)
    compile_c(tmp_path / "x.o", *language, *WARNINGS, "-Wno-unused-function", "-O2", "-c", source, compiler=compiler)
