# SPDX-License-Identifier: MIT
"""NAME.jax: the functions under jit, vmap and grad, on XLA's own buffers.

tests/families/jax/test_jax.py runs this file in its own process, because JAX's threads do not survive the
forks of other tests.
"""

from __future__ import annotations

import shutil
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from stiffgen.core.opened import open_robot
from stiffgen.core.verify.kernels.samples import argument_samples
from support.wrappers import cases, floating_robot, small_robot, wrapper

COUNT = 3


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return small_robot(tmp_path_factory.mktemp("jax"), "rp")


@pytest.fixture
def double():
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


@pytest.fixture
def arm(small, double):
    return wrapper(small, "jax")


@pytest.fixture(scope="module")
def walker(tmp_path_factory):
    return floating_robot(tmp_path_factory.mktemp("walker"))


def gradients(robot, framework):
    """Yield the functions that are gradients: path, function of the wrapper, arguments and results of NumPy's."""
    pool = argument_samples(robot.chain, COUNT, 11, robot.springs)
    for kernel in (each for each in robot.table if each.is_gradient):
        functions = []
        for module in (wrapper(robot, framework), robot.module):
            for part in (*kernel.path, kernel.name):
                module = getattr(module, part)
            functions.append(module)
        given = [pool[argument] for argument in kernel.arguments]
        yield kernel.name, functions[0], given, functions[1](*given)


def listed(results):
    return list(results) if isinstance(results, tuple) else [results]


def assert_transposed(case, gradients):
    """Fail unless the Jacobian-vector product is the transpose of the vector-Jacobian product."""
    tangents = [np.random.default_rng(3).normal(size=np.shape(each)) for each in case.arguments]
    _, changes = jax.jvp(case.function, tuple(case.arguments), tuple(tangents))
    forward = sum((c * change).sum() for c, change in zip(case.cotangents, listed(changes), strict=True))
    terms = [gradient * tangent for gradient, tangent in zip(gradients, tangents, strict=True)]
    scale = sum(np.abs(term).sum() for term in terms)
    assert abs(forward - sum(term.sum() for term in terms)) <= 1e-12 * scale, case.path


@pytest.mark.parametrize("robot", ["small", pytest.param("walker", marks=pytest.mark.wide)])
def test_gradients_have_values_and_no_derivatives(robot, request, double):
    """Functions that are gradients are not left out; their derivative is refused by a sentence."""
    seen = set()
    for name, function, given, expected in gradients(request.getfixturevalue(robot), "jax"):
        for found in (function(*given), jax.jit(jax.vmap(function))(*given)):
            np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max(), err_msg=name)
        with pytest.raises(NotImplementedError, match=f"{name}.. is a gradient and has no derivative"):
            jax.grad(lambda q, *others, f=function: f(q, *others).sum())(*(each[0] for each in given))
        seen.add(name)
    assert seen == {"manipulability_gradient", "stiffness_direction_gradient"}


def pulled_back(case, given, cotangents):
    results, back = jax.vjp(case.function, *given)
    return back(results.__class__(cotangents) if isinstance(results, tuple) else cotangents[0])


def close(found, expected, path):
    assert len(found) == len(expected), path
    for each, other in zip(found, expected, strict=True):
        assert isinstance(each, jax.Array) and each.dtype == np.float64
        np.testing.assert_allclose(each, other, rtol=1e-12, atol=1e-12 * np.abs(other).max(initial=0), err_msg=path)


@pytest.mark.parametrize(("robot", "step"), [("small", 1), pytest.param("walker", 3, marks=pytest.mark.wide)])
def test_values_and_gradients_are_those_of_numpy(robot, step, request, double):
    """Compare each function (of the walker each third) with NumPy: a stack, and gradients of each third one.

    One program has all of them. The first function of each signature also by itself, with vmap over all or one
    argument; of each third of these, forward mode.
    """
    robot = request.getfixturevalue(robot)
    every = list(cases(robot, wrapper(robot, "jax"), COUNT))[::step]

    @jax.jit
    def together(stacks, cotangents):
        values = [listed(case.function(*given)) for case, given in zip(every, stacks, strict=True)]
        third = zip(every[::3], stacks[::3], cotangents[::3], strict=True)
        return values, [pulled_back(*each) for each in third]

    values, gradients = together([case.arguments for case in every], [case.cotangents for case in every])
    for case, found in zip(every, values, strict=True):
        close(found, case.results, case.path)
    for case, found in zip(every[::3], gradients, strict=True):
        close(found, case.of_wrapper(), case.path)
    seen = set()
    for case in every:
        signature = tuple(tuple(np.shape(each) for each in stack) for stack in (case.arguments, case.results))
        if signature in seen:
            continue
        seen.add(signature)
        for found in (case.function(*case.arguments), jax.jit(jax.vmap(case.function))(*case.arguments)):
            close(listed(found), case.results, case.path)
        gradients = pulled_back(case, case.arguments, case.cotangents)
        close(gradients, case.of_wrapper(), case.path)
        if len(seen) % 3 == 1:  # forward mode takes as long as all others together
            assert_transposed(case, gradients)
        first, *others = case.arguments
        shared = [each[0] for each in others]
        alone = jax.vmap(case.function, (0, *[None] * len(shared)))(first, *shared)
        for each, expected in zip(listed(alone), listed(case.function(first, *shared)), strict=True):
            close([each], [expected], case.path)


def test_gradients_are_differences(small, arm):
    """Through a matrix made symmetric, batched and shared arguments: against JAX's own differences."""
    random = np.random.default_rng(2)
    n = small.chain.dof
    q, wrench, stiffness = random.uniform(-1, 1, (4, n)), random.normal(size=6), random.normal(size=(2, 1, 6, 6))

    def loss(q, wrench, stiffness):
        return jnp.sin(arm.hybrid.joint_stiffness(q, wrench, (stiffness + stiffness.mT) / 2)).sum()

    check_grads(loss, (q, wrench, stiffness), order=1, modes=["rev"], atol=1e-6, rtol=1e-6)
    one_by_one = jax.vmap(jax.grad(loss, (0, 1, 2)), (0, None, None))(q, wrench, stiffness[0, 0])
    for k in range(len(q)):
        alone = jax.grad(loss, (0, 1, 2))(q[k], wrench, stiffness[0, 0])
        for found, expected in zip(one_by_one, alone, strict=True):
            np.testing.assert_allclose(found[k], expected, rtol=1e-11, atol=1e-11)


@pytest.mark.wide(instead="test_gradients_are_differences")
def test_gradients_through_the_bases_pose(walker, double):
    """Differentiate through a base pose that stays a pose: JAX's own differences, for stiffnesses of both tips."""
    random = np.random.default_rng(5)
    functions, n = wrapper(walker, "jax"), len(walker.chain.coordinates)
    x, q, equilibria = random.normal(size=(3, 6)), random.uniform(-1, 1, n), np.stack(2 * [np.eye(4)])
    Kt, Ko = np.stack(2 * [np.diag([300.0, 200, 400])]), np.stack(2 * [np.diag([20.0, 10, 30])])

    def loss(x, q):
        v, (a, b, c) = x[:3], x[3:]  # the base's pose from six free numbers
        turn = jnp.array([[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]])
        pose = jnp.block([[jax.scipy.linalg.expm(turn), v[:, None]], [jnp.array([[0.0, 0, 0, 1]])]])
        stiffness = functions.spring.joint_stiffness_total(pose, q, equilibria, Kt, Ko)
        return jnp.sin(stiffness / 100).sum() + jnp.sin(functions.left.hybrid.jacobian(pose, q)).sum()

    for each in x:
        check_grads(loss, (each, q), order=1, modes=["rev"], atol=1e-6, rtol=1e-6)
    together = jax.vmap(jax.grad(loss), (0, None))(x, q)
    for found, each in zip(together, x, strict=True):
        np.testing.assert_allclose(found, jax.grad(loss)(each, q), rtol=1e-10, atol=1e-10)


def test_nested_vmap_shares_what_is_not_mapped(small, arm):
    """Strides of several batch dimensions, in every order and with values shared along some."""
    random = np.random.default_rng(3)
    n, numpys = small.chain.dof, small.module.hybrid.joint_stiffness
    q, wrench, K = random.uniform(-1, 1, (5, n)), random.normal(size=(4, 6)), random.normal(size=(3, 6, 6))
    every = jax.vmap(jax.vmap(jax.vmap(arm.hybrid.joint_stiffness, (0, None, None)), (None, 0, None)), (None, None, 0))
    np.testing.assert_allclose(every(q, wrench, K), numpys(q, wrench[:, None], K[:, None, None]), rtol=1e-12, atol=1e-9)
    mixed = jax.vmap(jax.vmap(arm.hybrid.joint_stiffness, (0, None, None)), (None, 0, 0))
    np.testing.assert_allclose(mixed(q, wrench[:3], K), numpys(q, wrench[:3, None], K[:, None]), rtol=1e-12, atol=1e-9)
    np.testing.assert_array_equal(
        arm.hybrid.joint_stiffness(q[:, None], wrench, K[0]), mixed(q, wrench, np.stack([K[0]] * 4)).swapaxes(0, 1)
    )
    assert arm.hybrid.joint_stiffness(q[:0], wrench[0], K[0]).shape == (0, n, n)


def test_nothing_is_copied(small, arm):
    """XLA's program for a batch with shared arguments is the call and nothing else: no copy, transpose or broadcast."""
    n = small.chain.dof
    shapes = [jax.ShapeDtypeStruct(shape, jnp.float64) for shape in ((1000, n), (6,), (6, 6))]
    text = jax.jit(arm.hybrid.joint_stiffness).lower(*shapes).compile().as_text()
    steps = [line.split(" = ")[1].split()[1].split("(")[0] for line in text.splitlines() if " = " in line]
    allowed = {"parameter", "bitcast", "custom-call", "get-tuple-element", "tuple"}
    assert set(steps) <= allowed, text
    assert steps.count("custom-call") == 1


def test_errors_name_the_thing(small):
    """Call with a wrong type, shape, name or leading dimensions: each error names the function and what to do."""
    arm = wrapper(small, "jax")
    q = np.zeros(small.chain.dof)
    with pytest.raises(TypeError, match=r'float64.*jax\.config\.update\("jax_enable_x64", True\)'):
        arm.hybrid.jacobian(q)
    jax.config.update("jax_enable_x64", True)
    try:
        with pytest.raises(ValueError, match=r"hybrid\.jacobian\(\): q has the shape \(\d,\), expected \(\.\.\., \d\)"):
            arm.hybrid.jacobian(q[:-1])
        with pytest.raises(TypeError, match="'wrench'; its arguments are q, wrench, task_stiffness"):
            arm.hybrid.joint_stiffness(q, task_stiffness=np.eye(6))
        with pytest.raises(ValueError, match=r"leading dimensions \(2,\), \(3,\), \(1,\) do not broadcast"):
            arm.hybrid.joint_stiffness(np.zeros((2, len(q))), np.zeros((3, 6)), np.eye(6))
    finally:
        jax.config.update("jax_enable_x64", False)


def test_numpy_users_load_neither(small):
    """Import the package alone: no framework is loaded; without compiled calls the import says what to do."""
    program = f"""
import sys
sys.path.insert(0, {str(small.folder.parent)!r})
import arm
assert not {{"jax", "jaxlib", "torch"}} & set(sys.modules)
"""
    subprocess.run([sys.executable, "-c", program], check=True)


def test_forward_mode_is_the_derivative(small, arm):
    """Compute the Jacobian in forward mode under jit and vmap: its differences; second derivatives are refused."""
    n = small.chain.dof
    q, wrench, stiffness = np.linspace(-1, 1, 2 * n).reshape(2, n), np.arange(1.0, 7), np.diag([700.0] * 3 + [30] * 3)

    def matrix(q):
        return arm.hybrid.joint_stiffness(q, wrench, stiffness)

    step = 1e-5
    found = jax.jit(jax.vmap(jax.jacfwd(matrix)))(q)
    for k, unit in enumerate(np.eye(n)):
        difference = (matrix(q + step * unit) - matrix(q - step * unit)) / (2 * step)
        np.testing.assert_allclose(found[..., k], difference, atol=1e-5 * np.abs(found).max())
    for second in (jax.hessian, lambda f: jax.jacfwd(jax.jacfwd(f)), lambda f: jax.jacrev(jax.jacrev(f))):
        with pytest.raises(NotImplementedError, match=r"hybrid\.joint_stiffness\(\) has first derivatives only"):
            second(lambda q: matrix(q).sum())(q[0])


def test_a_gradient_runs_the_product_alone(small, arm):
    """Reverse mode costs the function and one product; the code of forward mode is not run."""
    loss = jax.grad(lambda q: arm.hybrid.joint_stiffness(q, np.ones(6), np.eye(6)).sum())
    text = jax.jit(loss).lower(jax.ShapeDtypeStruct((small.chain.dof,), jnp.float64)).compile().as_text()
    assert text.count(" custom-call(") == 1, text


def test_calls_are_compiled_when_they_are_missing(small, tmp_path, monkeypatch):
    """Take the compiled calls away, as if JAX came later: they are compiled, or the import says what to do."""
    folder = tmp_path / "arm"
    shutil.copytree(small.folder, folder, ignore=shutil.ignore_patterns("arm_jax.*o", "arm_jax.pyd"))
    with monkeypatch.context() as patched:
        patched.setenv("CC", str(tmp_path / "absent"))
        with pytest.raises(ImportError, match=r"absent' .*install jax .* 'stiffgen generate --derivatives'"):
            wrapper(open_robot(folder), "jax")
    q = np.linspace(-1, 1, small.chain.dof)
    jax.config.update("jax_enable_x64", True)
    try:
        found = wrapper(open_robot(folder), "jax").hybrid.jacobian(q)
        np.testing.assert_allclose(found, small.module.hybrid.jacobian(q), rtol=1e-12, atol=1e-12)
    finally:
        jax.config.update("jax_enable_x64", False)


def test_a_second_copy_in_the_process(small, arm, tmp_path):
    """XLA takes a name once a process; both copies compute the same."""
    copy = tmp_path / "elsewhere" / "arm"
    shutil.copytree(small.folder, copy)
    q = np.linspace(-1, 1, 2 * small.chain.dof).reshape(2, -1)
    expected = small.module.hybrid.jacobian(q)
    for module in (arm, wrapper(open_robot(copy), "jax"), arm):
        np.testing.assert_allclose(module.hybrid.jacobian(q), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.wide(instead="test_a_second_copy_in_the_process")
def test_two_robots_of_one_name_in_the_process(small, arm, tmp_path):
    """Load two robots of one name: each calls its own functions."""
    other = small_robot(tmp_path, "rpm")
    second = wrapper(other, "jax")
    for robot, module in ((small, arm), (other, second), (small, arm)):
        q = np.linspace(-1, 1, robot.chain.dof)
        np.testing.assert_allclose(module.hybrid.jacobian(q), robot.module.hybrid.jacobian(q), rtol=1e-12, atol=1e-12)
        pulled = jax.vjp(module.forward_kinematics, q)[1](np.eye(4))[0]
        expected = robot.kernels["forward_kinematics_vjp"](q, np.eye(4))
        np.testing.assert_allclose(pulled, np.ravel(expected), rtol=1e-12, atol=1e-12)
