# SPDX-License-Identifier: MIT
"""The cache runs no code that another user can have written: owners and modes of an entry and of all above it."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

import stiffgen
from stiffgen.cli import main
from stiffgen.errors import OutputError
from stiffgen.files import cache
from stiffgen.files.owned import distrust, make_private
from support.project import URDF

SMALL = {"kernels": "hybrid.jacobian", "controller": False, "batches": False, "masses": False}
NOBODY = 65534
root = pytest.mark.skipif(os.getuid() != 0, reason="only root gives files to another user")


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a cache in a user's folder that nobody else writes, with temporary files beside it."""
    for name in ("temporary", "home", "home/me"):
        (tmp_path / name).mkdir(mode=0o700)
    monkeypatch.setenv("STIFFGEN_CACHE", str(tmp_path / "home" / "me" / "cache"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    return tmp_path / "home" / "me" / "cache"


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Copy one folder in place of generation: only its owner and mode count here."""
    monkeypatch.setattr(cache, "_opened", lambda folder: folder)

    def generate(file: object, options: stiffgen.GenerationOptions) -> Path:
        folder = Path(options.output) / "iiwa14"
        (folder / "python").mkdir(parents=True)
        (folder / "__init__.py").write_text("made = True\n")
        return folder

    monkeypatch.setattr(cache, "generate_folder", generate)


def load() -> Path:
    folder: object = stiffgen.load(URDF, **SMALL)
    assert isinstance(folder, Path)
    return folder


CHANGES: dict[str, Callable[[Path], object]] = {
    "the cache, for all": lambda folder: folder.parents[1].chmod(0o777),
    "the cache, for a group": lambda folder: folder.parents[1].chmod(0o770),
    "the entry": lambda folder: folder.parent.chmod(0o777),
    "the robot's folder": lambda folder: (folder.parent.chmod(0o755), folder.chmod(0o775)),
    "a file": lambda folder: (folder.parent.chmod(0o755), (folder / "__init__.py").chmod(0o666)),
    "a folder above": lambda folder: folder.parents[3].chmod(0o777),
    "an owner above": lambda folder: os.chown(folder.parents[3], NOBODY, NOBODY),
    "an owner of the entry": lambda folder: os.chown(folder.parent, NOBODY, NOBODY),
    "an owner of a file": lambda folder: os.chown(folder / "__init__.py", NOBODY, NOBODY),
    "a link inside": lambda folder: (folder / "__init__.py").rename(folder.parents[2] / "x") and (
        folder / "__init__.py").symlink_to(folder.parents[2] / "x"),
}  # fmt: skip


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("change", [pytest.param(name, marks=[root] if "owner" in name else []) for name in CHANGES])
def test_an_entry_of_others_is_made_again_elsewhere(change, place, capsys):
    """Let others write to an entry: it is not run, and a folder of one's own is used."""
    folder = load()
    assert folder.is_relative_to(place) and load() == folder
    CHANGES[change](folder)
    (folder / "__init__.py").write_text("made = 'by another user'\n")
    record = folder.parent / "entry.json"
    record.write_text(json.dumps(json.loads(record.read_text()) | {"digests": cache._digests(folder)}))
    capsys.readouterr()
    other = load()
    assert other.is_relative_to(place.parents[2] / "temporary" / f"stiffgen-{os.getuid()}")
    assert (other / "__init__.py").read_text() == "made = True\n"
    told = capsys.readouterr().err.splitlines()[0]
    assert "could change what runs here: using" in told and "set STIFFGEN_CACHE" in told
    assert load() == other
    os.chown(place.parents[1], os.getuid(), os.getgid())
    assert {each.folder for each in cache.entries()} == {folder, other}
    assert main(["inspect", "--list", "clear"]) == 0 and not other.exists()


@pytest.mark.usefixtures("quick")
def test_both_places_of_others(place):
    """Let others write to both places of the cache: refused with the variable to set."""
    place.parent.chmod(0o777)
    taken = place.parents[2] / "temporary" / f"stiffgen-{os.getuid()}"
    taken.mkdir()
    taken.chmod(0o777)
    with pytest.raises(OutputError, match=r"\(mode 777\).*set STIFFGEN_CACHE to a folder of your own"):
        load()


@pytest.mark.usefixtures("quick")
def test_a_record_that_leaves_the_cache(place, tmp_path, capsys):
    """Let a record of the cache point outside: the entry counts as damaged and is made anew."""
    folder = load()
    shutil.copytree(folder, tmp_path / "outside")
    record = folder.parent / "entry.json"
    content = json.loads(record.read_text())
    for name in ("../../../../outside", str(tmp_path / "outside"), "..", ".", "", "iiwa14/python", 3, None):
        record.write_text(json.dumps(content | {"folder": name}))
        assert cache.entries() == []
        assert load() == folder
        assert "is damaged" in capsys.readouterr().err


@pytest.mark.usefixtures("quick")
def test_a_cache_with_a_generous_umask(place):
    """Folders that are made are private, although those of the compiler and of Python are not."""
    before = os.umask(0)
    try:
        folder = load()
        (folder / "__pycache__").mkdir()
        assert load() == folder
    finally:
        os.umask(before)
    assert [each.stat().st_mode & 0o777 for each in (place, folder.parent)] == [0o700, 0o700]


def test_paths_with_links(tmp_path):
    """Links count as the folders do that hold them and that they lead to; a shared temporary folder does no harm."""
    for name in ("mine", "theirs", "shared"):
        (tmp_path / name / "cache").mkdir(parents=True)
    (tmp_path / "theirs").chmod(0o777)
    (tmp_path / "shared").chmod(0o1777)
    assert distrust(tmp_path / "shared" / "cache") == "" != distrust(tmp_path / "shared")
    for name in ("mine", "theirs"):
        (tmp_path / name / "link").symlink_to(tmp_path / "mine" / "cache")
        (tmp_path / "mine" / f"over {name}").symlink_to(f"../{name}/link/../../{name}/cache")
    assert [distrust(tmp_path / "mine" / each) for each in ("cache", "link", "over mine", "absent/deep")] == [""] * 4
    for each in ("theirs/link", "theirs/cache", "theirs/absent", "mine/over theirs"):
        assert "theirs can be written by other users (mode 777)" in distrust(tmp_path / each)
    (tmp_path / "mine" / "circle").symlink_to("circle")
    assert distrust(tmp_path / "mine" / "circle" / "x") == ""  # it cannot be made, nor opened
    make_private(tmp_path / "new" / "deep")
    assert (tmp_path / "new").stat().st_mode & 0o777 == 0o700
