# SPDX-License-Identifier: MIT
"""Robots share programs and include folders: whatever a folder exports or installs carries the robot's prefix."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

import stiffgen
from stiffgen.control.companions import COMPANIONS
from stiffgen.core.emit import backend
from stiffgen.core.emit.render import render
from stiffgen.core.options import GenerationOptions
from support.project import URDF

FEW = GenerationOptions(kernels="limits")
"""The controller brings the functions that it calls."""
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror", "-O0")
MAIN = """
#include <stdio.h>
#include "left_impedance.h"
#include "right_impedance.h"

int main(void)
{
    const double q[7] = {0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7};
    double a[16], b[16];
    left_impedance_config left_config;
    right_impedance_config right_config;
    left_impedance_state left_state;
    right_impedance_state right_state;
    left_forward_kinematics(q, a);
    right_forward_kinematics(q, b);
    left_impedance_default_config(&left_config);
    right_impedance_default_config(&right_config);
    left_config.sample_time = right_config.sample_time = 0.001;
    left_config.delay_samples = right_config.delay_samples = 0;
    left_config.heaviest_wrench[0] = right_config.heaviest_wrench[0] = 50.0;
    left_config.heaviest_wrench[1] = right_config.heaviest_wrench[1] = 10.0;
    for (int i = 0; i < 7; ++i) {
        left_config.motor_inertia[i] = right_config.motor_inertia[i] = 0.1;
    }
    right_config.sample_time = -1.0;
    const int good = left_impedance_init(&left_config, &left_state, NULL);
    const int bad = right_impedance_init(&right_config, &right_state, NULL);
    printf("%.17g %.17g %d %d %s\\n", a[11], b[11], good == LEFT_OK, bad == RIGHT_OK, right_impedance_error_text(bad));
    return 0;
}
"""


def run(*command: str | Path) -> str:
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the files of two robots of two versions of the generator."""
    folder = tmp_path_factory.mktemp("pair")
    with pytest.MonkeyPatch.context() as patch:
        for name, robot, version in (("left", "iiwa14", "0.1.0"), ("right", "iiwa7", "9.9.9")):
            patch.setattr(backend, "__version__", version)
            for file, text in render(stiffgen.load_chain(URDF.parent / f"{robot}.urdf"), name, FEW).items():
                if file.endswith((".c", ".h", ".hpp")) and "/" not in file:
                    assert file.startswith(name)
                    (folder / file).write_text(text)
    (folder / "main.c").write_text(MAIN)
    return folder


@pytest.fixture(scope="module")
def objects(pair: Path) -> dict[str, Path]:
    """Return the compiled sources by the name of their file."""
    compiled = {}
    for stem in (
        f"{name}{part}"
        for name in ("left", "right")
        for part in ("", "_batch", "_impedance", *(f"_{each}" for each in COMPANIONS))
    ):
        compiled[stem] = pair / f"{stem}.o"
        run("gcc", *STRICT, "-fPIC", "-c", pair / f"{stem}.c", "-o", compiled[stem])
    return compiled


@pytest.mark.slow
def test_two_robots_and_two_versions_in_one_program(pair: Path, objects: dict[str, Path]) -> None:
    run("gcc", *STRICT, f"-I{pair}", *objects.values(), pair / "main.c", "-lm", "-o", pair / "program")
    left, right, good, bad, text = run(pair / "program").split(maxsplit=4)
    assert float(left) != float(right)
    assert (good, bad) == ("1", "0")
    assert text.startswith("sample_time")


@pytest.mark.slow
def test_two_robots_in_one_shared_library(pair: Path, objects: dict[str, Path]) -> None:
    """Link two robots into one library: each symbol has its robot's prefix."""
    library = pair / "libarms.so"
    run("gcc", "-shared", *objects.values(), "-lm", "-o", library)
    run(
        "gcc", *STRICT, f"-I{pair}", pair / "main.c", f"-L{pair}", "-larms", f"-Wl,-rpath,{pair}", "-o", pair / "shared"
    )
    assert run(pair / "shared").split()[2:4] == ["1", "0"]
    exported = {line.split()[-1] for line in run("nm", "-D", "--defined-only", library).splitlines()}
    assert {"left_mass_matrix", "right_impedance_step", "left_policy_start", "right_find_posture"} <= exported
    assert {name for name in exported if not re.match(r"left_|right_", name)} == set()


@pytest.mark.parametrize("part", ["impedance", *COMPANIONS])
@pytest.mark.parametrize("name", ["left", "right"])
def test_headers_name_nothing_without_the_prefix(pair: Path, name: str, part: str) -> None:
    """Macros, enumerators, types and functions of a robot's headers, as the preprocessor and the compiler see them."""
    header = pair / f"{name}_{part}.h"
    (pair / "only.c").write_text(f'#include "{header.name}"\n')
    (pair / "base.c").write_text("#include <stddef.h>\n#include <stdint.h>\n")
    macros = [set(run("gcc", "-std=c99", "-dM", "-E", pair / file).splitlines()) for file in ("only.c", "base.c")]
    added = {line.split()[1] for line in macros[0] - macros[1]}
    assert added
    assert {macro for macro in added if not macro.startswith(f"{name.upper()}_")} == set()
    for file in (pair / f"{name}.h", header):
        text = re.sub(r"/\*.*?\*/", "", file.read_text(), flags=re.DOTALL)
        for body in re.findall(r"enum\b[^{;]*\{(.*?)\}", text, flags=re.DOTALL):
            words = [word.split("=")[0].strip() for word in body.split(",")]
            assert [word for word in words if not word.startswith(f"{name.upper()}_")] == []
        types = re.findall(r"^\}\s*(\w+);|\b(?:struct|enum)\s+(\w+)", text, re.MULTILINE)
        assert [word for pair_ in types for word in pair_ if word and not word.startswith(f"{name}_")] == []
        assert "stiffgen_" not in text and "STIFFGEN_" not in text
