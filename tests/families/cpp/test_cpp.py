# SPDX-License-Identifier: MIT
"""NAME.hpp: the C functions from C++, bit for bit, wherever the numbers lie; what does not fit is refused."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import stiffgen
from stiffgen.control.page import has_controller
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.verify.kernels.samples import Samples
from support.c_program import STRICT
from support.project import ROOT, URDF, require_compiler

DATA = ROOT / "tests" / "data"
ROBOTS = {
    "iiwa14": (URDF, {}),
    "dual": (DATA / "dual_arm.urdf", {"tip": ["left hand", "right-hand"]}),
    "other": (
        DATA / "dual_arm.urdf",
        {"tip": ["left hand", "right-hand"], "kernels": "forward_kinematics", "controller": False},
    ),
    "tooled": (URDF, {"runtime_tool": True, "derivatives": True, "sensor": stiffgen.Sensor("link_ee")}),
    "solo12": (DATA / "solo12.urdf", {"floating_base": True, "tip": ["FL_FOOT", "HR_FOOT"]}),
}
OF_KERNELS = "derivatives", "kernels", "controller"
EIGEN = Path("/usr/include/eigen3")

HEAD = r"""
#if WITH_EIGEN
#include <Eigen/Core>
#endif
#include "{name}.hpp"
#include <cmath>
#include <cstdio>
#include <cstring>
#if __cplusplus >= 202002L
#include <span>
#endif

namespace {{

int wrong = 0, compared = 0;

[[maybe_unused]] void check(bool bad, int line)
{{
    wrong += bad;
    if (bad) {{ std::printf("line %d\n", line); }}
}}

void same(const char *what, const double *expected, const double *found, std::size_t count)
{{
    ++compared;
    if (std::memcmp(expected, found, count * sizeof(double)) != 0) {{
        ++wrong;
        std::printf("%s\n", what);
    }}
}}
"""


def call(kernel, arguments: list[str]) -> str:
    return f"{'::'.join((*kernel.path, kernel.name))}({', '.join(arguments)})"


def values_of(values: np.ndarray) -> str:
    return ", ".join(repr(float(value)) for value in np.ravel(values))


def extents_of(shape: tuple[int, ...]) -> tuple[int, int]:
    """Rows and columns of what Eigen has."""
    return (int(np.prod(shape[:-1])), shape[-1]) if len(shape) > 1 else (shape[0], 1)


def block(name: str, chain: stiffgen.Chain, kernel, drawn: Samples) -> str:
    """A function that calls a kernel in every way and compares the bits."""
    arguments = [(a.name, a.array(chain).shape, drawn[a][0]) for a in kernel.arguments]
    results = [(r.name, r.array(chain).shape) for r in kernel.results]
    lines = [f"void {kernel.qualified_name}()", "{"]
    c, view, eigen, span = [], [], [], []
    for k, (_, shape, values) in enumerate(arguments):
        size = int(np.prod(shape))
        lines.append(f"    const std::array<double, {size}> a{k} = {{{values_of(values)}}};")
        c.append(f"a{k}.data()")
        view.append(f"a{k}" if shape else f"a{k}[0]")
        span.append(f"std::span<const double, {size}>(a{k})" if shape else f"a{k}[0]")
        eigen.append(f"{name}::map<{', '.join(map(str, extents_of(shape)))}>(a{k})" if shape else f"a{k}[0]")
    c_results, written, into = [], [], []
    for k, (_, shape) in enumerate(results):
        size = int(np.prod(shape))
        lines += [f"    std::array<double, {size}> c{k}{{}}, w{k}{{}};"]
        c_results.append(f"c{k}.data()")
        written.append(f"w{k}" if shape else f"w{k}[0]")
        into.append(f"e{k}" if shape else f"e{k}(0, 0)")
    lines.append(f"    ::{name}_{kernel.qualified_name}({', '.join(c + c_results)});")

    def compare(how: str, made: list[str]) -> None:
        for k, (result, shape) in enumerate(results):
            what = f"{kernel.qualified_name} {result} {how}"
            lines.append(f'    same("{what}", c{k}.data(), {made[k]}, {int(np.prod(shape))});')

    def returned(value: str) -> list[str]:
        if len(results) > 1:
            return [f"{value}.{name}.data()" if shape else f"&{value}.{name}" for name, shape in results]
        return [f"{value}.data()" if results[0][1] else f"&{value}"]

    lines.append(f"    {name}::{call(kernel, view + written)};")
    compare("written", [f"w{k}.data()" for k in range(len(results))])
    lines.append(f"    const auto r = {name}::{call(kernel, view)};")
    compare("returned", returned("r"))
    lines.append(f"    static_assert(noexcept({name}::{call(kernel, view + written)}));")
    lines += ["#if __cplusplus >= 202002L", f"    const auto s = {name}::{call(kernel, span)};"]
    compare("from spans", returned("s"))
    lines += ["#endif", "#if WITH_EIGEN"]
    lines += [
        f"    {name}::Matrix<{', '.join(map(str, extents_of(shape or (1,))))}> e{k};"
        for k, (_, shape) in enumerate(results)
    ]
    lines.append(f"    {name}::{call(kernel, eigen + into)};")
    compare("by Eigen", [f"e{k}.data()" for k in range(len(results))])
    columns, shown = [], []
    for k, (_, shape, _) in enumerate(arguments):
        if len(shape) > 1:
            rows, cols = extents_of(shape)
            lines.append(
                f"    const Eigen::MatrixXd m{k} = {name}::map<{rows}, {cols}>(a{k}); // column-major, dynamic"
            )
            columns.append(f"{name}::row_major<{rows}, {cols}>(m{k})")
        elif shape:
            lines.append(f"    const Eigen::VectorXd m{k} = {name}::map<{shape[0]}>(a{k});")
            columns.append(f"m{k}.head<{shape[0]}>()")
        else:
            columns.append(f"a{k}[0]")
        shown.append(k)
    lines.append(f"    const auto t = {name}::{call(kernel, columns)};")
    compare("from column-major", returned("t"))
    return "\n".join([*lines, "#endif", "}", ""])


CONTROLLER = r"""
void controller()
{{
    const std::array<double, {n}> q0 = {{{q}}}, dq{{}};
    const std::array<double, {n}> held = {{{held}}};
    {name}_impedance_config config = {name}::Impedance::default_config(), plain;
    {name}_impedance_default_config(&plain);
    check(std::memcmp(&config, &plain, sizeof config) != 0, __LINE__);
    check({name}::Impedance(config).error() != {macro}_E_CONFIG_SAMPLE_TIME, __LINE__);
    check(std::strstr({name}::Impedance::error_text({macro}_E_CONFIG_SAMPLE_TIME), "sample_time") == nullptr, __LINE__);
    config.sample_time = 0.001;
    config.delay_samples = 0;
    config.heaviest_wrench[0] = 50.0;
    config.heaviest_wrench[1] = 10.0;
    for (double &inertia : config.motor_inertia) {{ inertia = 0.1; }}
    {tool}
    {name}_impedance_state state{{}};
    check({name}_impedance_init(&config, &state, held.data()) != {macro}_OK, __LINE__);
    {name}::Impedance first(config, held), second(config);
    static_assert(std::is_trivially_copyable_v<{name}::Impedance>);
    check(first.error() != {macro}_OK, __LINE__);
    {name}::Impedance::Sample sample{{}};
    sample.clock = {macro}_CLOCK_COUNTER;
    {stiffness}
    for (uint32_t k = 0; k < 400; ++k) {{
        {name}::Impedance::Report expected{{}}, found{{}};
        sample.counter = k;
        sample.sample_valid = k < 200 || k > 210; // a fault, and its reset
        {name}::assign<{n}>(sample.q, q0);
        {name}::assign<{n}>(sample.dq, dq);
        {name}::assign<{n}>(sample.q0, q0);
        for (int i = 0; i < {n}; ++i) {{ // an arm that swings: one that stands still to the last bit is a fault
            sample.q[i] += 1e-3 * std::sin(0.01 * k);
            sample.dq[i] = 1e-2 * std::cos(0.01 * k);
        }}
        sample.q0[0] += 0.1;
        if (k == 300) {{ check({name}_impedance_reset(&state) != first.reset(), __LINE__); }}
        if (k == 150) {{ second = first; }}
        check({name}_impedance_step(&state, &sample, &expected) != first.step(sample, found), __LINE__);
        check(std::memcmp(&expected, &found, sizeof found) != 0, __LINE__);
        if (k >= 150 && k < 300) {{
            {name}::Impedance::Report copied{{}};
            check(second.step(sample, copied) != {macro}_OK, __LINE__);
            check(std::memcmp(&copied, &found, sizeof found) != 0, __LINE__);
        }}
        compared += 2;
        check(k == 100 && !(found.torque[0] > 0.0), __LINE__);
        check(k == 250 && found.fault != {macro}_FAULT_COMMUNICATION, __LINE__);
        check(k == 350 && found.fault != {macro}_FAULT_NONE, __LINE__);
    }}
}}
"""


def program(name: str, chain: stiffgen.Chain, options: KernelOptions) -> str:
    """Return a program that calls every C++ function and the controller, and compares them with C in bits."""
    drawn = Samples(chain, 1, seed=3)
    kernels = chain_kernels(chain, options)
    parts = [HEAD.format(name=name), *(block(name, chain, kernel, drawn) for kernel in kernels)]
    names = [kernel.qualified_name for kernel in kernels]
    if has_controller(chain):
        middle = [(max(c.lower, -1.0) + min(c.upper, 1.0)) / 2 + 0.01 * k for k, c in enumerate(chain.coordinates)]
        diagonals = [
            f"sample.{field}[{9 * tip + 4 * k}] = {value};"
            for field, value in (("translation_stiffness", 500.0), ("rotation_stiffness", 30.0))
            for tip in range(len(chain.tips)) for k in range(3)
        ]  # fmt: skip
        tool = [
            f"config.tool_pose[{16 * tip + 5 * k}] = 1.0;" for tip in range(len(chain.tips)) for k in range(4)
        ] if chain.runtime_tool else []  # fmt: skip
        numbers = {"q": values_of(np.array(middle)), "held": values_of(0.01 * np.arange(chain.dof))}
        text = CONTROLLER.format(
            name=name,
            macro=name.upper(),
            n=chain.dof,
            stiffness="\n    ".join(diagonals),
            tool=" ".join(tool),
            **numbers,
        )
        parts.append(text)
        names.append("controller")
    calls = "\n".join(f"    {each}();" for each in names)
    main = f'\n}} // namespace\n\nint main()\n{{\n{calls}\n    std::printf("%d of %d\\n", wrong, compared);\n'
    return "".join([*parts, main, f"    return wrong + {name}::self_check();\n}}\n"])


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], tuple[Path, list[str]]]:
    """Return a function that gives a robot's folder with its test program and objects, each made once."""

    @cache
    def make(name: str) -> tuple[Path, list[str]]:
        """Return the folder of a robot with the C++ program of all functions, and its compiled objects."""
        urdf, options = ROBOTS[name]
        folder = stiffgen.generate(urdf, name=name, output=tmp_path_factory.mktemp(name), build=False, **options)
        chain = stiffgen.load_chain(urdf, **{key: value for key, value in options.items() if key not in OF_KERNELS})
        sources = [
            source for source in (f"{name}.c", f"{name}_batch.c", f"{name}_impedance.c") if (folder / source).exists()
        ]
        for source in sources:
            subprocess.run(["cc", "-std=c99", "-O0", "-c", source], cwd=folder, check=True)
        (folder / "main.cpp").write_text(program(name, chain, KernelOptions(derivatives="derivatives" in options)))
        return folder, [source.replace(".c", ".o") for source in sources]

    return make


def eigen() -> Path:
    if not EIGEN.exists():
        if os.environ.get("CI"):
            pytest.fail("Eigen is missing; .ci/run installs it")
        pytest.skip("Eigen is not installed (Debian: apt-get install libeigen3-dev)")
    return EIGEN


CASES = [
    ("iiwa14", "g++", "c++20", True), ("iiwa14", "clang++", "c++17", True), ("iiwa14", "clang++", "c++20", False),
    pytest.param("iiwa14", "g++", "c++17", False, marks=pytest.mark.wide),
]  # fmt: skip
CASES += [
    pytest.param("dual", "g++", "c++20", True, marks=pytest.mark.wide),
    pytest.param("tooled", "g++", "c++20", True, marks=pytest.mark.wide),
    pytest.param("solo12", "clang++", "c++17", True, marks=pytest.mark.wide),
]


def command(compiler: str, standard: str, with_eigen: bool) -> list[str]:
    flags = [require_compiler(compiler), f"-std={standard}", "-O0", *STRICT, f"-DWITH_EIGEN={int(with_eigen)}"]
    return [*flags, "-isystem", str(eigen())] if with_eigen else flags


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "compiler", "standard", "with_eigen"),
    CASES,
)
def test_every_function_gives_the_bits_of_c(made, name, compiler, standard, with_eigen, tmp_path):
    """Call each function in C++, with arrays and Eigen: the bits of C."""
    folder, objects = made(name)
    build = [*command(compiler, standard, with_eigen), "main.cpp", *objects, "-o", str(tmp_path / "a"), "-lm"]
    subprocess.run(build, cwd=folder, check=True)
    done = subprocess.run([str(tmp_path / "a")], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    found = re.fullmatch(r"0 of (\d+)\n", done.stdout)
    assert found and int(found[1]) > 100, done.stdout


ENTRIES, FLOATS = "has another number of entries", "does not hold a fixed number of doubles"
COLUMNS, DYNAMIC = "is column-major, as Eigen's default is", "size of this Eigen object is not known"
REFUSED = {
    "plain": {
        "entries": ("std::array<double, 6> x{}; forward_kinematics(x);", f"this std::array {ENTRIES}"),
        "c_entries": ("double x[8] = {}; forward_kinematics(x);", f"this array {ENTRIES}"),
        "c_shape": ("double x[4][9] = {}; hybrid::joint_stiffness(q, F, x);", "this array has another shape"),
        "floats": ("std::array<float, 7> x{}; forward_kinematics(x);", FLOATS),
        "c_floats": ("float x[7] = {}; forward_kinematics(x);", "this array does not hold doubles"),
        "vector": ("std::vector<double> x(7); forward_kinematics(x);", FLOATS),
        "pointer": ("double *x = q; forward_kinematics(x);", "a pointer does not say how much"),
        "temporary": ("forward_kinematics(q, Array<4, 4>{});", "written into a temporary"),
        "constant": ("const Array<4, 4> T{}; forward_kinematics(q, T);", "written into something const"),
        "span": ("std::span<double> x(q); forward_kinematics(x);", "this span has another extent"),
    },
    "eigen": {
        "columns": ("Eigen::Matrix<double, 6, 6> K; hybrid::joint_stiffness(q, F, K);", COLUMNS),
        "dynamic": ("Eigen::MatrixXd K(6, 6); hybrid::joint_stiffness(q, F, K);", DYNAMIC),
        "into_columns": ("Eigen::Matrix<double, 7, 7> M; mass_matrix(q, M);", COLUMNS),
        "dynamic_vector": ("Eigen::VectorXd x(7); mass_matrix(x);", DYNAMIC),
        "expression": ("mass_matrix(2.0 * q);", "an Eigen expression, not yet computed: pass (expression).eval()"),
        "sum": ("Matrix<7> dq; hybrid::jacobian(q + dq);", "an Eigen expression, not yet computed"),
        "dynamic_sum": ("Eigen::VectorXd x(7); mass_matrix(x + x);", "an Eigen expression, not yet computed"),
        "into_expression": ("Matrix<7, 7> M; mass_matrix(q, M + M);", "an Eigen expression, not yet computed"),
        "strided": ("Matrix<7, 2> x; mass_matrix(x.col(0));", "do not lie one after the other: pass its .eval()"),
        "apart": ("Matrix<6, 8> K; hybrid::joint_stiffness(q, F, K.leftCols<6>());", "the rows of this Eigen matrix"),
        "shape": ("Matrix<4, 9> K; hybrid::joint_stiffness(q, F, K);", "this Eigen matrix has another shape"),
        "size": ("Matrix<6> x; mass_matrix(x);", "this Eigen object has another size"),
        "floats": ("Eigen::Matrix<float, 7, 1> x; mass_matrix(x);", "this Eigen object does not hold doubles"),
        "gone": ("map<7, 7>(mass_matrix(q));", "deleted function"),
    },
}
"""What must not compile, and what the compiler says."""
GOOD = {
    "plain": "double K[6][6] = {}; double *x = q;"
    "hybrid::joint_stiffness(Input<7>::at(x), F, K, Output<7, 7>::at(&big[0]));",
    "eigen": "Eigen::Matrix<double, 6, 6> K; hybrid::joint_stiffness(q, F, K.transpose());"
    "Eigen::VectorXd x(9); mass_matrix(x.segment<7>(1)); mass_matrix((q + q).eval());"
    "hybrid::joint_stiffness(q, F, Eigen::Map<Matrix<6, 6>>(K.data()), map<7, 7>(big));",
}
PREAMBLE = {
    "plain": '#include "iiwa14.hpp"\n#include <span>\n#include <vector>\n',
    # Eigen comes after the first time: the second one brings what it needs.
    "eigen": '#include "iiwa14.hpp"\n#include <Eigen/Core>\n#include "iiwa14.hpp"\n',
}
GIVEN = {"plain": "double q[7] = {}, F[6] = {}; ", "eigen": "Matrix<7> q; Matrix<6> F; "}


@pytest.mark.parametrize(
    ("compiler", "kind"),
    [
        ("g++", "plain"),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in (("g++", "eigen"), ("clang++", "plain"))),
        pytest.param("clang++", "eigen", marks=pytest.mark.wide),
    ],
)
def test_what_does_not_fit_is_refused_and_the_compiler_says_why(compiler, kind, made, tmp_path):
    """Compile the cases of REFUSED: one error each, with its reason; those of GOOD compile."""
    folder, _ = made("iiwa14")

    def compiled(cases: dict[str, str]) -> subprocess.CompletedProcess[str]:
        """Compile each case as a function in a file of its name."""
        bodies = [
            f'#line 1 "case_{case}"\nvoid {case}()\n{{ using namespace iiwa14; {GIVEN[kind]}{code} }}'
            for case, code in cases.items()
        ]
        (tmp_path / "main.cpp").write_text(
            PREAMBLE[kind] + "std::array<double, 49> big{};\n" + "\n".join(bodies) + "\n"
        )
        flags = ["-fmax-errors=0"] if compiler == "g++" else ["-ferror-limit=0"]
        line = [require_compiler(compiler), "-std=c++20", "-Wno-unused-result", *flags, "-fsyntax-only", f"-I{folder}"]
        line += ["-isystem", str(eigen())] if kind == "eigen" else []
        return subprocess.run([*line, str(tmp_path / "main.cpp")], capture_output=True, text=True, check=False)

    good = compiled({"good": GOOD[kind]})
    assert good.returncode == 0, good.stderr
    said = compiled({case: code for case, (code, _) in REFUSED[kind].items()})
    assert said.returncode != 0
    text = said.stderr.replace("\\'", "'")
    for case, (_, reason) in REFUSED[kind].items():
        assert f"case_{case}:2" in text, case
        assert reason in text, text
    assert len(re.findall(r"\berror:", text)) == len(REFUSED[kind]), text  # one reason, and no other error, for each


def test_a_column_major_matrix_of_the_wrong_size_gives_nan(made, tmp_path):
    """row_major of what is only known at run time: never a plausible number."""
    folder, objects = made("iiwa14")
    (tmp_path / "main.cpp").write_text(
        '#include <Eigen/Core>\n#include "iiwa14.hpp"\n#include <cmath>\n'
        "int main() { const Eigen::MatrixXd K = Eigen::MatrixXd::Identity(6, 5);"
        "const iiwa14::Matrix<7> q = iiwa14::Matrix<7>::Zero(); const std::array<double, 6> F{};"
        "return std::isnan(iiwa14::hybrid::joint_stiffness(q, F, iiwa14::row_major<6, 6>(K))[0]) ? 0 : 1; }\n"
    )
    line = [*command("g++", "c++17", True), f"-I{folder}", "-DNDEBUG", str(tmp_path / "main.cpp")]
    subprocess.run([*line, *(str(folder / each) for each in objects), "-o", str(tmp_path / "a"), "-lm"], check=True)
    assert subprocess.run([str(tmp_path / "a")], check=False).returncode == 0


@pytest.mark.slow
def test_two_robots_and_files_with_and_without_eigen_make_one_program(made, tmp_path):
    """Link files with and without Eigen, of two robots: no symbol is defined twice with different code."""
    one, objects = made("iiwa14")
    two, others = made("other")
    (tmp_path / "with.cpp").write_text(
        '#include <Eigen/Core>\n#include "other.hpp"\n#include "iiwa14.hpp"\n'
        "double with() { iiwa14::Matrix<7> q; q.setZero(); return iiwa14::mass_matrix(q)[0]; }\n"
    )
    (tmp_path / "without.cpp").write_text(
        '#include "iiwa14.hpp"\n#include "other.hpp"\ndouble with();\n'
        "int main() { const std::array<double, 7> q{}; const std::array<double, other::POSITIONS> x{};"
        "return !(with() == iiwa14::mass_matrix(q)[0] && other::left_hand::forward_kinematics(x)[15] == 1.0); }\n"
    )
    line = ["g++", "-std=c++17", "-isystem", str(eigen()), f"-I{one}", f"-I{two}", "with.cpp", "without.cpp"]
    linked = [str(one / each) for each in objects] + [str(two / each) for each in others]
    subprocess.run([*line, *linked, "-o", "a", "-lm"], cwd=tmp_path, check=True)
    assert subprocess.run([str(tmp_path / "a")], check=False).returncode == 0


def test_the_self_check_covers_the_controller(robot_folder, tmp_path):
    """Break the controller's build: its self-check must fail. Before, only the kernels' was called."""
    source = tmp_path / "main.cpp"
    source.write_text(
        '#include "iiwa14.hpp"\n'
        'extern "C" int iiwa14_self_check(void) { return 2; }\n'
        'extern "C" int iiwa14_impedance_self_check(void) { return 8; }\n'
        "int main() { return iiwa14::self_check(); }\n"
    )
    compiler = [require_compiler("g++"), "-std=c++17", "-O1", f"-I{robot_folder}"]
    subprocess.run([*compiler, str(source), "-o", str(tmp_path / "main")], check=True)
    assert subprocess.run([tmp_path / "main"], check=False).returncode == 10
