# SPDX-License-Identifier: MIT
"""Every target of the Makefile is run by .ci/run or by a test: the programs that take long, for a moment."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from support.project import ROOT

PROGRAMS = {
    "random-robots": "tests/campaigns/long_run.py --chains 2 --broken 2 --joints 4",
    "random-warnings": "tests/campaigns/compiler_warnings.py 1 2 0",
    "spring-digits": "tests/campaigns/springs_digits.py 1 1 pose",
    "rounding-errors": "tests/campaigns/rounding_errors.py --states 400 --width SSE2",
    "targets": "tests/campaigns/targets.py --states 16 --machines aarch64 --functions hybrid_jacobian",
    "single-precision": "benchmarks/single_precision.py --states 10000 --width SSE2 --kernels hybrid_jacobian",
    "float-sines": "tests/campaigns/float_sines.py --builds 'gcc, SSE2' --every 16",
    "soak": "tests/campaigns/soak.py --steps 300 --pencils 20",
    "settle": "tests/campaigns/settle.py --count 2",
    "energy": "tests/campaigns/energy.py --count 4 --climb 2",
    "hostile": "tests/campaigns/hostile.py --steps 2000 --flips 20",
    "fri-fuzz": "tests/campaigns/fuzz_fri.py {folder} --version 2.7 -runs=50 -seed=1",
    "fri-attack": "tests/campaigns/attack_fri.py {folder} --version 2.7 --sessions 20",
}
"""What the targets run, with less of it."""
ELSEWHERE = {
    "generate": "tests/contract/folder/test_generate.py",
    "bench": "tests/contract/house/test_make.py",
    "bench-cuda": "tests/contract/bindings/test_cuda.py",
    "experiment": "tests/oracle/examples/test_experiment.py",
    "adaptive": "tests/oracle/examples/test_adaptive.py",
    "optimal-control": "tests/oracle/examples/test_optimal_control.py",
    "identify": "tests/oracle/examples/test_identify.py",
    "whole-body": "tests/oracle/examples/test_whole_body.py",
    "fri-demo": "tests/contract/fri/test_fri_session.py",
    "closed-loop": "tests/contract/house/test_make.py",
}
"""Targets that a test runs in another way. closed-loop is settle, energy and hostile."""
BY_HAND = {"clean", "robots", "test-torch", "test-drake", "identify-torch"}
"""Removes files; downloads packages of robots; downloads PyTorch, Drake."""


def test_every_target_is_run_by_somebody():
    targets = set(re.search(r"^\.PHONY:(.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE)[1].split())
    by_ci = set(re.findall(r"^make (\S+)", (ROOT / ".ci" / "run").read_text(), re.MULTILINE))
    assert targets == by_ci | PROGRAMS.keys() | ELSEWHERE.keys() | BY_HAND
    assert all((ROOT / file).exists() for file in ELSEWHERE.values())


@pytest.mark.parametrize("target", PROGRAMS)
def test_a_target_runs_its_program(target):
    recipes = subprocess.run(
        ["make", "--dry-run", "--always-make", target], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    assert PROGRAMS[target].split()[0] in recipes


@pytest.mark.slow
@pytest.mark.parametrize("target", PROGRAMS)
def test_the_program_runs(target, tmp_path):
    command = shlex.split(PROGRAMS[target].format(folder=tmp_path))
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT / "tests"), str(ROOT), *sys.path])}
    done = subprocess.run(
        [sys.executable, *command], cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


BENCHMARK = """
import sys
from pathlib import Path

from benchmarks import run, throughput

throughput.COUNT, throughput.BLOCK = 1024, 256
run.COUNT, run.ROUNDS, run.SPRING_ROUNDS, run.BATCH, run.STREAMED, run.JOINTS = 64, 3, 5, 256, (2000,), (10, 12)
found = run.shutil.which
run.shutil.which = lambda tool, **given: None if tool == "g++" else found(tool, **given)  # its templates take minutes
run.main(Path(sys.argv[1]))
"""


@pytest.mark.slow
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
