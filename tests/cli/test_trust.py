# SPDX-License-Identifier: MIT
"""The source of potentials in a folder's manifest: only verification runs it, and only when it is trusted."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

import stiffgen
from stiffgen import open_robot
from stiffgen.cli import main
from stiffgen.core.errors import PotentialError
from stiffgen.core.symbolic.model import casadi_function
from support.chains import chain_urdf

BOWL = """import casadi as ca

def bowl(p, R, parameters):
    away = p - parameters.centre
    return parameters.stiffness * ca.dot(away, away) ** 2 / 4

bowl.parameters = {"stiffness": (), "centre": (3,), "axes": (3, 2)}
"""


@pytest.fixture
def folder(tmp_path: Path, unoptimised) -> Path:
    """Return a compiled folder whose manifest holds the source of a program that makes the file ``escaped``."""
    (tmp_path / "arm.urdf").write_text(chain_urdf("rr"))
    (tmp_path / "bowl.py").write_text(BOWL)
    words = ["--potential", f"{tmp_path / 'bowl.py'}:bowl", "--no-controller", "--no-masses", "--name", "arm"]
    assert main(["generate", str(tmp_path / "arm.urdf"), *words, "--output", str(tmp_path)]) == 0
    manifest = json.loads((tmp_path / "arm" / "manifest.json").read_text())
    (record,) = manifest["springs"]["potentials"]
    record["source"] = f"open({str(tmp_path / 'escaped')!r}, 'w').close()\n{record['source']}"
    (tmp_path / "arm" / "manifest.json").write_text(json.dumps(manifest))
    return tmp_path / "arm"


@pytest.mark.slow
def test_only_trusted_verification_runs_the_source(folder, monkeypatch, capsys):
    """Open a folder whose potential has side effects: its source runs only after --trust-potentials or "y"."""
    escaped = folder.parent / "escaped"
    assert "bowl" in repr(open_robot(folder))
    with monkeypatch.context() as patched:
        patched.setenv("PATH", "")  # they open the folder, and end where their programs are absent
        main(["prove", str(folder)])
        main(["play", str(folder), "--output", str(folder.parent / "page")])
    assert main(["verify", str(folder)]) == 2
    error = capsys.readouterr().err
    assert "(bowl); read it, then pass --trust-potentials" in " ".join(error.split()) and "Traceback" not in error
    robot = stiffgen.open_robot(folder)
    assert "parameter_centre" in repr(robot.kernels["bowl_energy"].__doc__)
    (energy,) = (each for each in robot.table if each.qualified_name == "bowl_energy")
    with pytest.raises(PotentialError, match="is not run"):
        casadi_function(robot.chain, energy)
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    for answer in ("", "n", "no"):
        monkeypatch.setattr("builtins.input", lambda answer=answer: answer)
        assert main(["verify", str(folder)]) == 2
    assert "Run it? [y/N]" in capsys.readouterr().out
    assert not escaped.exists()
    trusted = stiffgen.open_robot(folder, trust_potentials=True)
    assert escaped.exists()  # the test's own program works
    records = [[(each.qualified_name, each.arguments) for each in one.table] for one in (robot, trusted)]
    assert records[0] == records[1]
    escaped.unlink()
    asked = []
    monkeypatch.setattr("stiffgen.cli.verify.verify", lambda folder, **words: asked.append(words) or [])
    monkeypatch.setattr("builtins.input", lambda: "y")
    main(["verify", str(folder)])
    main(["verify", str(folder), "--trust-potentials"])
    assert [words["trust_potentials"] for words in asked] == [True, True]


def test_a_source_that_is_a_pipe_is_refused(tmp_path, capsys):
    os.mkfifo(tmp_path / "bowl.py")
    (tmp_path / "arm.urdf").write_text(chain_urdf("rr"))
    assert main(["generate", str(tmp_path / "arm.urdf"), "--potential", f"{tmp_path / 'bowl.py'}:bowl"]) == 2
    assert "is not a regular file; name a Python file" in capsys.readouterr().err
