# SPDX-License-Identifier: MIT
"""Files of a folder are compared with the manifest before any of them is run; evidence covers every C source."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import math
import py_compile
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from stiffgen.cli import main
from stiffgen.core.errors import OutputError
from stiffgen.core.opened import open_robot
from stiffgen.core.verify.folder.files import check_files, check_text, load_module, print_again
from stiffgen.core.verify.verify import verify
from stiffgen.lab.prove.safety_page import filed_for, targets_for
from stiffgen.lab.prove.targets import read_targets
from stiffgen.lab.prove.verdict import read_verdicts
from support.folders import copy_folder, restamp
from support.project import ROOT

FOLDER = ROOT / "generated" / "iiwa14"


def planted(folder: Path) -> str:
    """Return a line of Python that leaves a mark beside ``folder`` when it is run."""
    return f"open({str(folder.parent / 'mark')!r}, 'w').close()\n"


@pytest.mark.parametrize(
    "file", ["__init__.py", "python/impedance.py", "numpy.py", "iiwa14_other.so", "extra/notes.txt"]
)
def test_nothing_of_a_folder_with_other_files_is_run(file: str, robot_folder: Path, tmp_path: Path) -> None:
    """Plant code in a folder: `verify` reports the file and runs nothing of the folder."""
    folder = copy_folder(robot_folder, tmp_path)
    (folder / file).parent.mkdir(exist_ok=True)
    before = (folder / file).read_text() if (folder / file).exists() else ""
    (folder / file).write_text(planted(folder) + before)
    files, functions = verify(folder)
    assert not files.passed and file in files.detail
    assert not functions.passed and functions.oracle == "not run"
    assert not (tmp_path / "mark").exists()


def test_a_link_to_a_package_is_not_imported(robot_folder: Path, tmp_path: Path) -> None:
    """Python prefers a package to the compiled module of the same name, and a link to a folder has no files."""
    folder, other = copy_folder(robot_folder, tmp_path), tmp_path / "other"
    other.mkdir()
    (other / "__init__.py").write_text(planted(folder))
    (folder / "iiwa14_python").symlink_to(other)
    files, functions = verify(folder)
    assert "iiwa14_python" in files.detail and functions.oracle == "not run"
    assert not (tmp_path / "mark").exists()


@pytest.mark.parametrize("read", [read_verdicts, read_targets])
def test_evidence_is_a_regular_file(read: Callable[[Path], Any]) -> None:
    with pytest.raises(OutputError, match="no regular file"):
        read(Path("/dev/zero"))


def test_bytecode_beside_the_sources_is_not_run(
    robot_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Plant bytecode with the stamp of its source: stiffgen's loader ignores it, Python's own would run it."""
    folder = copy_folder(robot_folder, tmp_path)
    source, other = next(folder.rglob("impedance.py")), tmp_path / "other.py"
    other.write_text(source.read_text() + planted(folder))
    cache = Path(importlib.util.cache_from_source(str(source)))
    cache.parent.mkdir()
    py_compile.compile(str(other), str(cache), doraise=True)
    content = bytearray(cache.read_bytes())
    content[8:16] = int(source.stat().st_mtime).to_bytes(4, "little") + source.stat().st_size.to_bytes(4, "little")
    cache.write_bytes(content)
    load_module(open_robot(folder))
    assert not (tmp_path / "mark").exists()
    for name in [each for each in sys.modules if each.startswith("stiffgen._robot_")]:
        monkeypatch.delitem(sys.modules, name)  # back afterwards: pickles of other tests name them
    assert open_robot(folder).module  # Python's own import believes the cache: what this test would miss otherwise
    assert (tmp_path / "mark").exists()


@pytest.fixture(scope="module")
def texts() -> dict[str, str]:
    return print_again(open_robot(FOLDER))


@pytest.mark.parametrize("file", ["iiwa14.c", "iiwa14.hpp", "README.md", "manifest.json"])
def test_digests_stamped_again_do_not_hide_a_change(file: str, texts: dict[str, str], tmp_path: Path) -> None:
    """Change a file and its digest: `verify` still finds the change, by printing the robot again."""
    folder = copy_folder(FOLDER, tmp_path)
    assert check_text(open_robot(folder), texts).passed
    (folder / file).write_text((folder / file).read_text().replace("iiwa14.urdf", "iiwa15.urdf"))
    restamp(folder)
    check = check_text(open_robot(folder), texts)
    assert not check.passed and file in check.detail


def evidence(kind: str, folder: Path, **changed: Any) -> dict[str, Any]:
    """Return the content of a file of proofs or of targets for a folder."""
    row = {"function": "a", "claims": "b", "tool": "c", "outcome": "proved", "seconds": 1.0}
    target = {
        "machine": "a", "compiler": "b", "emulator": "c", "compared": "d", "right": True, "states": 1,
        "instructions": {"f": [1, 2]}, "step": None, "longest_step": None, "flash": 1, "ram": 1, "stack": 1,
    }  # fmt: skip
    rows = {"verdicts": [row | changed], "tools": {}} if kind == "proofs" else {"targets": [target | changed]}
    return {"robot": "iiwa14", "sources": open_robot(folder).source_digests(), **rows}


@pytest.mark.parametrize("kind", ["proofs", "targets"])
def test_evidence_covers_every_source(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Remove a source's digest from the evidence: refused, as that source may have changed."""
    read: Callable[..., Any] = filed_for if kind == "proofs" else targets_for
    file, robot, whole = tmp_path / "evidence.json", open_robot(FOLDER), evidence(kind, FOLDER)
    file.write_text(json.dumps(whole))
    read(robot, file)
    for source in whole["sources"]:
        file.write_text(json.dumps(whole | {"sources": {k: v for k, v in whole["sources"].items() if k != source}}))
        with pytest.raises(OutputError, match="has no digest of"):
            read(robot, file)
    file.write_text(json.dumps(whole | {"sources": {}}))
    arguments = ["verify", str(FOLDER), "--report", str(tmp_path / "page.html"), "--evidence", str(file)]
    assert main(arguments) == 2
    assert "has no digest of" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("kind", "changed"),
    [
        ("proofs", {"outcome": "perhaps"}),
        ("proofs", {"outcome": ["proved"]}),
        ("proofs", {"seconds": "long"}),
        ("proofs", {"seconds": 10**400}),
        ("proofs", {"seconds": math.inf}),
        ("targets", {"right": "yes"}),
        ("targets", {"instructions": {"f": 3}}),
        ("targets", {"step": ["a", "b"]}),
    ],
)
def test_evidence_with_unknown_values_is_refused(kind: str, changed: dict[str, Any], tmp_path: Path) -> None:
    """Give evidence with values of the wrong kind: refused instead of printed."""
    file = tmp_path / "evidence.json"
    file.write_text(json.dumps(evidence(kind, FOLDER, **changed)))
    read: Callable[..., Any] = filed_for if kind == "proofs" else targets_for
    with pytest.raises(OutputError, match=r"holds no (verdicts|targets) \("):
        read(open_robot(FOLDER), file)


@pytest.mark.parametrize("path", ["../iiwa14", "../../{0}/iiwa14", "python/..", "."])
def test_a_folder_is_intact_by_whatever_path_it_is_named(
    path: str, robot_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """ ".." in the path of the folder is the user's; only ".." in the manifest would leave the folder."""
    folder = copy_folder(robot_folder, tmp_path)
    monkeypatch.chdir(folder)
    (files,) = check_files(open_robot(Path(path.format(tmp_path.name))))
    assert files.passed, files.detail


@pytest.mark.parametrize("file", ["../outside.h", "python/../../outside.h", "{}/outside.h"])
def test_a_manifest_names_no_file_outside_of_its_folder(file: str, robot_folder: Path, tmp_path: Path) -> None:
    """List a file outside of the folder in the manifest: counted as missing, not read."""
    folder = copy_folder(robot_folder, tmp_path)
    (tmp_path / "outside.h").write_text("")
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["files"][file.format(tmp_path)] = hashlib.sha256(b"").hexdigest()
    (folder / "manifest.json").write_text(json.dumps(manifest))
    (files,) = check_files(open_robot(folder))
    assert not files.passed and files.detail.endswith("is missing")
