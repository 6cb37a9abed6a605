# SPDX-License-Identifier: MIT
"""The Python module: generalised ufuncs with everything NumPy's users expect of them."""

from __future__ import annotations

import inspect
import pickle
import pydoc
import re
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import dask.array as da
import numpy as np
import pytest

from stiffgen.core.symbolic.arguments import Q
from stiffgen.core.symbolic.connection import REPRESENTATIONS
from stiffgen.core.symbolic.kernels import KERNELS
from stiffgen.core.verify.kernels.references import TASK_STIFFNESS, WRENCH
from stiffgen.core.verify.kernels.samples import Samples
from stiffgen.core.verify.result import as_results, relative_error
from support.project import kernels_of


@pytest.fixture(scope="module")
def samples(chain):
    return Samples(chain, 12, seed=21)


def arguments(kernel, samples):
    return [samples[argument] for argument in kernel.arguments]


RESULTS = [(kernel, index) for kernel in KERNELS for index in range(len(kernel.results))]
every_result = pytest.mark.parametrize(
    ("kernel", "index"), RESULTS, ids=[f"{kernel.qualified_name}-{index}" for kernel, index in RESULTS]
)


def result_of(kernel, index, chain, robot):
    """Return the kernel's ufunc as a function of one result."""
    ufunc = kernels_of(robot, chain)[kernel.qualified_name]
    if ufunc.nout == 1:
        return ufunc
    return lambda *given, out=None: ufunc(*given, out=tuple(out if k == index else None for k in range(ufunc.nout)))[
        index
    ]


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda kernel: kernel.qualified_name)
def test_signature_and_documentation(kernel, chain, robot):
    """Compare a function's signature, docstring and units with its record in the kernel table."""
    ufunc = kernels_of(robot, chain)[kernel.qualified_name]
    assert isinstance(ufunc, np.ufunc)
    assert ufunc.signature == kernel.signature(chain)
    assert kernel.summary in ufunc.__doc__
    assert kernel.equation.split(" (")[0].split(",")[0] in ufunc.__doc__
    for argument in (*kernel.arguments, *kernel.results):
        assert f"[{argument.unit}]" in ufunc.__doc__
    assert pickle.loads(pickle.dumps(ufunc)) is ufunc


def as_tuple(results):
    return results if isinstance(results, tuple) else (results,)


def same(one, other):
    return all(map(np.array_equal, as_tuple(one), as_tuple(other)))


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda kernel: kernel.qualified_name)
def test_arguments_by_name(kernel, chain, robot, samples):
    """Pass arguments by name in any order, beside NumPy's own keywords, for stacks and single calls."""
    ufunc = kernels_of(robot, chain)[kernel.qualified_name]
    stacks, names = arguments(kernel, samples), [argument.name for argument in kernel.arguments]
    expected = ufunc(*stacks)
    named = dict(zip(names, stacks, strict=True))
    for count in range(len(names)):
        rest = dict(reversed([(name, named[name]) for name in names[count:]]))
        out = tuple(map(np.empty_like, as_tuple(expected)))
        assert same(ufunc(*stacks[:count], **rest), expected)
        found = as_tuple(ufunc(*stacks[:count], out=out, casting="same_kind", **rest))
        assert all(one is other for one, other in zip(found, out, strict=True))
        assert same(out, as_tuple(expected))
    computed = {"".join(list(name)): array[0] for name, array in named.items()}  # names that are not interned
    assert same(ufunc(**computed), ufunc(*(array[0] for array in stacks)))
    assert list(inspect.signature(ufunc).parameters) == [*names, "out", "options"]
    assert ufunc.__doc__.startswith(f"{kernel.qualified_name}({', '.join(names)}, *, out=None, **options)\n\n")
    assert repr(samples[Q].dtype) and ufunc.__name__ == kernel.qualified_name


def test_wrong_names(robot, samples):
    """Missing, repeated and unknown names are errors that tell them, also among more names than there are arguments."""
    q, wrench, stiffness = samples[Q][0], samples[WRENCH][0], samples[TASK_STIFFNESS][0]
    function = robot.hybrid.joint_stiffness
    for call, words in (
        (
            lambda: function(q, wrnch=wrench, task_stiffness=stiffness),
            "lacks 'wrench'; its arguments are q, wrench, task",
        ),
        (lambda: function(q, wrench, q=q), "several values for 'q'"),
        (lambda: function(q, wrench, stiffness, wrench=wrench), "several values for 'wrench'"),
        (lambda: function(q, wrench, stiffness, wrnch=wrench), "unexpected keyword argument 'wrnch'"),
        (lambda: function(task_stiffness=stiffness), "lacks 'q'"),
        (lambda: function(q=q), "lacks 'wrench'"),
        (lambda: function(q, wrench, stiffness, **{f"x{k}": 1 for k in range(40)}), "unexpected keyword"),
        (lambda: function(q, **{f"x{k}": 1 for k in range(40)}, wrench=wrench, task_stiffness=stiffness), "argument"),
        (lambda: function(), "arguments"),
    ):
        with pytest.raises(TypeError, match=words):
            call()


def test_a_call_by_name_keeps_no_reference(robot, samples):
    """Call by names, and wrongly, 100 times: reference counts of all arrays stay."""
    q, wrench, stiffness = samples[Q][0].copy(), samples[WRENCH][0].copy(), samples[TASK_STIFFNESS][0].copy()
    out = np.empty((7, 7))
    before = [sys.getrefcount(array) for array in (q, wrench, stiffness, out)]
    for _ in range(100):
        robot.hybrid.joint_stiffness(q, task_stiffness=stiffness, out=out, wrench=wrench)
        with pytest.raises(TypeError):
            robot.hybrid.joint_stiffness(q, task_stiffness=stiffness, wrench=wrench, otu=out)
    assert [sys.getrefcount(array) for array in (q, wrench, stiffness, out)] == before


def test_help_is_for_a_reader(robot):
    """help() lists functions with their arguments and shapes, and nothing that Python adds to a module."""
    text = pydoc.plain(pydoc.render_doc(robot))
    for line in (
        "joint_stiffness(q, wrench, task_stiffness) -> (7, 7)",
        "body, spatial\n",
        "LOWER, UPPER, VELOCITY",
    ):
        assert line in text
    assert "joint_stiffness(q, wrench, task_stiffness)\n" in pydoc.plain(pydoc.render_doc(robot.hybrid))
    assert "SimpleNamespace" not in text
    assert "ndarray(shape" not in text and "__abs__" not in text  # the pages of arrays and of integers
    assert len(text.splitlines()) < 850  # six classes: Impedance, Follow, Policy, Settle, Press, PaperLaw
    assert repr(robot.hybrid).startswith("<iiwa14.hybrid: jacobian, ")
    assert set(vars(robot.hybrid)) == {kernel.name for kernel in KERNELS if kernel.group == "hybrid"}


PACKED = [kernel for kernel in KERNELS if kernel.batch and any(result.symmetric for result in kernel.results)]


@pytest.mark.parametrize("kernel", PACKED, ids=[kernel.qualified_name for kernel in PACKED])
def test_packed(kernel, chain, robot, samples):
    """Compare packed results with the batch's own numbers, entry by entry."""
    packed, whole = (kernels_of(robot, chain)[kernel.qualified_name + suffix] for suffix in ("_packed", ""))
    assert packed is getattr(robot.packed, kernel.qualified_name)
    stacks = arguments(kernel, samples)
    stacks[0] = stacks[0].copy()
    stacks[0][3, 2] = np.nan
    with np.errstate(invalid="ignore"):
        values, expected = as_results(packed(*stacks)), as_results(whole(*stacks))
        single = as_results(packed(*(stack[3] for stack in stacks)))
    for result, value, full, one in zip(kernel.results, values, expected, single, strict=True):
        assert np.array_equal(value[3], one, equal_nan=True)
        if not result.symmetric:
            assert np.array_equal(value, full, equal_nan=True)
            continue
        n = full.shape[-1]
        assert value.shape == (12, n * (n + 1) // 2)
        for i in range(n):
            for j in range(i, n):
                assert np.array_equal(value[:, i * (2 * n - i - 1) // 2 + j], full[:, i, j], equal_nan=True)


def test_packed_has_what_is_symmetric(robot):
    assert vars(robot.packed).keys() - {"__name__", "__doc__"} == {kernel.qualified_name for kernel in PACKED}


@every_result
def test_broadcasting_and_strides(kernel, index, chain, robot, samples):
    """Broadcasts, non-contiguous, Fortran-ordered, reversed and float32 inputs agree with stacks and single calls.

    Stacks go through the batch functions where there are any, single calls do not: there the last digits may differ.
    """
    ufunc = result_of(kernel, index, chain, robot)
    stacks = arguments(kernel, samples)
    single = np.stack([ufunc(*each) for each in zip(*stacks, strict=True)])
    assert relative_error(ufunc(*stacks), single) <= (2e-15 if kernel.batch else 0)
    single = ufunc(*stacks)
    grid = ufunc(*[s.reshape(3, 4, *s.shape[1:]) for s in stacks])
    assert np.array_equal(grid, single.reshape(3, 4, *single.shape[1:]))
    first = ufunc(*[stacks[0], *(s[0] for s in stacks[1:])])
    fifth = ufunc(stacks[0][5], *(s[0] for s in stacks[1:]))
    assert relative_error(first[5:6], fifth[None]) <= (2e-15 if kernel.batch else 0)
    spread = [
        np.repeat(s, 2)[::2] if s.ndim == 1 else np.repeat(np.repeat(s, 2, axis=0), 3, axis=-1)[::2, ..., ::3]
        for s in stacks
    ]
    assert not spread[0].flags.c_contiguous
    assert np.array_equal(ufunc(*spread), single)
    assert np.array_equal(ufunc(*[np.asfortranarray(s) for s in stacks]), single)
    assert np.array_equal(ufunc(*[s[::-1] for s in stacks]), single[::-1])
    backwards = [np.ascontiguousarray(s[..., ::-1])[..., ::-1] for s in stacks]
    assert np.array_equal(ufunc(*backwards), single)
    narrow = [s.astype(np.float32) for s in stacks]
    assert np.array_equal(ufunc(*narrow), ufunc(*[s.astype(np.float64) for s in narrow]))
    assert ufunc(*narrow).dtype == np.float64
    assert ufunc(*[s[:0] for s in stacks]).shape == (0, *single.shape[1:])


@every_result
def test_out(kernel, index, chain, robot, samples):
    """Results are written in place, whatever the strides of the array, and nowhere between them."""
    ufunc = result_of(kernel, index, chain, robot)
    stacks = arguments(kernel, samples)
    expected = ufunc(*stacks)
    out = np.empty_like(expected)
    assert ufunc(*stacks, out=out) is out
    assert np.array_equal(out, expected)
    wide = np.zeros((*expected.shape[:-1], 2 * expected.shape[-1]))
    ufunc(*stacks, out=wide[..., ::2])
    assert np.array_equal(wide[..., ::2], expected)
    assert not wide[..., 1::2].any()
    fortran = np.asfortranarray(np.empty_like(expected))
    ufunc(*stacks, out=fortran)
    assert np.array_equal(fortran, expected)


def test_out_may_overlap_an_input(robot, samples):
    """Write the result over the argument's own memory: the values are those without overlap."""
    stiffness = samples[TASK_STIFFNESS].copy()
    expected = robot.hybrid.connection_correction(samples[WRENCH])
    buffer = np.zeros((12, 6, 6))
    buffer[:, 0, :] = samples[WRENCH]
    robot.hybrid.connection_correction(buffer[:, 0, :], out=buffer)
    assert np.array_equal(buffer, expected)
    assert np.array_equal(stiffness, samples[TASK_STIFFNESS])


@pytest.mark.parametrize(
    ("shapes", "named"),
    [
        (((6,), (6,), (6, 6)), "q has the shape (6,), expected (..., 7)"),
        (((7,), (7,), (6, 6)), "wrench has the shape (7,), expected (..., 6)"),
        (((7,), (6,), (6, 7)), "task_stiffness has the shape (6, 7), expected (..., 6, 6)"),
        (((7,), (6,), (36,)), "task_stiffness has the shape (36,), expected (..., 6, 6)"),
        (((2, 7), (3, 6), (6, 6)), "wrench has the shape (3, 6), expected (2, 6) beside q of the shape (2, 7)"),
        (
            ((4, 1, 7), (2, 6), (3, 6, 6)),
            "task_stiffness has the shape (3, 6, 6), expected (2, 6, 6) beside wrench of the shape (2, 6)",
        ),
    ],
)
def test_wrong_shapes_name_the_argument(shapes, named, robot):
    """Pass wrong shapes: the error names the argument, its shape and the one expected."""
    with pytest.raises(ValueError, match=re.escape(f"hybrid_joint_stiffness(): {named}")):
        robot.hybrid.joint_stiffness(*(np.zeros(shape) for shape in shapes))


def test_wrong_types_are_refused(robot):
    with pytest.raises(TypeError):
        robot.hybrid.jacobian(np.zeros(7, dtype=complex))
    with pytest.raises(TypeError):
        robot.hybrid.jacobian(["a"] * 7)


@pytest.mark.parametrize("rep", REPRESENTATIONS)
def test_matrix_order(rep, robot, golden):
    """Row-major in and out: the transposed result, or the transposed argument, is far off."""
    sample = golden[1]
    owner, values = getattr(robot, rep), sample.by[rep]
    J = values["jacobian"]
    general = np.arange(36.0).reshape(6, 6) ** 2
    derivative = owner.jacobian_transpose_derivative(sample.q)
    step = 1e-6
    for i in range(7):
        shift = step * np.eye(7)[i]
        difference = (owner.jacobian(sample.q + shift) - owner.jacobian(sample.q - shift)).T / (2 * step)
        assert np.allclose(derivative[i], difference, rtol=0, atol=1e-8)
    cases = [
        (owner.kinematic_stiffness(sample.q, sample.wrench), values["kinematic_stiffness"]),
        (owner.connection_correction(sample.wrench), values["gamma_F"]),
        (
            owner.joint_stiffness_uncorrected(sample.q, sample.wrench, general),
            values["kinematic_stiffness"] + J.T @ general @ J,
        ),
    ]
    for found, expected in cases:
        assert np.allclose(found, expected, rtol=1e-12, atol=1e-12 * abs(expected).max())
        assert abs(found.T - expected).max() > 1e-2 * abs(expected).max()
    assert np.allclose(owner.jacobian(sample.q), J, rtol=0, atol=1e-13)
    assert np.allclose(robot.forward_kinematics(sample.q)[3], [0, 0, 0, 1])


@pytest.mark.slow
def test_the_gil_is_released(robot, samples):
    """Another thread counts on while one call is under way."""
    q = np.tile(samples[Q], (20_000, 1))
    out = np.empty((len(q), 7, 7, 6))
    started, done, seen = threading.Event(), threading.Event(), []

    def work():
        started.set()
        robot.hybrid.jacobian_transpose_derivative(q, out=out)
        done.set()

    thread = threading.Thread(target=work)
    thread.start()
    started.wait()
    while not done.is_set():
        seen.append(None)
    thread.join()
    # With the GIL held, this thread could run only before the call and after it.
    assert len(seen) > 1000


def test_threads_agree(robot, samples):
    """Call from eight threads: all results are equal to the bit."""
    expected = robot.hybrid.joint_stiffness(samples[Q], samples[WRENCH], samples[TASK_STIFFNESS])
    with ThreadPoolExecutor(8) as pool:
        calls = [
            pool.submit(robot.hybrid.joint_stiffness, samples[Q], samples[WRENCH], samples[TASK_STIFFNESS])
            for _ in range(200)
        ]
    assert all(np.array_equal(call.result(), expected) for call in calls)


FOR_DASK = "forward_kinematics", "hybrid_joint_stiffness", "spring_linearization", "gravity_energy", "bias_forces"
"""Of every kind one: a matrix, several arguments, several results, a number, masses. The others are wide."""


@pytest.mark.parametrize("kernel", [
    pytest.param(kernel, id=kernel.qualified_name, marks=() if kernel.qualified_name in FOR_DASK else pytest.mark.wide)
    for kernel in KERNELS
])  # fmt: skip
def test_dask_arrays(kernel, chain, robot, samples):
    """Through apply_gufunc with type and sizes named, as docs/performance.md says."""
    ufunc = kernels_of(robot, chain)[kernel.qualified_name]
    stacks = arguments(kernel, samples)
    chunked = [da.from_array(stack, chunks=(5,) + (-1,) * (stack.ndim - 1)) for stack in stacks]
    sizes = {"4": 4, "6": 6}
    types = float if ufunc.nout == 1 else [float] * ufunc.nout
    lazy = da.apply_gufunc(ufunc, ufunc.signature, *chunked, output_dtypes=types, output_sizes=sizes)
    for one, expected in zip(as_results(lazy), as_results(ufunc(*stacks)), strict=True):
        assert np.array_equal(one.compute(scheduler="threads"), expected)
    with pytest.raises(ValueError):
        short = [chunked[0][:, :-1], *chunked[1:]]
        da.apply_gufunc(ufunc, ufunc.signature, *short, output_dtypes=types, output_sizes=sizes)[0].compute()


def test_dask_cannot_call_them_as_they_are(robot, samples):
    """dask guesses the type on arrays of one entry. Once this fails, dask is better: simplify docs/analyze.md."""
    q = da.from_array(samples[Q], chunks=(5, -1))
    with pytest.raises(ValueError, match="q has the shape"):
        robot.hybrid.jacobian(q)


def test_constants(robot, chain):
    """Compare the module's constants with the chain; its arrays cannot be written."""
    assert robot.DOF == 7
    assert robot.JOINTS == ("A1", "A2", "A3", "A4", "A5", "A6", "A7")
    assert (robot.BASE, robot.TIP) == ("link_0", "link_ee")
    for name in ("lower", "upper", "velocity", "effort"):
        values = getattr(robot, name.upper())
        assert values.tolist() == [getattr(c, name) for c in chain.coordinates]
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 0


def called(folder, code):
    """What a fresh interpreter prints after this code; warnings are errors there, once each."""
    head = f"import sys; sys.path.insert(0, {str(folder.parent)!r}); import numpy as np, {folder.name} as robot"
    command = [sys.executable, "-W", "error", "-c", f"{head}\nq, F, K = np.zeros(7), np.ones(6), np.eye(6)\n{code}"]
    return subprocess.run(command, capture_output=True, text=True, check=False).stderr.rstrip().rpartition("\n")[2]


@pytest.mark.parametrize(
    ("code", "message"),
    [
        (
            "robot.hybrid.jacobian(np.zeros(6))",
            r"ValueError: hybrid_jacobian\(\): q has the shape \(6,\), expected \(\.\.\., 7\)",
        ),
        (
            "robot.hybrid.joint_stiffness(q, wrench=np.ones((2, 5)), task_stiffness=K)",
            r".*wrench has the shape \(2, 5\)",
        ),
        ("robot.hybrid.joint_stiffness(q, F)", r"TypeError: hybrid_joint_stiffness\(\) lacks 'task_stiffness'"),
        ("robot.joint_stiffness", r"AttributeError: .*; it has hybrid\.joint_stiffness"),
        ("robot.jax", r"ImportError: .*'stiffgen generate FILE --derivatives'"),
        ("import iiwa14.jax", r"ImportError: iiwa14: .*'stiffgen generate FILE --derivatives'"),
        ("import iiwa14.casadi", r"ImportError: iiwa14: .*'stiffgen generate FILE --derivatives'"),
        ("from iiwa14 import torch", r"ImportError: .*'stiffgen generate FILE --derivatives'"),
        (
            "robot.hybrid.joint_stiffness(q, F, np.triu(K + 1))",
            r".*not symmetric, and its symmetric part is used; .*stiffgen\.measured_stiffness\(Km, wrench, r",
        ),
        ("robot.hybrid.joint_stiffness([q, q], F, [K, np.triu(K + 1)])", r".*its symmetric part is used"),
        ("robot.hybrid.jacobian(q + 90)", r".*are the positions in degrees"),
        ("robot.hybrid.jacobian(np.stack([q, -90 + q])[:, ::-1])", r".*are the positions in degrees"),
        ("robot.hybrid.joint_stiffness_uncorrected(q, F, np.triu(K + 1))", "$"),
        ("robot.hybrid.joint_stiffness(q, F, K * (1 + 1e-12 * np.arange(6)))", "$"),
    ],
)
def test_a_newcomers_mistakes(robot_folder, code, message):
    """Make usual mistakes in a fresh interpreter: the message names function, argument and remedy."""
    assert re.match(message, called(robot_folder, code))


def test_a_warning_comes_once(robot_folder):
    twice = "import warnings\nwith warnings.catch_warnings(record=True) as got:\n    warnings.simplefilter('always')\n"
    twice += "    for k in range(3): robot.hybrid.jacobian(q + 90)\nassert len(got) == 1, got"
    assert called(robot_folder, twice) == ""
