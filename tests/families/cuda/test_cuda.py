# SPDX-License-Identifier: MIT
"""NAME.cu, compiled for the host: values, layout and contract; and by nvcc where it is installed.

No test needs a GPU. On one, ``make bench-cuda`` checks every launch function before it times anything.
"""

from __future__ import annotations

import json
import shutil
import subprocess

import numpy as np
import pytest

import stiffgen
from stiffgen.cli import main
from stiffgen.core.emit.render import render
from stiffgen.core.options import GenerationOptions
from stiffgen.core.symbolic.arguments import Q
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.connection import REPRESENTATIONS
from stiffgen.core.symbolic.kernels import MAX_BATCH_JOINTS, chain_kernels
from stiffgen.core.symbolic.model import casadi_function, folded
from stiffgen.core.verify.kernels.references import TASK_STIFFNESS, WRENCH
from stiffgen.core.verify.kernels.samples import Samples, argument_samples
from stiffgen.core.verify.result import as_results, relative_error
from stiffgen.families.joints.kernels import JOINT_POTENTIALS
from support.c_program import STRICT
from support.chains import chain_urdf
from support.cuda_host import NOTHING, HostCuda
from support.project import ROOT, URDF, assert_close, kernels_of, require_compiler

DUAL = ROOT / "tests" / "data" / "dual_arm.urdf"


def shared(argument):
    """Whether all configurations of a launch take the same: matrices, numbers; vectors and base poses are stacks."""
    return len(argument.shape) != 1 and argument.name != "base_pose" and not argument.per_configuration


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return stiffgen.generate(URDF, output=tmp_path_factory.mktemp("cuda"), build=False, cuda=True, controller=False)


@pytest.fixture(scope="module")
def host(folder, chain, tmp_path_factory):
    return HostCuda(folder / "iiwa14.cu", "iiwa14", chain, tmp_path_factory.mktemp("host"))


def arguments(kernel, samples):
    """Vectors in stacks, matrices and numbers of the first sample for all."""
    given = ((a, samples[a]) for a in kernel.arguments)
    return [np.array(values[0]) if shared(a) else values for a, values in given]


def compared_rows(name, q, robot):
    """Rows to compare: the gradient of the manipulability loses digits close to a singularity."""
    if name != "manipulability_gradient":
        return slice(None)
    measure = robot.manipulability(q)
    return measure > 0.1 * measure.max()


@pytest.mark.parametrize("rep", REPRESENTATIONS)
def test_golden_values(rep, golden, host):
    for sample in golden:
        q, wrench = sample.q[None], sample.wrench[None]
        assert_close(host(f"{rep}_jacobian", q)[0], sample.by[rep]["jacobian"])
        Kq = host(f"{rep}_joint_stiffness", q, wrench, sample.task_stiffness)[0]
        assert_close(Kq, sample.by[rep]["joint_stiffness"])


@pytest.mark.parametrize(("count", "spare"), [(1, 0), (37, 0), (131, 6)])
def test_every_kernel_against_the_c_code(count, spare, host, robot, chain):
    """Compare each kernel with C, also with spare columns: nothing outside is read (NaN) or written."""
    samples = Samples(chain, count, seed=4)
    ufuncs = kernels_of(robot, chain)
    assert len(host.kernels) == 21 + 3 * len(JOINT_POTENTIALS)
    for name, kernel in host.kernels.items():
        given = arguments(kernel, samples)
        results = (as_results(each) for each in (host(name, *given, spare=spare), ufuncs[name](*given)))
        for found, expected in zip(*results, strict=True):
            rows = compared_rows(name, samples[Q], robot)
            for one, other in zip(found[rows], expected[rows], strict=True):
                assert_close(one, other)


@pytest.mark.slow
def test_single_precision_is_one_record(host, chain, robot, tmp_path):
    """Generate CUDA in floats: no double in it, and values to 7 digits."""
    texts = render(chain, "iiwa14", GenerationOptions(scalar="float", cuda=True))
    source = tmp_path / "iiwa14.cu"
    for file in (source.name, "iiwa14_cuda.h"):
        (tmp_path / file).write_text(texts[file])
        assert "double" not in texts[file]
    floats = HostCuda(source, "iiwa14", chain, tmp_path, number=np.float32)
    samples = Samples(chain, 20, seed=11)
    for name, kernel in host.kernels.items():
        given = arguments(kernel, samples)
        for found, expected in zip(as_results(floats(name, *given)), as_results(host(name, *given)), strict=True):
            rows = compared_rows(name, samples[Q], robot)
            assert 1e-9 < relative_error(found[rows], expected[rows]) < 1e-5, name


def test_an_equilibrium_for_each_configuration(host, robot, chain):
    """Pass one equilibrium per configuration, in columns whose stride is at least the count."""
    samples = Samples(chain, 37, seed=5)
    ufuncs = kernels_of(robot, chain)
    springs = {name: kernel for name, kernel in host.kernels.items() if kernel.group == "spring"}
    assert len(springs) == 6
    for name, kernel in springs.items():
        given = [
            samples[a] if a.varying else g for a, g in zip(kernel.arguments, arguments(kernel, samples), strict=True)
        ]
        assert given[1].shape == (37, 4, 4)  # the equilibria
        results = (as_results(each) for each in (host(name, *given, spare=2), ufuncs[name](*given)))
        for found, expected in zip(*results, strict=True):
            for one, other in zip(found, expected, strict=True):
                assert_close(one, other)
    kernel = springs["spring_energy"]
    q, K, out = np.zeros((7, 4)), np.eye(3), np.full((1, 4), NOTHING)
    # count and stride of 4; three equilibria in columns are too few, and refused before anything is written
    assert host.launch(kernel, 4, 4, q, np.zeros((16, 3)), K, K, out) == 1
    assert (out == NOTHING).all()
    assert host.launch(kernel, 4, 4, q, np.zeros((16, 4)), K, K, out) == 0
    assert (out != NOTHING).all()


def test_every_matrix_for_each_configuration(host, robot, chain):
    """Stiffnesses and numbers in columns with strides of their own; each can be shared; short strides are refused."""
    samples = Samples(chain, 37, seed=6)
    ufuncs = kernels_of(robot, chain)
    kernels = {name: k for name, k in host.kernels.items() if any(shared(a) and not a.varying for a in k.arguments)}
    assert len(kernels) == 3 + 1 + 6 + 3  # joint stiffness, its gradient, the spring, the limits
    for name, kernel in kernels.items():
        stacks = [samples[a] for a in kernel.arguments]
        for place, argument in enumerate(kernel.arguments):
            one = [stack[0] if k == place and shared(argument) else stack for k, stack in enumerate(stacks)]
            for given in (stacks, one) if shared(argument) else (stacks,):
                results = (as_results(each) for each in (host(name, *given, spare=2, each=True), ufuncs[name](*given)))
                for found, expected in zip(*results, strict=True):
                    for ours, theirs in zip(found, expected, strict=True):
                        assert_close(ours, theirs)
    kernel = kernels["hybrid_joint_stiffness"]
    q, wrench, out = np.zeros((7, 4)), np.zeros((6, 4)), np.full((28, 4), NOTHING)
    # three columns for four configurations
    assert host.launch(kernel, 4, 4, q, wrench, np.zeros((36, 3)), out, each=True) == 1
    assert (out == NOTHING).all()
    assert host.launch(kernel, 4, 4, q, wrench, np.zeros((36, 4)), out, each=True) == 0
    assert (out != NOTHING).all()
    for name in set(host.kernels) - set(kernels):
        assert not hasattr(host.library, f"iiwa14_{name}_each_cuda")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "compiler"),
    [
        pytest.param("slides and mimics", "gcc", marks=pytest.mark.wide),
        pytest.param("floating base", "gcc", marks=pytest.mark.wide),
        ("two tips, tool at run time", "clang"),
    ],
)
def test_other_chains(case, compiler, tmp_path):
    """Compare launches of other chains with CasADi; matrices shared, and one per configuration."""
    if case != "two tips, tool at run time":
        urdf = tmp_path / "arm.urdf"
        urdf.write_text(chain_urdf("rprmrr"))
        options = {"floating_base": True} if case == "floating base" else {}
    else:
        sensor = stiffgen.Sensor("right-hand", sign="robot")
        urdf, options = DUAL, {"tip": ["left hand", "right-hand"], "runtime_tool": True, "sensor": sensor}
    folder = stiffgen.generate(
        urdf, output=tmp_path, name="arm", build=False, cuda=True, controller=False, **options
    )  # fmt: skip
    chain = stiffgen.load_chain(urdf, **options)
    host = HostCuda(folder / "arm.cu", "arm", chain, tmp_path, {"gcc": "g++", "clang": "clang++"}[compiler])
    pool = argument_samples(chain, 5, seed=9)
    of_joints = 3 * len(JOINT_POTENTIALS)  # energy, torque, joint stiffness
    totals = 7 if len(chain.tips) > 1 else 0  # three of contacts, four of springs
    of_sensor = 4 if chain.sensor else 0
    assert len(host.kernels) == 6 + of_joints + 15 * len(chain.tips) + totals + of_sensor  # 6: of masses
    for kernel in chain_kernels(chain):
        if not kernel.batch:
            continue
        stacks = [pool[a] for a in kernel.arguments]
        first = [np.array(pool[a][0]) if shared(a) else pool[a] for a in kernel.arguments]
        has_each = any(shared(a) and not a.varying for a in kernel.arguments)
        function = casadi_function(chain, kernel)
        folds = [folded(argument.array(chain).shape) for argument in kernel.arguments]
        for given, each in ((first, False), (stacks, True)) if has_each else ((first, False),):
            found = as_results(host(kernel.qualified_name, *given, spare=2, each=each))
            for c in range(5):
                one = [g if shared(a) and not each else g[c] for a, g in zip(kernel.arguments, given, strict=True)]
                expected = as_results(function(*(a.reshape(f) for a, f in zip(one, folds, strict=True))))
                for stack, value in zip(found, expected, strict=True):
                    assert_close(stack[c], np.asarray(value).reshape(stack[c].shape))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_nan_and_infinity(value, host, chain, robot):
    """Spoil entries: NaN as in C, entry by entry, and only in their configuration."""
    samples = Samples(chain, 5, seed=2)
    ufuncs = kernels_of(robot, chain)
    for name, kernel in host.kernels.items():
        given = arguments(kernel, samples)
        for index, argument in enumerate(kernel.arguments):
            for entry in range(given[index].size if shared(argument) else given[index][0].size):
                spoiled = [g.copy() for g in given]
                spoiled[index].flat[entry] = value  # of the first configuration, or shared
                with np.errstate(invalid="ignore"):
                    found, expected = host(name, *spoiled), ufuncs[name](*spoiled)
                for one, other in zip(as_results(found), as_results(expected), strict=True):
                    assert np.array_equal(np.isnan(one), np.isnan(other)), (name, argument.name, entry)
                    assert not np.isinf(one).any()
    q = samples[Q].copy()
    q[3, 1] = value
    found = host("hybrid_joint_stiffness", q, samples[WRENCH], samples[TASK_STIFFNESS][0])
    assert np.isnan(found[3]).all() and np.isfinite(np.delete(found, 3, axis=0)).all()


@pytest.mark.slow
def test_slides(tmp_path):
    """Make a sliding coordinate infinite: NaN, not infinity, without a sine."""
    for types in ("pp", "pr"):
        urdf = tmp_path / f"{types}.urdf"
        urdf.write_text(chain_urdf(types))
        few = {"kernels": ("body.jacobian", "spatial.jacobian"), "controller": False}
        folder = stiffgen.generate(urdf, output=tmp_path, name=types, build=False, cuda=True, **few)
        assert ("sine_cosine" in (folder / f"{types}.cu").read_text()) == ("r" in types)
        options = KernelOptions(kernels=few["kernels"])
        host = HostCuda(folder / f"{types}.cu", types, stiffgen.load_chain(urdf), tmp_path, options=options)
        found = host("spatial_jacobian", np.array([[0.1, 0.2], [np.inf, 0.2]]))
        assert np.isfinite(found[0]).all() and not np.isinf(found[1]).any()
        assert np.isnan(found[1, :3, 1]).any() == ("r" in types)


def test_nothing_to_do_and_refusals(host):
    """Launch no configuration: success, nothing written; a stride below the count fails."""
    kernel = host.kernels["hybrid_joint_stiffness"]
    out = np.full((28, 4), NOTHING)
    q, wrench, K = np.zeros((7, 4)), np.zeros((6, 4)), np.eye(6)
    assert host.launch(kernel, 0, 0, None, None, None, None) == 0
    assert host.launch(kernel, 0, 4, q, wrench, K, out) == 0
    assert host.launch(kernel, 4, 3, q, wrench, K, out) == 1
    assert (out == NOTHING).all()
    assert host.launch(kernel, 4, 4, q, wrench, K, out) == 0
    assert (out != NOTHING).all()


def test_files(folder, chain):
    manifest = json.loads((folder / "manifest.json").read_text())
    assert {"iiwa14.cu", "iiwa14_cuda.h"} <= set(manifest["files"])
    header = (folder / "iiwa14_cuda.h").read_text()
    assert "Memory traffic: 41 doubles per configuration." in header  # 7 of q, 6 of the wrench, 28 of the result
    for file in ("README.md", "CMakeLists.txt", "iiwa14.cu", "iiwa14_cuda.h"):
        assert "http" not in (folder / file).read_text()


def test_cuda_files_go_when_not_asked_for(tmp_path):
    """Generate with CUDA and again without: no CUDA file and no word of CUDA is left."""
    few = {"kernels": "limits", "controller": False, "masses": False}
    folder = stiffgen.generate(URDF, output=tmp_path, build=False, cuda=True, **few)
    assert "IIWA14_CUDA" in (folder / "CMakeLists.txt").read_text()
    words = ["--no-build", "--kernels", "limits", "--no-controller", "--no-masses", "--output", str(tmp_path)]
    assert main(["generate", str(URDF), *words]) == 0
    assert list(folder.glob("*cu*")) == []
    assert "CUDA" not in (folder / "CMakeLists.txt").read_text() + (folder / "README.md").read_text()


def test_a_chain_too_long_is_refused(tmp_path, capsys):
    """Ask for CUDA for 25 joints: exit code 2, the most allowed (24), and no folder."""
    urdf = tmp_path / "long.urdf"
    urdf.write_text(chain_urdf("r" * (MAX_BATCH_JOINTS + 1)))
    few = ["--kernels", "hybrid.jacobian", "--no-controller", "--no-masses"]
    assert main(["generate", str(urdf), "--cuda", *few, "--output", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err.splitlines()[-1]
    assert message.startswith("stiffgen: --cuda: the chain has 25 moving joints") and "at most 24" in message
    assert not (tmp_path / "out").exists()


def test_the_c_header(folder, tmp_path):
    """Compile the header as C99 without a warning."""
    (tmp_path / "main.c").write_text('#include "iiwa14_cuda.h"\nint main(void) { return 0; }\n')
    command = [
        require_compiler("gcc"),
        "-std=c99",
        *STRICT,
        f"-I{folder}",
        "-c",
        str(tmp_path / "main.c"),
        "-o",
        str(tmp_path / "o"),
    ]
    subprocess.run(command, check=True)


def test_fast_math_is_refused(folder, tmp_path):
    """Compile with an optimisation that takes NaN for impossible: refused."""
    command = [
        require_compiler("g++"),
        "-x",
        "c++",
        "-ffast-math",
        "-c",
        str(folder / "iiwa14.cu"),
        "-o",
        str(tmp_path / "o"),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode != 0 and "NaN contract" in done.stderr


def require_nvcc():
    if shutil.which("nvcc") is None:
        pytest.skip("nvcc is not installed (NVIDIA's CUDA toolkit)")


def nvcc(*arguments, architecture="sm_80"):
    require_nvcc()
    warnings = ["-Werror", "all-warnings", "-Xcompiler", "-Wall,-Wextra,-Wconversion,-Wshadow,-Werror"]
    command = ["nvcc", f"-arch={architecture}", *warnings, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    "architecture", ["sm_80", *(pytest.param(name, marks=pytest.mark.wide) for name in ("sm_90", "sm_100"))]
)
def test_nvcc(architecture, folder, tmp_path):
    """Compile with nvcc: no warning, and the iiwa 14's stiffness fits into registers."""
    options = ("-Xptxas", "-v", "-c", folder / "iiwa14.cu", "-o", tmp_path / "o")
    resources = nvcc(*options, architecture=architecture)
    for kernel in ("hybrid_joint_stiffness_kernel", "hybrid_joint_stiffness_each_kernel"):
        entry = resources[resources.index(kernel) :]
        assert " 0 bytes spill stores, 0 bytes spill loads" in entry.split("Used")[0]


@pytest.mark.slow
def test_cmake(tmp_path):
    """Build a C project with CMake's CUDA option: its launch works, a bad stride is refused."""
    require_nvcc()
    few = {"kernels": "hybrid.jacobian", "controller": False, "masses": False}
    folder = stiffgen.generate(URDF, output=tmp_path, build=False, cuda=True, **few)
    (tmp_path / "main.c").write_text(
        '#include "iiwa14_cuda.h"\nint main(void) { return iiwa14_hybrid_jacobian_cuda(1, 0, 0, 0, 0) == 1 ? 0 : 1; }\n'
    )
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.18)\nproject(app LANGUAGES C CUDA)\n"
        f"set(IIWA14_CUDA ON)\nadd_subdirectory({folder} iiwa14)\nadd_executable(app main.c)\n"
        "target_link_libraries(app PRIVATE iiwa14_cuda)\n"
    )
    for arguments in (("-S", ".", "-B", "build", "-DCMAKE_CUDA_ARCHITECTURES=80"), ("--build", "build")):
        subprocess.run(["cmake", *arguments], check=True, cwd=tmp_path, capture_output=True)
    subprocess.run([tmp_path / "build" / "app"], check=True)


@pytest.mark.wide(instead="test_nvcc")
def test_nvcc_takes_mimic_joints_and_the_benchmark(tmp_path):
    """Compile a robot with mimic joints and the benchmark with nvcc."""
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(chain_urdf("rprmrr"))
    arm = stiffgen.generate(urdf, output=tmp_path, name="arm", build=False, cuda=True)
    nvcc("-c", arm / "arm.cu", "-o", tmp_path / "o")
    robot = stiffgen.generate(URDF, output=tmp_path, build=False, cuda=True, derivatives=True)
    nvcc("-c", f"-I{robot}", ROOT / "benchmarks" / "cuda_stiffness.cu", "-o", tmp_path / "b")
