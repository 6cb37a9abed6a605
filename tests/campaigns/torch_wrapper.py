# SPDX-License-Identifier: MIT
"""NAME.torch: the functions as operators of PyTorch, by ``make campaign NAME=torch``; PyTorch is too large for CI."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from support.wrappers import cases, floating_robot, small_robot, wrapper

COUNT = 3


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return small_robot(tmp_path_factory.mktemp("torch"))


@pytest.fixture(scope="module")
def walker(tmp_path_factory):
    return floating_robot(tmp_path_factory.mktemp("walker"))


@pytest.fixture(scope="module")
def arm(small):
    return wrapper(small, "torch")


def listed(results):
    return list(results) if isinstance(results, tuple) else [results]


def assert_close(found, expected, path):
    expected = np.asarray(expected)
    scale = 1e-12 * np.abs(expected).max(initial=0)
    np.testing.assert_allclose(found.detach().numpy(), expected, rtol=1e-12, atol=scale, err_msg=path)


@pytest.mark.parametrize("robot", ["small", "walker"])
def test_values_and_gradients_are_those_of_numpy(robot, request):
    """Compare each function with NumPy: a stack, vmap over all, and vmap over the first argument alone."""
    robot = request.getfixturevalue(robot)
    for case in cases(robot, wrapper(robot, "torch"), COUNT):
        given = [torch.tensor(each, requires_grad=True) for each in case.arguments]
        results = listed(case.function(*given))
        for found, expected in zip(results, case.results, strict=True):
            assert_close(found, expected, case.path)
        cotangents = [torch.tensor(each) for each in case.cotangents]
        for found, expected in zip(torch.autograd.grad(results, given, cotangents), case.of_wrapper(), strict=True):
            assert_close(found, expected, case.path)
        for found, expected in zip(listed(torch.vmap(case.function)(*given)), case.results, strict=True):
            assert_close(found, expected, case.path)
        first, *others = given
        shared = [each[0] for each in others]
        alone = torch.vmap(case.function, (0, *[None] * len(shared)))(first, *shared)
        for found, expected in zip(listed(alone), listed(case.function(first, *shared)), strict=True):
            assert_close(found, expected.detach().numpy(), case.path)


@pytest.mark.filterwarnings("ignore:`torch.jit.script` is deprecated:FutureWarning")
def test_forward_mode_is_the_transpose_of_reverse_mode(small, arm):
    """Compare forward with reverse mode under vmap, for one and several results; second derivatives are refused."""
    q = torch.linspace(-1, 1, 2 * small.chain.dof, dtype=torch.float64).reshape(2, -1)
    eye = torch.eye(6, dtype=torch.float64)
    pose, three = torch.eye(4, dtype=torch.float64), eye[:3, :3]
    functions = (
        lambda q: arm.hybrid.joint_stiffness(q, eye.sum(0), eye),
        lambda q: torch.cat([each.flatten() for each in arm.spring.linearization(q, pose, three, three)]),
    )
    for function in functions:
        forward, reverse = (torch.func.vmap(mode(function))(q) for mode in (torch.func.jacfwd, torch.func.jacrev))
        assert torch.allclose(forward, reverse, rtol=1e-12, atol=1e-12)
        with pytest.raises(NotImplementedError, match=r"\(\) has first derivatives only"):
            torch.func.jacfwd(torch.func.jacfwd(function))(q[0])
    # a number per state has no entries to sum over
    most = torch.full((small.chain.dof,), 0.8, dtype=torch.float64)
    zone = torch.tensor(0.5, dtype=torch.float64)
    forward, reverse = (
        mode(lambda zone: arm.limits.energy(q[0], -most, most, zone, most))(zone)
        for mode in (torch.func.jacfwd, torch.func.jacrev)
    )
    assert forward == reverse != 0


# PyTorch 2.15's check reads .grad of a copy; its way to hide the warning is too late where a warning is an error.
@pytest.mark.filterwarnings("ignore:The .grad attribute of a Tensor that is not a leaf:UserWarning")
def test_opcheck(small, arm):
    """PyTorch's own checks of every operator and of its product: schema, autograd, fake tensors, compilation."""
    for case in cases(small, arm, COUNT):
        name = case.path.replace(".", "_")
        given = [torch.tensor(each, requires_grad=True) for each in case.arguments]
        torch.library.opcheck(getattr(torch.ops.arm, name).default, given)
        fixed = [torch.tensor(each) for each in (*case.arguments, *case.cotangents)]
        torch.library.opcheck(getattr(torch.ops.arm, f"{name}_vjp").default, fixed)


def test_gradcheck(small, arm):
    """Every function against PyTorch's differences."""
    for case in cases(small, arm, COUNT):
        given = [torch.tensor(each[0], requires_grad=True) for each in case.arguments]
        size = max(float(np.abs(each).max(initial=0)) for each in case.gradients)
        tolerance = 1e-5 * max(1.0, size)
        assert torch.autograd.gradcheck(case.function, given, eps=1e-6, atol=tolerance, rtol=1e-5), case.path


def test_gradients_through_the_bases_pose(walker):
    """Differentiate through a base pose that stays a pose: PyTorch's differences."""
    functions, n = wrapper(walker, "torch"), len(walker.chain.coordinates)
    random = torch.Generator().manual_seed(2)
    x = torch.randn((3, 6), generator=random, dtype=torch.float64, requires_grad=True)
    q = torch.randn(n, generator=random, dtype=torch.float64, requires_grad=True)

    def jacobians(x, q):
        zero = torch.zeros_like(x[:, 0])
        a, b, c = x[:, 3], x[:, 4], x[:, 5]
        turn = torch.stack([zero, -c, b, c, zero, -a, -b, a, zero], -1).reshape(-1, 3, 3)
        below = torch.tensor([0.0, 0, 0, 1], dtype=torch.float64).expand(len(x), 1, 4)
        pose = torch.cat([torch.cat([torch.linalg.matrix_exp(turn), x[:, :3, None]], 2), below], 1)
        return functions.left.hybrid.jacobian(pose, q), functions.right.spatial.jacobian(pose, q)

    assert torch.autograd.gradcheck(jacobians, (x, q))


def test_gradient_of_shared_arguments_is_summed(small, arm):
    """Differentiate with arguments shared by several states: gradients are summed over the states."""
    n = small.chain.dof
    random = torch.Generator().manual_seed(1)
    q = torch.randn((4, n), generator=random, dtype=torch.float64, requires_grad=True)
    wrench = torch.randn(6, generator=random, dtype=torch.float64, requires_grad=True)
    stiffness = torch.randn((2, 1, 6, 6), generator=random, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda q, wrench, K: arm.hybrid.joint_stiffness(q, wrench, (K + K.mT) / 2), (q, wrench, stiffness)
    )
    per_state = torch.func.vmap(
        torch.func.grad(lambda q, F, K: arm.hybrid.joint_stiffness(q, F, K).sin().sum(), (0, 1, 2)), (0, None, None)
    )(q.detach(), wrench.detach(), stiffness.detach()[0, 0])
    assert [tuple(each.shape) for each in per_state] == [(4, n), (4, 6), (4, 6, 6)]


def test_memory_is_shared(small, arm, monkeypatch):
    """Call with tensors: the compiled function reads their own memory and writes into the results'."""
    seen = []
    compiled = arm._c.hybrid_joint_stiffness

    def recorded(*given, out):
        seen[:] = [array.ctypes.data for array in (*given, *out)]
        return compiled(*given, out=out)

    monkeypatch.setattr(arm, "_c", SimpleNamespace(hybrid_recorded=recorded))
    function = next(each for each in arm.namespaces.__globals__["FUNCTIONS"] if each.path == "hybrid.joint_stiffness")
    operator = arm._operator(replace(function, path="hybrid.recorded"))
    q = torch.zeros((10, small.chain.dof), dtype=torch.float64)
    wrench, stiffness = torch.ones((1, 6), dtype=torch.float64), torch.eye(6, dtype=torch.float64)[None]
    result = operator(q, wrench, stiffness)
    assert seen == [tensor.data_ptr() for tensor in (q, wrench, stiffness, result)]


def test_compiles(small, arm):
    """Under torch.compile's tracing the operators stay whole."""
    n = small.chain.dof
    function = torch.compile(lambda q: torch.ops.arm.hybrid_jacobian(q) * 2, backend="eager", fullgraph=True)
    q = torch.linspace(-1, 1, n, dtype=torch.float64)
    assert_close(function(q), 2 * small.module.hybrid.jacobian(q.numpy()), "hybrid.jacobian")


def test_other_types_and_errors(small, arm):
    """Call with float32, which is converted, and with wrong shapes or counts, whose errors name the argument."""
    n = small.chain.dof
    single = torch.zeros(n, dtype=torch.float32, requires_grad=True)
    arm.hybrid.jacobian(single).sum().backward()
    assert single.grad is not None
    assert single.grad.dtype == torch.float32
    with pytest.raises(TypeError, match=r"hybrid\.jacobian\(\): q is torch\.float32"):
        torch.ops.arm.hybrid_jacobian(single)
    with pytest.raises(ValueError, match=r"q has the shape \(\d,\), expected"):
        arm.hybrid.jacobian(torch.zeros(n - 1))
    with pytest.raises(TypeError, match="its arguments are q, wrench, task_stiffness"):
        arm.hybrid.joint_stiffness(torch.zeros(n), torch.zeros(6))
