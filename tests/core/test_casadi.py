# SPDX-License-Identifier: MIT
"""NAME.casadi: compiled functions and their derivatives as CasADi sees them, against the graph of StiffnessModel."""

from __future__ import annotations

import ctypes
import importlib
import re
import shutil
import subprocess
import sys

import casadi as ca
import numpy as np
import pytest

import stiffgen
from stiffgen.core.opened import open_robot
from stiffgen.core.symbolic.model import matrix_shape
from stiffgen.core.verify.kernels.samples import argument_samples
from support.c_program import STRICT
from support.project import require_compiler, require_program
from support.wrappers import floating_robot, small_robot, wrapper

COUNT, SEED = 3, 11


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return small_robot(tmp_path_factory.mktemp("casadi"))


@pytest.fixture(scope="module")
def arm(small):
    return wrapper(small, "casadi")


@pytest.fixture(scope="module", params=["small", pytest.param("walker", marks=pytest.mark.wide)])
def robot(request, tmp_path_factory):
    """A chain with a base that stands, and a tree with one that floats."""
    if request.param == "small":
        return request.getfixturevalue("small")
    return floating_robot(tmp_path_factory.mktemp("walker"))


@pytest.fixture(scope="module")
def pairs(robot):
    """Yield each function with a gradient: its name, compiled and as a graph, arguments and cotangents."""
    model = stiffgen.StiffnessModel(robot.chain)
    samples = argument_samples(robot.chain, COUNT, SEED, robot.springs)  # by argument, COUNT values each
    namespace = wrapper(robot, "casadi")
    table = {kernel.qualified_name: kernel for kernel in robot.table}
    found = []
    for name, kernel in table.items():
        gradient = table.get(f"{name}_vjp")
        if gradient is None:
            continue
        compiled, graph = namespace, model
        for part in (*kernel.path, kernel.name):
            compiled, graph = getattr(compiled, part), getattr(graph, part)
        states = []
        for k in range(COUNT):
            # the gradient takes the function's arguments, then the cotangents of its results
            values = [samples[argument][k] for argument in gradient.arguments]
            matrices = [value.reshape(matrix_shape(value.shape)) for value in values]
            given, cotangents = matrices[: graph.n_in()], matrices[graph.n_in() :]
            states.append((given, cotangents))
        found.append((name, compiled, graph, states))
    assert len(found) > 20  # else most functions would have lost their gradients
    return found


def side_by_side(gradients, count):
    """Gradients of several cotangents, as CasADi stacks them, with a column for each."""
    return np.hstack([each.reshape(-1, 1, order="F") for each in np.split(np.array(gradients), count, axis=1)])


def of_motions(function, i, given, gradients):
    """Gradients (entries, count) by argument i, entries column by column; those by the base's pose along motions.

    Of a pose only motions mean something: the graph differentiates by entries as if they were free.
    """
    if function.name_in(i) != "base_pose":
        return gradients
    motions = []  # of the pose along the six unit twists of the body
    for k in range(6):
        twist = np.zeros((4, 4))
        if k < 3:
            twist[k, 3] = 1.0
        else:
            a, b = (k - 2) % 3, (k - 1) % 3  # axes that turn about axis k - 3
            twist[b, a], twist[a, b] = 1.0, -1.0
        motions.append((given[i] @ twist).ravel(order="F"))
    return np.array(motions) @ gradients


def each_close(found, expected, name):
    assert len(found) == len(expected)
    for a, b in zip(found, expected, strict=True):
        a, b = np.array(a), np.array(b)
        assert a.shape == b.shape
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12 * max(1.0, np.abs(b).max(initial=0)), err_msg=name)


def test_signature_and_values(robot, pairs):
    for name, compiled, graph, states in pairs:
        assert compiled.name() == f"{robot.name}_casadi_{name}"
        assert (compiled.name_in(), compiled.name_out()) == (graph.name_in(), graph.name_out())
        assert [compiled.size_in(i) for i in range(graph.n_in())] == [graph.size_in(i) for i in range(graph.n_in())]
        for given, _ in states:
            each_close(compiled.call(given), graph.call(given), name)


def test_gradients_have_values_and_no_derivatives(robot):
    """Functions that are gradients are not left out; CasADi refuses to differentiate them."""
    model, namespace, seen = stiffgen.StiffnessModel(robot.chain), wrapper(robot, "casadi"), set()
    pool = argument_samples(robot.chain, COUNT, SEED, robot.springs)
    for kernel in robot.table:
        if not kernel.is_gradient:
            continue
        compiled, graph = namespace, model
        for part in (*kernel.path, kernel.name):
            compiled, graph = getattr(compiled, part), getattr(graph, part)
        for k in range(COUNT):
            given = [pool[argument][k].reshape(matrix_shape(pool[argument][k].shape)) for argument in kernel.arguments]
            each_close(compiled.call(given), graph.call(given), kernel.qualified_name)
        with pytest.raises(RuntimeError, match=r"[Dd]erivative"):
            compiled.jacobian()
        seen.add(kernel.name)
    assert seen == {"manipulability_gradient", "stiffness_direction_gradient"}


def test_derivatives(pairs):
    """Ask CasADi for one product, three at once, and all derivatives: none is its own, by differences."""
    for name, compiled, graph, states in pairs:
        for given, cotangents in states:
            results = [np.zeros(graph.size_out(k)) for k in range(graph.n_out())]
            for count in (1, 3):
                seeds = [np.hstack([(k + 1.0) * each for k in range(count)]) for each in cotangents]
                operands = [*given, *results, *seeds]
                found, expected = (
                    [
                        of_motions(graph, i, given, side_by_side(each, count))
                        for i, each in enumerate(function.reverse(count).call(operands))
                    ]
                    for function in (compiled, graph)
                )
                each_close(found, expected, name)
            operands = [*given, *results]
            found, expected = (
                [
                    of_motions(graph, k % graph.n_in(), given, np.array(each).T)
                    for k, each in enumerate(function.jacobian().call(operands))
                ]
                for function in (compiled, graph)
            )
            each_close(found, expected, name)


def test_inside_a_graph(small, arm):
    """Chain rule through expressions, constants and what CasADi leaves out because it is zero."""
    n = small.chain.dof
    graph = stiffgen.StiffnessModel(small.chain).hybrid.joint_stiffness
    q, root = ca.MX.sym("q", n), ca.MX.sym("root", 6, 6)
    gradients = []
    for function in (arm.hybrid.joint_stiffness, graph):
        stiffness = function(2 * q, ca.DM.zeros(6), root @ root.T)
        loss = ca.trace(ca.inv(stiffness + ca.DM.eye(n)))
        gradients.append(ca.Function("gradient", [q, root], [loss, ca.gradient(loss, q), ca.gradient(loss, root)]))
    random = np.random.default_rng(5)
    at = (random.uniform(-1, 1, n), random.normal(size=(6, 6)))
    each_close(gradients[0].call(at), gradients[1].call(at), "trace of the inverse")


def test_solver(small, arm):
    """Find again, by IPOPT through Opti, the posture whose stiffness is a wanted one."""
    n = small.chain.dof
    K = np.diag([700.0, 700, 800, 30, 30, 30])  # [N/m], [N m/rad]
    wrench = np.array([1.0, 2, -3, 0.1, 0.2, -0.3])  # [N], [N m]
    there = np.full(n, 0.4)
    wanted = small.module.hybrid.joint_stiffness(there, wrench, K)
    opti = ca.Opti()
    q = opti.variable(n)
    opti.minimize(ca.sumsqr((arm.hybrid.joint_stiffness(q, wrench, K) - wanted) / np.abs(wanted).max()))
    opti.set_initial(q, there + 0.1)
    quiet = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-12}
    opti.solver("ipopt", {**quiet, "ipopt.hessian_approximation": "limited-memory"})
    found = small.module.hybrid.joint_stiffness(np.array(opti.solve().value(q)), wrench, K)
    np.testing.assert_allclose(found, wanted, atol=1e-4 * np.abs(wanted).max())


def test_symbols_carry_the_name(small):
    """CasADi's prefixes adj1_ and jac_ stand before the robot's; nothing else is exported, no inner call."""
    library = small.folder / "python" / "arm_casadi.so"
    listed = subprocess.run(["nm", "-D", "--defined-only", library], capture_output=True, text=True, check=True).stdout
    symbols = [line.split()[-1] for line in listed.splitlines()]
    assert "jac_arm_casadi_hybrid_joint_stiffness" in symbols
    strange = [symbol for symbol in symbols if not re.match(r"(adj1_|jac_)?arm_", symbol)]
    assert set(strange) <= {"_init", "_fini"}
    assert not [symbol for symbol in symbols if symbol.endswith("_call") or symbol == "arm_casadi_jacobian"]
    inner = subprocess.run(["nm", library], capture_output=True, text=True, check=True).stdout
    assert "arm_mass_matrix_call" in inner


@pytest.mark.parametrize("part", ["casadi", "calls"])
@pytest.mark.parametrize("compiler", ["gcc", pytest.param("clang", marks=pytest.mark.wide)])
def test_source_is_free_of_warnings(small, compiler, part, tmp_path):
    require_compiler(compiler)
    source = small.folder / "python" / f"arm_{part}.c"
    subprocess.run([compiler, "-std=c99", "-O1", *STRICT, "-c", source, "-o", tmp_path / "object.o"], check=True)


def test_is_called_as_the_interface_says(small):
    """Call from C as CasADi does: arguments left out are zero, results not wanted are not written."""
    library = ctypes.CDLL(str(small.folder / "python" / "arm_casadi.so"))
    n, pointers = small.chain.dof, ctypes.POINTER(ctypes.c_double)
    call = library.jac_arm_casadi_hybrid_joint_stiffness
    sizes = [ctypes.c_longlong() for _ in range(4)]
    assert library.jac_arm_casadi_hybrid_joint_stiffness_work(*map(ctypes.byref, sizes)) == 0
    space = np.full(sizes[3].value + 8, 7.0)
    q, by_q = np.full(n, 0.3), np.zeros((n, n * n))
    take = lambda array: array.ctypes.data_as(pointers)  # noqa: E731
    arguments, results = (pointers * 4)(take(q)), (pointers * 3)(take(by_q))
    assert call(arguments, results, None, take(space), 0) == 0
    assert np.all(space[-8:] == 7.0)
    np.testing.assert_array_equal(by_q, 0.0)  # no stiffness, no load
    stiffness = np.eye(6)
    arguments[2] = take(stiffness)
    assert call(arguments, results, None, take(space), 0) == 0
    assert np.abs(by_q).max() > 0.1
    assert np.all(space[-8:] == 7.0)


def test_left_out_library_is_said(small, tmp_path):
    folder = tmp_path / "arm"
    shutil.copytree(small.folder, folder, ignore=shutil.ignore_patterns("arm_casadi.*"))
    with pytest.raises(ImportError, match=r"not compiled; run 'stiffgen generate --derivatives'"):
        wrapper(open_robot(folder), "casadi")


def test_package_does_not_load_casadi(small):
    program = (
        f"import sys; sys.path.insert(0, {str(small.folder.parent)!r}); import arm; assert 'casadi' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
    assert importlib.import_module(f"{small.module.__name__}.casadi").__doc__


@pytest.mark.slow
def test_built_by_cmake(small, arm, tmp_path):
    """Build the libraries by themselves, for users without the package."""
    require_program("cmake", "cmake")
    options = ["-DARM_CASADI=ON", "-DARM_JAX=ON", f"-DPython_EXECUTABLE={sys.executable}"]
    options += [f"-DARM_PYTHON_DIR={tmp_path}", "-DARM_DISPATCH=OFF", "-DCMAKE_BUILD_TYPE=Debug"]
    for command in (["-S", small.folder, "-B", tmp_path / "build", *options], ["--build", tmp_path / "build"]):
        done = subprocess.run(["cmake", *command], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    built = ca.external("arm_casadi_mass_matrix", str(tmp_path / "arm_casadi.so"))
    q = np.linspace(0.1, 0.5, small.chain.dof)
    each_close([built(q)], [arm.mass_matrix(q)], "mass_matrix")
    assert ctypes.CDLL(str(tmp_path / "arm_jax.so")).arm_jax_mass_matrix
