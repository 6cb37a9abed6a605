# SPDX-License-Identifier: MIT
"""``--scalar float``: the same functions in single precision, their contract, and what does not go with it."""

from __future__ import annotations

import ctypes
import json
import math
import re
import subprocess
import zlib

import numpy as np
import pytest

import stiffgen
from stiffgen import StiffnessModel, open_robot
from stiffgen.cli import main
from stiffgen.control.companions import COMPANIONS
from stiffgen.core.lower.ranges import Ranges
from stiffgen.core.lower.scalar import FLOAT
from stiffgen.core.symbolic.kernels import KERNELS, chain_kernels
from stiffgen.core.verify.result import as_results
from stiffgen.core.verify.verify import verify
from stiffgen.families.rounding.bounds import ErrorBounds, NoBound, rounded_up
from support.c_program import STRICT, language_flags
from support.chains import chain_urdf
from support.float_sines import Sines
from support.generated_c import kernel_text
from support.project import URDF, compilers, kernels_of, require_32_bits, require_compiler
from support.quad import draw

NAME = "iiwa14f"
ALLOWED = {"sinf", "cosf", "sincosf", "sqrtf", "fmaxf", "memcpy", "memset", "memmove"}


@pytest.fixture(scope="module")
def folder(once):
    """Return the folder of the iiwa 14 in single precision, built once for all workers."""

    def make(output):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("CFLAGS", "-O1")  # compiles in half the time
            stiffgen.generate(URDF, output=output, name=NAME, scalar="float")

    return once("floats", make) / NAME


@pytest.fixture(scope="module")
def few(once):
    """The same robot with few functions beside sines, cosines and the self-check: for tests of flags."""
    options = {"scalar": "float", "kernels": "forward_kinematics", "controller": False, "python": False}
    return once("few-floats", lambda output: stiffgen.generate(URDF, output=output, name=NAME, **options)) / NAME


@pytest.fixture(scope="module")
def floats(folder):
    return open_robot(folder).module


def failed(folder, count):
    return [check for check in verify(folder, count=count) if not check.passed]


@pytest.mark.slow
@pytest.mark.usefixtures("unoptimised")
def test_folder_is_verified(folder):
    assert failed(folder, 10) == []


@pytest.mark.wide(instead="test_folder_is_verified")
@pytest.mark.usefixtures("unoptimised")
@pytest.mark.parametrize(
    ("compiler", "flags", "types", "options"),
    [
        ("gcc", "-mno-avx", "rprmr", {}),
        ("gcc", "-mno-avx512f", "rrrpmrrrrr", {}),
        ("gcc", "-DSTIFFGEN_NO_VECTORS", "rr", {"runtime_tool": True}),
        ("clang", "-march=native", "rrrr", {"floating_base": True}),
    ],
)
def test_other_chains_and_widths(compiler, flags, types, options, tmp_path, monkeypatch):
    """Rows that fill lanes partly, or once and begin another vector; batches in squares of four."""
    monkeypatch.setenv("CC", f"{require_compiler(compiler)} {flags}")
    urdf = tmp_path / "chain.urdf"
    urdf.write_text(chain_urdf(types))
    name = f"f_{compiler}_{types}_{zlib.crc32(flags.encode())}"  # an extension module is loaded once a process
    springs = ("quaternion", "coupled")
    folder = stiffgen.generate(urdf, output=tmp_path, name=name, scalar="float", springs=springs, **options)
    assert failed(folder, 7) == []


@pytest.mark.slow
def test_what_is_broken_is_found(folder, tmp_path):
    """Change a length by a ten-thousandth, or a term of the sine: verify finds it in floats, too."""
    for number, (statement, broken) in enumerate((("0.42f * ", "0.4202f * "), ("0.008332157f", "0.0f"))):
        text = kernel_text(folder, NAME)
        assert statement in text
        place = tmp_path / str(number) / NAME
        place.mkdir(parents=True)
        for file in folder.iterdir():
            if file.is_file() and file.suffix != ".so":
                (place / file.name).write_bytes(file.read_bytes())
        (place / f"{NAME}.c").write_text(text.replace(statement, broken))
        library = place / "broken.so"
        subprocess.run(
            ["gcc", "-O0", "-shared", "-fPIC", str(place / f"{NAME}.c"), "-o", str(library), "-lm"], check=True
        )
        function = ctypes.CDLL(str(library))[f"{NAME}_forward_kinematics"]
        bounds = ErrorBounds(open_robot(folder).chain, scalar=FLOAT)
        (kernel,) = (k for k in KERNELS if k.qualified_name == "forward_kinematics")
        q, pose = np.full(7, 0.7, np.float32), np.empty(16, np.float32)
        function(ctypes.c_void_p(q.ctypes.data), ctypes.c_void_p(pose.ctypes.data))
        exact = np.asarray(
            StiffnessModel(open_robot(folder).chain, kernels="forward_kinematics").forward_kinematics(q.astype(float))
        ).ravel()
        assert (np.abs(pose - exact) > bounds.of(kernel)["pose"]).any(), statement


def test_no_error_is_beyond_its_bound(floats, robot, chain):
    """Compare floats with doubles: no error beyond its bound, and no bound above a thousand times what is seen."""
    bounds, of_doubles = ErrorBounds(chain, scalar=FLOAT), ErrorBounds(chain)
    mine, theirs, measured = kernels_of(floats, chain), kernels_of(robot, chain), 0
    for number, kernel in enumerate(chain_kernels(chain)):
        try:
            bound, other = bounds.of(kernel), of_doubles.of(kernel)
        except NoBound:
            continue
        given = [
            each.astype(np.float32).reshape(-1, *argument.array(chain).shape)
            for each, argument in zip(
                draw(chain, kernel, Ranges(), 2000, np.random.default_rng(number), FLOAT),
                kernel.arguments,
                strict=True,
            )
        ]
        name = kernel.qualified_name
        found, expected = (
            as_results(function(*stacks))
            for function, stacks in ((mine[name], given), (theirs[name], [each.astype(float) for each in given]))
        )
        for result, one, reference in zip(kernel.results, found, expected, strict=True):
            errors = np.abs(one - reference).reshape(len(one), -1).max(axis=0)
            allowed = np.array(bound[result.name])
            assert (errors + other[result.name] <= allowed).all(), name
            assert allowed.max() <= 1000 * errors.max() or not errors.any(), name
        measured += 1
    assert measured >= 29


def test_header_and_manifest_state_type_and_bounds(folder, chain):
    """Compare type and rounding bound in header and manifest with those computed anew."""
    manifest, header = json.loads((folder / "manifest.json").read_text()), (folder / f"{NAME}.h").read_text()
    assert manifest["scalar"] == "float" and open_robot(folder).scalar == FLOAT
    assert "Single precision" in header and "up to 6000 rad" in header and "to 6 digits" in header
    stated = manifest["rounding"]["bounds"]
    (kernel,) = (k for k in chain_kernels(chain) if k.qualified_name == "hybrid_joint_stiffness")
    (bound,) = (each["bound"] for each in stated[kernel.qualified_name])
    assert bound == rounded_up(max(ErrorBounds(chain, scalar=FLOAT).of(kernel)["joint_stiffness"]), FLOAT)
    comment = header[: header.index(f"void {NAME}_hybrid_joint_stiffness(")].rsplit("/*", 1)[1]
    assert f"{bound:.1e} N m/rad" in comment


@pytest.mark.parametrize(
    ("compiler", "language", "level"),
    [
        pytest.param(compiler, *case, marks=mark)
        for compiler in compilers()
        for *case, mark in (
            ("c99", "-O1", ()) if compiler == "gcc" else ("c99", "-O0", pytest.mark.slow),
            ("c++11", "-O0", pytest.mark.slow),
            ("c++20", "-O3", pytest.mark.wide),
        )
    ],
)
def test_nothing_is_a_double(compiler, language, level, folder, tmp_path):
    """Compile with strict warnings: no promotion, no double function of libm, and only the header's names."""
    compiled = tmp_path / "o"
    promotion = ["-Wdouble-promotion", "-Wfloat-conversion"]
    source = ["-r", "-nostdlib", *(str(folder / f"{NAME}{end}.c") for end in ("", "_batch")), "-o", str(compiled)]
    subprocess.run(
        [require_compiler(compiler), *language_flags(language), level, *STRICT, *promotion, *source], check=True
    )
    text = kernel_text(folder, NAME) + (folder / f"{NAME}.h").read_text()
    code = re.sub(r"/\*.*?\*/", "", text, flags=re.S)
    assert not re.search(r"\bdouble\b", code)
    lines = subprocess.run(["nm", str(compiled)], check=True, capture_output=True, text=True).stdout.split("\n")
    symbols = [line.split()[-2:] for line in lines if line]
    assert {name for kind, name in symbols if kind == "U"} <= ALLOWED
    assert not [name for kind, name in symbols if kind in "bBC"]
    functions = {
        f"{NAME}_{k.qualified_name}{suffix}" for k in KERNELS for suffix in ("", *(b.suffix for b in k.batches))
    }
    tables = {f"{NAME}_{table}" for table in ("joints", "lower", "upper", "velocity", "effort")}
    exported = {name for kind, name in symbols if kind.isupper() and kind != "U"}
    assert exported == functions | tables | {f"{NAME}_self_check", f"{NAME}_batch_self_check"}


BLIND = "-U__ASSOCIATIVE_MATH__ -U__NO_SIGNED_ZEROS__"
REORDERED = "-fassociative-math -fno-signed-zeros -fno-trapping-math"
FLAGS = [
    ("gcc", "-O2 -ffast-math", None),
    ("clang", "-Ofast", None),
    ("gcc", f"-O2 -fno-signed-zeros {BLIND}", 2),
    ("clang", "-O2 -fno-honor-nans -fno-signed-zeros", 2),
    ("clang", f"-O2 {REORDERED}", 0),
    ("gcc", "-O2 -m32", 0),
    ("gcc", "-O2 -m32 -std=c99", 0),
    ("clang", "-O2 -m32", 0),
    ("gcc", "-O2 -mfpmath=387", 0),
    ("gcc", "-O2 -fsingle-precision-constant", 0),
    ("gcc", "-O3 -march=native -ffp-contract=fast -freciprocal-math -fno-trapping-math -fno-math-errno", 0),
    ("clang", "-O3 -march=native -ffp-contract=fast -freciprocal-math -fapprox-func", 0),
]
HARMLESS = [
    ("gcc", "-O2 -m32", 0),
    ("gcc", "-O2 -fsingle-precision-constant", 0),
    ("clang", f"-O2 {REORDERED}", 0),
    ("clang", "-O3 -march=native -ffp-contract=fast -freciprocal-math -fapprox-func", 0),
]
"""One of each kind: 32 bits with x87, constants, the order of sums, fused operations and reciprocals."""


def flag_mark(case):
    """Return the mark of a case: what is refused or found is quick; of what is harmless the further ones are wide."""
    if case[2] != 0:
        return ()
    return pytest.mark.slow if case in HARMLESS else pytest.mark.wide


@pytest.mark.parametrize(
    ("compiler", "flags", "verdict"),
    [pytest.param(*each, marks=flag_mark(each)) for each in FLAGS],
)
def test_flags_are_refused_found_or_harmless(compiler, flags, verdict, few, tmp_path):
    """Compile with hostile flags: refused, found by the self-check, or sines and poses are right."""
    if "-m32" in flags:
        require_32_bits(require_compiler(compiler))
    (tmp_path / "main.c").write_text(
        f'#include "{NAME}.c"\n#include <stdio.h>\nint main(void)\n{{\n'
        "    const float q[7] = {0.1f, -0.2f, 0.3f, -0.4f, 0.5f, -0.6f, 0.7f};\n    float pose[16];\n"
        f'    {NAME}_forward_kinematics(q, pose);\n    printf("%.9g\\n", (double)pose[3]);\n'
        f"    return {NAME}_self_check();\n}}\n"
    )
    command = [require_compiler(compiler), *flags.split(), "-w", f"-I{few}", str(tmp_path / "main.c")]
    done = subprocess.run([*command, "-o", str(tmp_path / "main"), "-lm"], capture_output=True, text=True, check=False)
    if verdict is None:
        assert done.returncode != 0 and "compile without" in done.stderr
        return
    assert done.returncode == 0, done.stderr
    ran = subprocess.run([str(tmp_path / "main")], capture_output=True, text=True, check=False)
    assert ran.returncode == verdict
    if verdict == 0:
        chain = open_robot(few).chain
        pose = stiffgen.StiffnessModel(chain, kernels="forward_kinematics").forward_kinematics(
            [0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7]
        )
        assert abs(float(ran.stdout) - float(pose[0, 3])) < 1e-6


def test_two_types_in_one_program(folder, robot_folder, tmp_path):
    """Link a robot in floats with one in doubles: both work, and differ by rounding alone."""
    (tmp_path / "main.c").write_text(
        f'#include "iiwa14.h"\n#include "{NAME}.h"\n#include <stdio.h>\nint main(void)\n{{\n'
        "    const double q[7] = {0.5};\n    const float p[7] = {0.5f};\n    double a[16];\n    float b[16];\n"
        f"    iiwa14_forward_kinematics(q, a);\n    {NAME}_forward_kinematics(p, b);\n"
        '    printf("%.9f %.9f\\n", a[11], (double)b[11]);\n'
        f"    return iiwa14_self_check() + {NAME}_self_check();\n}}\n"
    )
    sources = [str(tmp_path / "main.c"), str(folder / f"{NAME}.c"), str(robot_folder / "iiwa14.c")]
    program = tmp_path / "main"
    includes = [f"-I{folder}", f"-I{robot_folder}"]
    subprocess.run(["gcc", "-std=c99", "-O0", *STRICT, *includes, *sources, "-o", str(program), "-lm"], check=True)
    double, single = map(
        float, subprocess.run([str(program)], check=True, capture_output=True, text=True).stdout.split()
    )
    assert 0 < abs(double - single) < 1e-6


def test_cpp_takes_floats_and_refuses_doubles(folder, tmp_path):
    """Compile C++ with arrays of floats, and with doubles, which the compiler refuses with a clear message."""
    text = (
        f'#include "{NAME}.hpp"\n#include <cstdio>\nint main()\n{{\n    const std::array<NUMBER, 7> q{{}};\n'
        f"    const auto pose = {NAME}::forward_kinematics(q);\n"
        "    static_assert(std::is_same_v<decltype(pose)::value_type, float>);\n"
        '    std::printf("%.3f\\n", static_cast<double>(pose[11]));\n}\n'
    )
    for number in ("float", "double"):
        (tmp_path / f"{number}.cpp").write_text(text.replace("NUMBER", number))
    subprocess.run(["gcc", "-std=c99", "-O0", "-c", str(folder / f"{NAME}.c"), "-o", str(tmp_path / "c.o")], check=True)
    command = ["g++", "-std=c++17", "-Wall", "-Wextra", "-Werror", f"-I{folder}"]
    objects = [str(tmp_path / "c.o"), "-o", str(tmp_path / "a"), "-lm"]
    subprocess.run([*command, str(tmp_path / "float.cpp"), *objects], check=True)
    assert subprocess.run([str(tmp_path / "a")], capture_output=True, text=True, check=True).stdout == "1.306\n"
    done = subprocess.run(
        [*command, str(tmp_path / "double.cpp"), *objects], capture_output=True, text=True, check=False
    )
    assert done.returncode != 0 and "a fixed number of floats one after the other" in done.stderr


def test_numpy_converts_and_can_refuse_to(floats):
    """Call with lists, float64 and integers, which are converted; casting="safe" and complex numbers are refused."""
    q = [0.1] * 7
    expected = floats.forward_kinematics(np.array(q, np.float32))
    assert expected.dtype == np.float32
    for given in (q, np.array(q)):
        assert np.array_equal(floats.forward_kinematics(given), expected)
        assert np.array_equal(floats.forward_kinematics(q=given), expected)
    into = np.empty((4, 4))
    assert floats.forward_kinematics(q, out=into) is into and np.array_equal(into, expected)
    assert np.array_equal(floats.forward_kinematics(q, into), expected)
    assert floats.forward_kinematics([0] * 7).dtype == np.float32
    with pytest.raises(TypeError, match=r"float64.*float32.*'safe'"):
        floats.forward_kinematics(np.array(q), casting="safe")
    with pytest.raises(TypeError, match="complex128"):
        floats.forward_kinematics([1j] * 7)
    with pytest.raises(TypeError, match=r"lacks 'q'|takes from 1"):
        floats.forward_kinematics()
    with pytest.raises(TypeError, match="its arguments are q, wrench, task_stiffness"):
        floats.hybrid.joint_stiffness(q, wrench=[0.0] * 6)


def test_sines_of_some_floats(folder, tmp_path):
    """Compare sines beside multiples of pi/2, near zero and up to the largest (all: campaigns/float_sines.py)."""
    sines = Sines(folder, "gcc", ["-O1"], tmp_path)
    # ranges of bit patterns, which order positive floats; 0x45BB8001 is just beyond 6000, the largest angle
    for first, last in (
        (0, 1 << 21),
        *((start, start + (1 << 16)) for start in range(0x38000000, 0x45BB8001, 1 << 23)),
    ):
        worst = sines.worst(first, min(last, 0x45BB8001))
        assert max(worst.units) <= 1.1 and max(worst.ulps) <= 1.1
    near = (np.arange(1, 3800) * (math.pi / 2)).astype(np.float32)
    for at in near.view(np.uint32):
        worst = sines.worst(int(at) - 16, int(at) + 16)
        assert max(worst.ulps) <= 1.1, hex(at)


def test_what_needs_doubles_is_refused(folder, tmp_path, capsys):
    """Ask for what single precision cannot do: exit code 2, the reason, and nothing written."""

    def refusal(*arguments):
        assert main([*map(str, arguments)]) == 2
        return capsys.readouterr().err.splitlines()[-1]

    generate = ("generate", URDF, "--scalar", "float", "--no-build", "--output", tmp_path / "out")
    assert "--scalar float does not go with --derivatives" in refusal(*generate, "--derivatives")
    assert "--spring rotation_vector" in refusal(*generate, "--spring", "rotation_vector")
    fast = tmp_path / "fast.urdf"
    fast.write_text(re.sub(r'velocity="[^"]*"', 'velocity="1e300"', URDF.read_text()))
    assert "1e+300 is beyond its largest number" in refusal("generate", fast, *generate[2:])
    assert not (tmp_path / "out").exists()
    page = tmp_path / "page.html"
    for command in (
        ("prove", folder),
        ("play", folder, "--output", page),
        ("verify", folder, "--report", page),
    ):
        assert "was generated with --scalar float" in refusal(*command)
    assert not page.exists()
    assert "numbers float would become double" in refusal(
        "generate", URDF, "--no-build", "--name", NAME, "--output", folder.parent
    )
    with pytest.raises(stiffgen.StiffgenError, match="not one of double, float"):
        stiffgen.generate(URDF, output=tmp_path / "out", scalar="half")


def test_there_is_no_controller(folder, floats):
    assert not hasattr(floats, "Impedance")
    assert [name for name in ("impedance", *COMPANIONS) if (folder / f"{folder.name}_{name}.h").exists()] == []
    assert "For a controller" in (folder / f"{NAME}.h").read_text()
