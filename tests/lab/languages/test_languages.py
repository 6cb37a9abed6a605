# SPDX-License-Identifier: MIT
"""A fault in another language of a folder is found without its text, and what is not compared does not pass."""

from __future__ import annotations

import ctypes
import json
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import pytest

import stiffgen
from stiffgen.cli import main
from stiffgen.core.opened import GeneratedRobot, open_robot
from stiffgen.core.verify.folder.files import check_text, print_again
from stiffgen.core.verify.folder.widths import WIDTHS, build_widths
from stiffgen.core.verify.kernels.batches import LONG
from stiffgen.core.verify.kernels.samples import argument_samples
from stiffgen.core.verify.result import attempted, faultless, one_by_one
from stiffgen.lab.languages import wrappers
from stiffgen.lab.languages.check import check_languages
from stiffgen.lab.languages.cpp import check_cpp
from stiffgen.lab.languages.material import Material
from stiffgen.lab.languages.sensor_header import check_sensor_header
from stiffgen.lab.languages.wrappers import check_wrappers
from support.chains import chain_urdf
from support.folders import copy_folder, restamp

KERNELS = ("forward_kinematics", "hybrid.joint_stiffness", "manipulability", "manipulability_gradient")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of an arm with controller, sensor and derivatives, of few functions."""
    output = tmp_path_factory.mktemp("languages")
    (output / "arm.urdf").write_text(chain_urdf("rpr"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CFLAGS", "-O0")
        sensor = stiffgen.Sensor("l3")
        return stiffgen.generate(
            output / "arm.urdf", output=output, name="arm", kernels=KERNELS, derivatives=True, sensor=sensor
        )


@pytest.fixture(scope="module")
def library(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """Return a library of the folder's kernels."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("stiffgen.core.verify.folder.widths.WIDTHS", WIDTHS[:2])
        return next(iter(build_widths(open_robot(folder), tmp_path_factory.mktemp("kernels")).values()))


def material_of(robot: GeneratedRobot, library: ctypes.CDLL, build: Path, *, other_version: bool = False) -> Material:
    pool = argument_samples(robot.chain, LONG, 0, robot.springs)
    single = {name: one_by_one(kernel) for name, kernel in robot.kernels.items()}
    build.mkdir()
    return Material(robot, single, pool, Path(library._name), build, print_again(robot), other_version)


@pytest.mark.slow
def test_every_language_passes(folder: Path, library: ctypes.CDLL, tmp_path: Path) -> None:
    """Verify all languages of a small robot: each installed one is compared and passes."""
    shared = material_of(open_robot(folder), library, tmp_path / "build")
    given = shared.robot, shared.single, shared.pool, tmp_path / "languages", False
    checks = check_languages(*given, {"one": library}, shared.texts)
    assert [check for check in checks if not check.passed] == []
    compared = [check.kernel for check in checks if not check.oracle.startswith("nothing")]
    installed = [each for each in ("casadi", "torch", "jax") if find_spec(each)]
    assert compared == ["arm.hpp", "arm_sensor.h", *(f"python/{each}.py" for each in installed)]


CPP, SENSOR, CASADI, CALLS = "arm.hpp", "arm_sensor.h", "python/arm_casadi.c", "python/arm_calls.c"
NEEDS_TORCH = pytest.mark.skipif(find_spec("torch") is None, reason="PyTorch is not installed")
DAMAGES = [
    pytest.param(CPP, [
        ("::arm_manipulability(q.data(), &value)", "value = 1.0", "manipulability, returned"),
        ("::arm_manipulability(q.data(), &man", "::arm_manipulability(q.data() + 1, &man", "manipulability, written"),
        ("return ::arm_impedance_reset(&state_);", "return 1;", "reset"),
    ], id="C++ calls another function"),
    pytest.param(CPP, [
        ("arm_hybrid_joint_stiffness_batch(count, q, q_step", "arm_hybrid_joint_stiffness_batch(count, q, 0",
         "hybrid_joint_stiffness_batch"),
        ("= ::arm_lower;", "= ::arm_upper;", "LOWER, UPPER"),
        ("&state_, torque.data()", "&state_, nullptr", "step, report"),
    ], id="C++ hands on something else", marks=pytest.mark.slow),
    pytest.param(SENSOR, [
        ("wrench[i] += V[i][k] * along;", "wrench[i] -= V[i][k] * along;", "external_wrench"),
        ("- (a1 + 2.0 * a2) / (1.0 + a1 + a2)", "", "delay"),
    ], id="wrench and delay of the sensor header"),
    pytest.param(SENSOR, [
        ("unexplained[i] -= ", "unexplained[i] += ", "external_wrench, unexplained"),
        ("cos(6.283185307179586 * ", "cos(6.183185307179586 * ", "notch: gain"),
        ('"\\"bias\\"", bias', '"\\"noise\\"", bias', "read_calibration"),
    ], id="notch and file of the sensor header"),
    pytest.param(SENSOR, [("s[1] = filter->b[2] * x - ", "s[1] = filter->b[2] * x + ", "filter_step")],
                 id="state of a filter"),
    pytest.param(CASADI, [("arm_manipulability_vjp_call,", "arm_forward_kinematics_vjp_call,", "lability, reverse")],
                 id="CasADi calls another product", marks=pytest.mark.slow),
    pytest.param(CALLS, [("= from[e * rows", "= -from[e * rows", "forward derivative")],
                 id="sign in CasADi's Jacobian", marks=pytest.mark.slow),
    pytest.param("python/casadi.py", [("_casadi_{function.name}", "_casadi_manipulability", "rror")],
                 id="CasADi's module", marks=pytest.mark.slow),
    pytest.param("python/torch.py", [("return list(each)", "return [-gradient for gradient in each]", "reverse")],
                 id="sign in PyTorch's gradient", marks=[NEEDS_TORCH, pytest.mark.slow]),
    pytest.param("python/torch.py", [("change = change + (", "change = change - (", "forward derivative")],
                 id="sign in PyTorch's tangent", marks=[NEEDS_TORCH, pytest.mark.slow]),
    pytest.param("python/jax.py", [("return list(gradients)", "return [-each for each in gradients]", "reverse")],
                 id="sign in JAX's gradient", marks=pytest.mark.slow),
]  # fmt: skip
"""File, and its changes: text, replacement, words of the row that fails."""


@pytest.mark.slow
@pytest.mark.parametrize(("file", "changes"), DAMAGES)
def test_a_damage_is_found_by_numbers(
    file: str, changes: list[tuple[str, str, str]], folder: Path, library: ctypes.CDLL, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Damage a folder: its numbers tell, also where the text is not compared."""
    damaged = copy_folder(folder, tmp_path)
    text = (damaged / file).read_text()
    for old, new, _ in changes:
        assert old in text
        text = text.replace(old, new)
    (damaged / file).write_text(text)
    restamp(damaged)
    framework = {"jax.py": "jax", "torch.py": "torch"}.get(Path(file).name, "casadi")
    monkeypatch.setattr(wrappers, "_PACKAGES", {framework: wrappers._PACKAGES[framework]})
    check = {CPP: check_cpp, SENSOR: check_sensor_header}.get(file, check_wrappers)
    material = material_of(open_robot(damaged), library, tmp_path / "build")
    details = " ".join(row.detail for row in check(material) if row.verdict == "FAILED")
    assert [words for *_, words in changes if words not in details] == []


def with_versions(folder: Path, stiffgen_version: str) -> None:
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["versions"]["stiffgen"] = stiffgen_version
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=1) + "\n")


@pytest.mark.slow
def test_text_of_another_version_is_not_compared_and_does_not_pass(folder: Path, tmp_path: Path) -> None:
    """Verify a damaged folder of another version: not compared, and no pass. Before: exit code 0."""
    other = copy_folder(folder, tmp_path)
    (other / "arm.h").write_text((other / "arm.h").read_text().replace("[N m/rad]", "[N m/deg]"))
    restamp(other)
    with_versions(other, "0.2.9")
    texts = print_again(open_robot(folder))
    check = check_text(open_robot(other), texts)
    assert (check.verdict, check.passed) == ("not compared", False)
    assert "stiffgen 0.2.9" in check.detail and "arm.h differs" in check.detail
    accepted = check_text(open_robot(other), texts, other_version=True)
    assert (accepted.verdict, accepted.passed) == ("not compared", True)


@pytest.mark.slow
@pytest.mark.usefixtures("unoptimised", "narrowest_width")
def test_the_command_tells_what_is_not_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Verify a folder of another version: the texts are not compared, which the command says and fails for."""
    (tmp_path / "arm.urdf").write_text(chain_urdf("rr"))
    small = stiffgen.generate(
        tmp_path / "arm.urdf", output=tmp_path, name="arm", kernels="forward_kinematics", controller=False
    )
    with_versions(small, "0.2.9")
    assert main(["verify", str(small), "--samples", "5"]) == 1
    out = capsys.readouterr().out
    assert "comparisons within their bound, 1 not compared" in out and "FAILED" not in out
    assert "NOT COMPARED text, printed again: the folder was made by stiffgen 0.2.9" in out
    assert "Not of this robot: slide, " in out
    assert main(["verify", str(small), "--samples", "5", "--other-version"]) == 0
    header = (small / "arm.hpp").read_text()
    (small / "arm.hpp").write_text(header.replace("::arm_forward_kinematics(q.data(), value.data());", ""))
    restamp(small)
    assert main(["verify", str(small), "--samples", "5", "--other-version"]) == 1
    assert "FAILED arm.hpp, C functions, in bits: forward_kinematics, returned" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("module", ["cpp", "jax"])
def test_a_missing_tool_passes_only_with_the_generators_text(
    module: str, folder: Path, library: ctypes.CDLL, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Take the compiler or JAX away: passes only if the text is what this generator prints."""
    other = copy_folder(folder, tmp_path)
    material = material_of(open_robot(other), library, tmp_path / "build")
    monkeypatch.setenv("CXX", "no-such-compiler")
    monkeypatch.setattr(wrappers, "_PACKAGES", {"jax": ("no_such_package", "JAX")})
    check, file = (check_cpp, CPP) if module == "cpp" else (check_wrappers, "python/jax.py")
    (row,) = check(material)
    assert row.passed and row.oracle.endswith("the text is this generator's"), row
    with (other / file).open("a") as text:
        text.write("\n")
    for accepted in (False, True):
        (row,) = check(replace(material, other_version=accepted, build=tmp_path / f"build {accepted}"))
        assert (row.verdict, row.passed) == ("not compared", accepted)
        assert "no-such-compiler" in row.detail or "pip install no_such_package" in row.detail


@pytest.mark.slow
def test_a_missing_c_compiler_is_no_pass_and_a_failing_one_is_a_fault(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Take the compiler away, or break the source: not compared, and failed. Before, both passed."""
    broken = copy_folder(folder, tmp_path)
    (broken / "arm.c").write_text("int broken(\n")
    step = partial(build_widths, open_robot(broken), tmp_path)
    (row,) = attempted("batches in C", lambda: [faultless("", "", list(step()))])
    assert (row.verdict, row.oracle) == ("FAILED", "compiles") and "broken" in row.detail
    monkeypatch.setenv("CC", "no-such-compiler")
    (row,) = attempted("batches in C", lambda: [faultless("", "", list(step()))])
    assert (row.verdict, row.passed) == ("not compared", False) and "no-such-compiler" in row.detail
