# SPDX-License-Identifier: MIT
"""The Makefile's targets are the ones that help prints; the benchmarks run with few rounds."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from stiffgen.core.emit.manifest import SHAPING
from support.project import ROOT


def test_help_prints_every_target() -> None:
    """Compare `make` with the Makefile: each target, and a time for all but three."""
    said = subprocess.run(["make", "--no-print-directory"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    words = set(re.findall(r"[\w-]+", said))
    makefile = (ROOT / "Makefile").read_text()
    targets = re.findall(r"^(?:\.PHONY: |EXAMPLES := )([a-z].*)$", makefile, re.MULTILINE)
    assert set(" ".join(targets).split()) <= words
    for target in ("experiment", "test"):  # those that a new user waits for
        assert re.search(rf"^  make {target} +.*\([0-9]+ minutes\)$", said, re.MULTILINE)
    timed = re.compile(r"\((\d+ (s|minutes?)|minutes( to hours)?|hours)[;)]")
    without = [line.split()[1] for line in said.splitlines() if not timed.search(line)]
    assert without == ["help", "clean", "lock"]


def wants_to_install(environment: Path) -> bool:
    """Return whether ``make lint`` would install the package into an environment again."""
    command = ["make", "-n", "lint", f"VENV={environment}"]
    said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return "--no-build-isolation --editable ." in said


def test_pip_gets_whole_arguments_and_its_failure_ends_make(tmp_path: Path) -> None:
    """Beside pip make prints the environment's size; commas of extras stay in one argument."""
    (tmp_path / "bin").mkdir()
    scripts = {"bin/pip": 'printf "%s\\n" "$@" >> "$0.said"', "python": "exit 0"}
    for name, script in scripts.items():
        (tmp_path / name).write_text(f"#!/bin/sh\n{script}\n")
        (tmp_path / name).chmod(0o755)
    command = ["make", str(tmp_path / "installed-test"), f"VENV={tmp_path}", f"PYTHON={tmp_path / 'python'}"]
    subprocess.run(command, cwd=ROOT, capture_output=True, check=True)
    said = (tmp_path / "bin" / "pip.said").read_text().splitlines()
    assert ".[test,lint]" in said and "lerobot>=0.4.4" in said and "--require-hashes" in said
    (tmp_path / "bin" / "pip").write_text("#!/bin/sh\nexit 3\n")
    (tmp_path / "installed").unlink()
    assert subprocess.run(command, cwd=ROOT, capture_output=True, check=False).returncode != 0
    assert not (tmp_path / "installed").exists()


def test_make_notices_what_is_installed(tmp_path: Path) -> None:
    """Install a copy, another clone's link or nothing: make notices, and keeps the link to this clone."""
    packages = tmp_path / "lib" / "python3.11" / "site-packages"
    packages.mkdir(parents=True)
    link = packages / "_stiffgen.pth"
    link.write_text(f"{ROOT / 'codegen'}")
    for stamp in ("installed", "installed-test"):
        (tmp_path / stamp).touch()
    assert not wants_to_install(tmp_path)
    link.rename(packages / "__editable__.stiffgen-0.3.0.pth")
    assert not wants_to_install(tmp_path)
    link.write_text("/elsewhere/codegen\n")
    (packages / "__editable__.stiffgen-0.3.0.pth").unlink()
    assert wants_to_install(tmp_path)
    link.unlink()
    assert wants_to_install(tmp_path)
    link.write_text(f"{ROOT / 'codegen'}\n")
    (packages / "stiffgen").mkdir()
    (packages / "stiffgen" / "__init__.py").touch()
    assert wants_to_install(tmp_path)


def test_pages_install_a_link_to_the_clone() -> None:
    """Look at the pages' install lines: a link, as a copy would hide later changes from make."""
    pattern = re.compile(r"pip install(?:\s+-[^e\s]\S*)*\s+'?(\.[/\['\s`]|\./?stiffgen\b|\$)")
    for file in [
        ROOT / "README.md",
        *(
            each
            for name in ("docs", "examples", "fri", "ros2", "codegen")
            for each in (ROOT / name).rglob("*")
            if each.suffix in (".md", ".py", ".j2", ".ipynb")
        ),
    ]:
        found = pattern.search(file.read_text())
        assert found is None, f"{file.relative_to(ROOT)}: {found and found[0]}"


def locked_versions() -> dict[str, list[str]]:
    """Return the versions of each package in requirements.lock, one per range of Python versions."""
    lines = (ROOT / "requirements.lock").read_text().splitlines()
    versions: dict[str, list[str]] = {}
    for name, version in (line.split(" ")[0].split("==") for line in lines if "==" in line.split(" ")[0]):
        versions.setdefault(name, []).append(version)
    return versions


def test_the_lock_satisfies_the_package() -> None:
    """Compare the lock with pyproject.toml: each dependency at an allowed version, no mesh libraries."""
    project = (ROOT / "pyproject.toml").read_text()
    required = (
        re.search(r'^requires = \["(.+)"\]', project, re.MULTILINE),
        re.search(r"^dependencies = \[\n(.*?)^\]", project, re.MULTILINE | re.DOTALL),
    )
    assert all(required)
    builder, packages = (found[1] for found in required if found)
    locked = locked_versions()
    for requirement in map(Requirement, [builder, *re.findall(r'"(.+)"', packages)]):
        versions = locked[requirement.name.lower()]
        assert all(version in requirement.specifier for version in versions), requirement
    for name in SHAPING:
        assert len(locked[name.lower()]) == 1, f"{name} shapes the generated bytes: one version for all"
    assert not locked.keys() & {"embreex", "manifold3d", "scipy", "shapely", "networkx"}
    text = (ROOT / "requirements.lock").read_text()
    assert text.count("--hash=sha256:") > 300
    assert "://" not in text  # no address of a registry


def test_floors_are_above_known_holes() -> None:
    """The first versions without CVE-2026-41066, CVE-2025-68146 and CVE-2025-27516."""
    project = (ROOT / "pyproject.toml").read_text()
    for name, mended in (("lxml", "6.1"), ("filelock", "3.20.1"), ("Jinja2", "3.1.6")):
        assert re.search(rf'^    "{name}>={re.escape(mended)}[",]', project, re.MULTILINE), name


@pytest.mark.parametrize("change", ["none", "text", "versions"])
def test_check_generated_names_other_versions(change: str, tmp_path: Path) -> None:
    """Replace the generator by a copy with an edit or another casadi: `make check-generated` tells which."""
    packages = tmp_path / "lib" / "python3.11" / "site-packages"
    packages.mkdir(parents=True)
    (packages / "_stiffgen.pth").write_text(str(ROOT / "codegen"))
    # $6 stands for the folder behind --output, which the generator gets as its fifth argument.
    edits = {"none": "true", "text": "echo >> $6/iiwa14/iiwa14.c"}
    edits["versions"] = f'{edits["text"]}; sed -i \'s/"casadi": .*/"casadi": "3.7.2",/\' $6/iiwa14/manifest.json'
    generator = tmp_path / "bin" / "stiffgen"
    generator.parent.mkdir()
    generator.write_text(f"#!/bin/sh\ncp -r {ROOT / 'generated' / 'iiwa14'} $5\n{edits[change].replace('$6', '$5')}\n")
    generator.chmod(0o755)
    (tmp_path / "installed").touch()
    command = ["make", "--no-print-directory", "check-generated", f"VENV={tmp_path}"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode == 0) == (change == "none"), done.stderr
    assert ("was made with other versions" in done.stderr) == (change == "versions")
    assert ("is what the generator writes" in done.stdout) == (change == "none")
    if change == "versions":
        assert "casadi:3.8.2" in done.stderr and "casadi:3.7.2" in done.stderr


BENCHMARK = """
import sys
from pathlib import Path

from benchmarks import growth, run, springs, throughput

throughput.COUNT, throughput.BLOCK = 1024, 256
run.COUNT, run.ROUNDS, run.BATCH, run.STREAMED, growth.JOINTS = 64, 3, 256, (2000,), (10, 12)
springs.COUNT, springs.SPRING_ROUNDS = 64, 5
found = run.shutil.which
slow = ("g++", "clang")  # a minute each
run.shutil.which = lambda tool, **given: None if tool in slow else found(tool, **given)
run.main(Path(sys.argv[1]))
"""


@pytest.mark.wide(instead="test_benchmark_of_a_step_runs")
def test_the_benchmark_runs(tmp_path: Path):
    """benchmarks/run.py with few rounds: what it times agrees, and its tables are whole."""
    before = (ROOT / "benchmarks" / "RESULTS.md").read_text()
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    done = subprocess.run(
        [sys.executable, "-c", BENCHMARK, str(tmp_path)],
        cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    written = (tmp_path / "RESULTS.md").read_text()
    assert [line for line in written.splitlines() if line.startswith("## ")] == [
        line.replace("65536", "256") for line in before.splitlines() if line.startswith("## ")
    ]
    assert written.count("| stiffgen") >= 9
    assert "Pinocchio C++, kinematic Hessian; g++ -O2: g++ is not installed" in written
    assert "disagrees" not in written
    assert (tmp_path / "results.svg").read_text().startswith("<svg")
    assert (ROOT / "benchmarks" / "RESULTS.md").read_text() == before


@pytest.mark.slow
def test_benchmark_of_a_step_runs() -> None:
    """Run the benchmark of a controller step with 2000 steps: it prints its two ratios."""
    script = ROOT / "benchmarks" / "impedance_step.py"
    core = min(os.sched_getaffinity(0))
    command = [sys.executable, str(script), "--steps", "2000", "--core", str(core)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("ratio of the medians") == 2
