# SPDX-License-Identifier: MIT
"""Folders that appear whole or not at all: processes that are killed, processes at the same time, planted links."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

import stiffgen
from stiffgen.core import folder
from stiffgen.core.errors import BuildError, OutputError
from stiffgen.core.folder import swapped_in, temporary_folder, write_atomically
from support.project import URDF

KILLED = """
import os, signal, sys
from pathlib import Path
from stiffgen.core.folder import swapped_in, temporary_folder, write_atomically
with swapped_in(Path("out/arm")) as staging, temporary_folder("build") as build:
    (staging / "a").write_text("half")
    (build / "b").write_text("half")
    os.fsync = lambda *a, **k: os.kill(os.getpid(), signal.SIGKILL)
    write_atomically(Path("out/arm"), "text")
"""


def python(code, cwd, **environment):
    command = [sys.executable, "-c", textwrap.dedent(code)]
    return subprocess.Popen(command, cwd=cwd, env=os.environ | environment)


def test_the_next_run_removes_what_a_killed_one_left(tmp_path, monkeypatch):
    """Kill a run: the next one removes its temporary folders, and none that is still in use."""
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    assert python(KILLED, tmp_path, TMPDIR=str(temporary)).wait() == -signal.SIGKILL
    left = [*(tmp_path / "out").iterdir(), *temporary.iterdir()]
    assert len(left) == 3
    (tmp_path / "out" / ".arm.of-another").mkdir()
    with swapped_in(tmp_path / "out" / "arm") as staging, temporary_folder("build") as build:
        assert [*temporary.iterdir()] == [build]
        assert {each.name for each in (tmp_path / "out").iterdir()} == {".arm.of-another", staging.name}
        with swapped_in(tmp_path / "out" / "arm"), temporary_folder("build"):  # those in use are not stale
            assert staging.is_dir() and build.is_dir()
    assert {each.name for each in (tmp_path / "out").iterdir()} == {".arm.of-another", "arm"}
    assert [*temporary.iterdir()] == []


SWAPS = """
from pathlib import Path
from stiffgen.core import folder
if {fallback}:
    folder._exchange = lambda one, other: False
for _ in range(100):
    with folder.swapped_in(Path("out/arm")) as staging:
        (staging / "a").write_text("whole")
"""


@pytest.mark.parametrize("fallback", [False, pytest.param(True, id="two renames")])
def test_swaps_at_the_same_time(tmp_path, fallback):
    """Swap the folder from several processes: nothing is left beside it, and it is never absent."""
    (tmp_path / "out" / "arm").mkdir(parents=True)
    processes = [python(SWAPS.format(fallback=fallback), tmp_path) for _ in range(3)]
    absent = 0
    while any(process.poll() is None for process in processes):
        absent += not os.path.lexists(tmp_path / "out" / "arm")
    assert [process.wait() for process in processes] == [0, 0, 0]
    assert [each.name for each in (tmp_path / "out").iterdir()] == ["arm"]
    assert (tmp_path / "out" / "arm" / "a").read_text() == "whole"
    assert fallback or not absent


def test_a_swap_in_one_step_where_the_system_has_it(tmp_path):
    """Exchange two folders in one step on Linux; with an absent one, report that it did not happen."""
    one, other = tmp_path / "one", tmp_path / "other"
    one.mkdir()
    other.mkdir()
    (one / "a").touch()
    if sys.platform == "linux" and folder._exchange(one, other):
        assert not (one / "a").exists() and (other / "a").exists()
    assert not folder._exchange(one, tmp_path / "absent")


def test_planted_links_are_not_followed(tmp_path):
    """Neither in the place of the file, nor where a name could be guessed, nor as a stale folder."""
    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "a").write_text("mine")
    target = tmp_path / "play.html"
    for name in (".play.html.part", "play.html", ".play.html.stiffgen-x"):
        (tmp_path / name).symlink_to(kept / "a")
    (tmp_path / ".arm.stiffgen-x").symlink_to(kept)
    write_atomically(target, "page")
    with swapped_in(tmp_path / "arm"):
        pass
    assert (kept / "a").read_text() == "mine"
    assert target.read_text() == "page" and not target.is_symlink()
    assert {each.name for each in tmp_path.iterdir() if not each.is_symlink()} == {"kept", "play.html", "arm"}


def test_a_folder_for_temporary_files_where_no_program_may_run(tmp_path, monkeypatch):
    """Compile where no program may run (noexec): the message names TMPDIR, not the output folder."""
    compiler = tmp_path / "compiler"
    compiler.write_text(
        '#!/bin/sh\ncc "$@" || exit\nfor a in "$@"; do case $a in */self_check) chmod -x "$a";; esac; done\n'
    )
    compiler.chmod(0o755)
    monkeypatch.setenv("CC", str(compiler))
    monkeypatch.setenv("CFLAGS", "-O0")
    with pytest.raises(BuildError, match=r"cannot be run .Permission denied.*set TMPDIR"):
        stiffgen.generate(URDF, output=tmp_path / "out", kernels="hybrid.jacobian", controller=False, masses=False)


def test_no_room_for_temporary_files(monkeypatch, tmp_path):
    monkeypatch.setenv("TMPDIR", str(tmp_path / "absent"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "absent"))
    with pytest.raises(OutputError, match=r"absent: has no room.*set TMPDIR"), temporary_folder("build"):
        pass


def test_an_error_elsewhere_does_not_blame_the_output(tmp_path):
    elsewhere = tmp_path / "elsewhere"
    with pytest.raises(OutputError, match=f"^{elsewhere}: ") as refused, swapped_in(tmp_path / "arm"):
        elsewhere.read_text()
    assert "arm" not in str(refused.value).replace(str(tmp_path), "")


@pytest.mark.parametrize(
    ("number", "remedy"),
    [
        (errno.EACCES, "ask for permission"),
        (errno.EROFS, "choose another --output"),
        (errno.ENOSPC, "make room"),
        (errno.ENAMETOOLONG, "choose a shorter"),
    ],
)
def test_the_remedy_fits_the_error(number, remedy):
    """Give errors of the file system: each message has the remedy of its error."""
    message = str(folder.unwritable(Path("arm"), OSError(number, os.strerror(number))))
    assert message.startswith(f"arm: cannot be written ({os.strerror(number)}); {remedy}")
    assert ("room" in message) == (number == errno.ENOSPC)
