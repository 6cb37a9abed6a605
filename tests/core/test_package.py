# SPDX-License-Identifier: MIT
"""A robot's folder as a package: pip, find_package, pkg-config, the README's examples, and the tool said everywhere."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import zipfile
from email.parser import Parser
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import stiffgen
from stiffgen.control.companions import COMPANIONS
from stiffgen.core.emit.render import render
from stiffgen.core.options import GenerationOptions
from support.project import URDF


def run(*command: str | Path, cwd: Path, **environment: str) -> str:
    """Run a command as a user does, whose CFLAGS are not set: CMake reads them."""
    own = {name: value for name, value in os.environ.items() if name != "CFLAGS"}
    done = subprocess.run(
        [str(part) for part in command],
        cwd=cwd, env={**own, **environment}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def example(folder: Path, language: str) -> str:
    """The README's program in a language."""
    found = re.search(rf"```{language}\n(.*?)```", (folder / "README.md").read_text(), re.DOTALL)
    assert found
    return found[1]


RELEASE = ".".join(stiffgen.__version__.split(".")[:2])
"""Release with which a library is compatible."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return stiffgen.generate(URDF, output=tmp_path_factory.mktemp("made"), build=False, kernels="hybrid")


@pytest.mark.wide(instead="test_find_package_knows_its_version")
def test_wheel_needs_numpy_alone_and_works_anywhere(folder: Path, robot: ModuleType, tmp_path: Path) -> None:
    """Build and install the robot's wheel: NumPy is its only need, and its example runs elsewhere."""
    before = sorted(folder.rglob("*"))
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet")
    run(*pip, "wheel", "--no-build-isolation", "--no-deps", "--wheel-dir", tmp_path, folder, cwd=tmp_path)
    assert sorted(folder.rglob("*")) == before  # the next 'stiffgen generate' finds its own files
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (metadata,) = (name for name in names if name.endswith("METADATA"))
        headers = Parser().parsestr(archive.read(metadata).decode())
    assert headers.get_all("Requires-Dist") == ["numpy>=1.26"]
    assert (headers["Name"], headers["Version"]) == ("stiffgen-iiwa14", stiffgen.__version__)
    (compiled,) = (name for name in names if name.endswith((".so", ".pyd")))
    assert compiled.startswith("iiwa14/python/iiwa14_python.")
    controllers = [f"{name}.{end}" for name in ("impedance", *COMPANIONS) for end in ("py", "pyi")]
    modules = [f"python/{name}" for name in ("_structs.py", *controllers, "casadi.py", "jax.py", "torch.py")]
    package = ("__init__.py", "__init__.pyi", "py.typed", "manifest.json", *modules)
    expected = {f"iiwa14/{file}" for file in package} | {compiled}
    assert {name for name in names if ".dist-info/" not in name} == expected
    run(*pip, "install", "--no-deps", "--no-index", "--target", tmp_path / "site", wheel, cwd=tmp_path)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    code = (
        example(folder, "python")
        + "print(iiwa14.__file__, iiwa14.Follow([0.0] * 7, sample_time=0.001).config['sample_time'])\n"
    )
    out = run(sys.executable, "-c", code, cwd=elsewhere, PYTHONPATH=str(tmp_path / "site"))
    *matrix, last = out.splitlines()
    assert last == f"{tmp_path / 'site' / 'iiwa14' / '__init__.py'} 0.001"
    printed = np.array(re.findall(r"-?\d+\.\d*(?:e[+-]\d+)?", " ".join(matrix)), dtype=float).reshape(7, 7)
    arguments = np.full(7, 0.1), np.array([0.0, 0, -10, 0, 0, 0]), np.diag([800.0, 800, 800, 50, 50, 50])
    np.testing.assert_allclose(printed, robot.hybrid.joint_stiffness(*arguments), rtol=0, atol=1e-6 * 800)


@pytest.fixture(scope="module")
def prefix(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the C library, installed and then moved."""
    work = tmp_path_factory.mktemp("installed")
    run(
        "cmake", "-S", folder, "-B", work / "build", "-DCMAKE_BUILD_TYPE=Debug", "-DIIWA14_DISPATCH=OFF", cwd=work
    )  # fmt: skip
    run("cmake", "--build", work / "build", cwd=work)
    run("cmake", "--install", work / "build", "--prefix", work / "first", cwd=work)
    return (work / "first").rename(work / "moved")


def test_installed_files_carry_the_name(prefix: Path) -> None:
    """Install the robot's library: all files carry its name, so that two robots fit beside each other."""
    installed = {path.relative_to(prefix).as_posix() for path in prefix.rglob("*") if path.is_file()}
    assert {
        "include/iiwa14.h",
        "include/iiwa14.hpp",
        "include/iiwa14_impedance.h",
        "include/iiwa14_sensor.h",
        *(f"include/iiwa14_{name}.h" for name in COMPANIONS),
        "lib/libiiwa14.a",
    } <= installed
    assert [path for path in installed if not Path(path).name.removeprefix("lib").startswith("iiwa14")] == []


def test_pkg_config_compiles_the_readmes_examples(
    folder: Path, prefix: Path, robot: ModuleType, tmp_path: Path
) -> None:
    """Compile the README's examples in C and C++ by pkg-config: the right number is printed."""
    (tmp_path / "example.c").write_text(example(folder, "c"))
    path = str(prefix / "lib" / "pkgconfig")
    flags = run("pkg-config", "--cflags", "--libs", "iiwa14", cwd=tmp_path, PKG_CONFIG_PATH=path).split()
    run("cc", "-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "example.c", *flags, "-o", "a", cwd=tmp_path)
    expected = robot.hybrid.jacobian([0.1, 0.2, 0.3, 0, 0, 0, 0])[0, 0]
    assert float(run(tmp_path / "a", cwd=tmp_path)) == pytest.approx(expected, abs=1e-6)
    (tmp_path / "example.cpp").write_text(example(folder, "cpp"))
    run(
        "c++", "-std=c++17", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "example.cpp", *flags, "-o", "b", cwd=tmp_path
    )
    assert run(tmp_path / "b", cwd=tmp_path) == run(tmp_path / "a", cwd=tmp_path)
    assert (
        run("pkg-config", "--modversion", "iiwa14", cwd=tmp_path, PKG_CONFIG_PATH=path).strip() == stiffgen.__version__
    )


def test_a_shared_library_is_built_where_the_project_asks_for_one(folder: Path, tmp_path: Path) -> None:
    """BUILD_SHARED_LIBS: one .so with all functions, found and run from where it is installed.

    The project's settings for its own targets change nothing: before, hidden functions did not link, and a unity build
    had static functions twice.
    """
    flags = ["-DCMAKE_BUILD_TYPE=None", "-DCMAKE_C_FLAGS=-O0", "-DIIWA14_DISPATCH=OFF", "-DBUILD_SHARED_LIBS=ON"]
    flags += ["-DCMAKE_C_VISIBILITY_PRESET=hidden", "-DCMAKE_UNITY_BUILD=ON", "-DCMAKE_C_EXTENSIONS=OFF"]
    run("cmake", "-S", folder, "-B", tmp_path / "build", *flags, cwd=tmp_path)
    run("cmake", "--build", tmp_path / "build", cwd=tmp_path)
    run("cmake", "--install", tmp_path / "build", "--prefix", tmp_path / "prefix", cwd=tmp_path)
    libraries = {path.name for path in (tmp_path / "prefix" / "lib").iterdir() if path.is_file()}
    assert libraries == {"libiiwa14.so", f"libiiwa14.so.{stiffgen.__version__}", f"libiiwa14.so.{RELEASE}"}
    (tmp_path / "example.c").write_text(example(folder, "c"))
    flags = run(
        "pkg-config", "--cflags", "--libs", "iiwa14",
        cwd=tmp_path, PKG_CONFIG_PATH=str(tmp_path / "prefix" / "lib" / "pkgconfig"),
    ).split()  # fmt: skip
    run("cc", "-std=c99", "example.c", *flags, "-o", "a", cwd=tmp_path)
    assert float(run(tmp_path / "a", cwd=tmp_path, LD_LIBRARY_PATH=str(tmp_path / "prefix" / "lib")))


@pytest.mark.parametrize(
    ("asked", "found"),
    [("", True), (RELEASE, True), (stiffgen.__version__, True), ("0.2", False), ("0.99", False), ("1.0", False)],
)
def test_find_package_knows_its_version(folder: Path, prefix: Path, asked: str, found: bool, tmp_path: Path) -> None:
    """Ask CMake for versions: compatible ones are found, others refused."""
    (tmp_path / "example.c").write_text(example(folder, "c"))
    (tmp_path / "CMakeLists.txt").write_text(
        f"cmake_minimum_required(VERSION 3.18)\nproject(app LANGUAGES C)\nfind_package(iiwa14 {asked} REQUIRED)\n"
        "add_executable(app example.c)\ntarget_link_libraries(app PRIVATE iiwa14::iiwa14)\n"
    )
    command = ["cmake", "-S", ".", "-B", "build", f"-DCMAKE_PREFIX_PATH={prefix}"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode == 0) == found, done.stderr
    if found and asked == RELEASE:
        run("cmake", "--build", "build", cwd=tmp_path)
        assert float(run(tmp_path / "build" / "app", cwd=tmp_path))


FEW = GenerationOptions(controller=False, kernels=("hybrid.jacobian",))
FULL = stiffgen.Tool((0.0, 0.0, 0.24), (0.1, 0.2, 0.3), 0.5, (0.0, 0.0, 0.1), (0.01, 0.0, 0.0, 0.02, 0.0, 0.015))
TOOLS = {
    "whole": (FULL, "its inertia about that 0.01 0 0 0.02 0 0.015 kg m^2"),
    "point mass": (
        stiffgen.Tool(FULL.xyz, FULL.rpy, 0.5, FULL.com),
        "Without an inertia it is a point mass in the mass matrix",
    ),
    "no mass": (stiffgen.Tool(FULL.xyz), "It has no mass: the mass matrix is that of the bare arm"),
}


@pytest.mark.parametrize("kind", TOOLS)
def test_the_tool_is_said_in_header_readme_and_python(kind: str) -> None:
    """Generate with a tool: header, README and Python module state its data."""
    tool, said = TOOLS[kind]
    texts = render(stiffgen.load_chain(URDF, tool=tool), "arm", FEW)
    for file in ("arm.h", "README.md"):
        text = " ".join(texts[file].replace("\n *", " ").split())
        assert "xyz 0 0 0.24 m" in text
        assert said in text, file
    line = re.search(r"^TOOL = (\{.*?^\})", texts["__init__.py"], re.DOTALL | re.MULTILINE)
    assert line
    assert eval(line[1]) == {key: getattr(tool, key) for key in ("xyz", "rpy", "mass", "com", "inertia")}
    assert "TOOL: Final[_Tool | None]" in texts["__init__.pyi"]


def test_what_is_said_of_a_tool_without_masses_and_at_run_time() -> None:
    bare = render(stiffgen.load_chain(URDF, tool=FULL, masses=False), "arm", FEW)
    assert "Its mass is ignored, as all masses are." in " ".join(bare["arm.h"].replace("\n *", " ").split())
    held = stiffgen.Tool(mass=0.5, com=FULL.com)
    late = render(stiffgen.load_chain(URDF, tool=held, runtime_tool=True), "arm", FEW)["README.md"]
    assert "0.5 kg" in late and "takes the tip's place" not in late


@pytest.mark.slow
def test_no_tool(robot: ModuleType, tmp_path: Path, unoptimised: None) -> None:
    assert robot.TOOL is None
    options = {"kernels": "limits", "batches": False, "controller": False}
    folder = stiffgen.generate(URDF, name="wiper", tool=FULL, output=tmp_path, **options)
    assert stiffgen.open_robot(folder).module.TOOL["mass"] == FULL.mass
    assert "TOOL" in robot.__all__


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "optimised"),
    [((), True), (("-DCMAKE_BUILD_TYPE=Debug",), False), (("-DCMAKE_C_FLAGS=-O1",), False)],
)
def test_a_project_without_a_build_type_gets_optimised_code(
    folder: Path, tmp_path: Path, options: tuple[str, ...], optimised: bool
) -> None:
    """Add the robot by add_subdirectory: optimised, unless the user states a build type or level."""
    (tmp_path / "CMakeLists.txt").write_text(
        f"cmake_minimum_required(VERSION 3.18)\nproject(app C)\nadd_subdirectory({folder} arm)\n"
    )
    run("cmake", "-S", ".", "-B", "build", "-DCMAKE_EXPORT_COMPILE_COMMANDS=ON", *options, cwd=tmp_path)
    commands = json.loads((tmp_path / "build" / "compile_commands.json").read_text())
    kernels = [each["command"] for each in commands if each["file"].endswith("/iiwa14.c")]
    assert kernels
    assert {" -O2 " in command for command in kernels} == {optimised}
