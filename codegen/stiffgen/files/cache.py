# SPDX-License-Identifier: MIT
"""Robots in the user's cache: generated and compiled on first use, opened afterwards.

The name of an entry is a digest of everything that the compiled module depends on: the robot's file, the options, the
generator's own files, Python, the processor and the compiler. An entry appears whole or not at all
(:func:`stiffgen.core.folder.swapped_in`); a lock keeps two processes from doing the same work at the same time. A
record holds the digests of all files, the compiled module's too: a module that a crash has cut short would end the
process that imports it. An entry with another digest is made again. An entry that another user can have written is
never opened (:mod:`stiffgen.files.owned`); the robot is made again in a folder of this user's.

The module of an entry is ``stiffgen._robot_DIGEST`` in every process, so that pickles of what it holds can be read
where the cache has the robot.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shutil
import stat
import sys
import sysconfig
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from functools import cache
from importlib.machinery import ModuleSpec
from pathlib import Path
from typing import Any

import numpy as np

from stiffgen._version import __version__
from stiffgen.core.described import in_python
from stiffgen.core.emit.build import compiler_command
from stiffgen.core.errors import BuildError, ChainError, OutputError, StiffgenError, listed, printable, terminal_text
from stiffgen.core.folder import flush, write_atomically
from stiffgen.core.generate import generate_folder
from stiffgen.core.given import checked_keywords, checked_path
from stiffgen.core.loading import describe
from stiffgen.core.manifest import MANIFEST
from stiffgen.core.names import checked_identifier, identifier
from stiffgen.core.opened import GeneratedRobot, module_spec, open_robot
from stiffgen.core.options import GenerationOptions
from stiffgen.core.robot.files import exists, is_file
from stiffgen.files.locks import exclusive, remove_unlocked
from stiffgen.files.names import is_name
from stiffgen.files.owned import distrust, make_private

_VARIABLE = "STIFFGEN_CACHE"
_FIXED = {"output", "force", "build", "python"}
"""Options that the cache decides itself."""
_RECORD = "entry.json"
_WAITING = "waiting for another process, which generates the same robot"
_MODULE = "stiffgen._robot_"
"""Beginning of the name of an entry's module; its digests follow."""


class LoadedRobot(GeneratedRobot):
    """Robot of the cache: its module has the name of the entry, and pickles of the robot hold that name alone."""

    @property
    def module_name(self) -> str:
        """Name of the module, from the digests in the entry's name: the same in every process."""
        return _MODULE + "_".join(self.folder.parent.name.rsplit("-", 2)[1:])

    def __reduce__(self) -> tuple[Any, ...]:
        return _robot_of_module, (self.module_name,)


def load(file: str | Path, *, tip: Any = None, base: str | None = None, **options: Any) -> GeneratedRobot:
    """Open a robot by its file; generate and compile it into the user's cache on first use.

    The folder of the cache is STIFFGEN_CACHE, else ``stiffgen`` in the system's folder for caches. ``stiffgen inspect
    --list cached`` lists it, ``--list clear`` empties it. After a change of the file, an option, stiffgen, Python
    or the compiler, the robot is generated again.

    Args:
        file: path of the robot's file, or what else :func:`stiffgen.generate` takes.
        tip: link at the end of the chain, or several; default: the only leaf.
        base: link at the start of the chain; default: the root link.
        options: other fields of :class:`stiffgen.GenerationOptions`, except ``output``, ``force``, ``build`` and
            ``python``. ``progress`` is called before each step; default: a line on standard error.

    Returns:
        The robot, as from :func:`stiffgen.open_robot`: its functions are in ``module``.

    Raises:
        StiffgenError: as :func:`stiffgen.generate`; also for an option that the cache decides itself.

    """
    try:
        return _loaded(file, tip, base, options)
    except StiffgenError as error:  # without the frames of the generator, in the words of Python
        error.reword(lambda text: in_python(text, GenerationOptions))
        raise error.with_traceback(None) from None


def _loaded(file: str | Path, tip: Any, base: str | None, options: dict[str, Any]) -> GeneratedRobot:
    """Do what :func:`load` does, with refusals in the words of the command line."""
    for name in sorted(_FIXED & options.keys()):
        raise StiffgenError(f"load() decides '{name}' itself; leave it out, or take stiffgen.generate()")
    checked_keywords(GenerationOptions, options, "load")
    return _open_or_generate(
        checked_path(file, "load"), GenerationOptions(tip=tip, base=base, **{"progress": _print_step} | options)
    )


def folder_of(
    source: str | Path, arguments: Mapping[str, str] | None = None, progress: Callable[[str], None] = lambda step: None
) -> Path:
    """Return the folder of a robot's file or name, generated into the cache on first use.

    Args:
        source: what :func:`stiffgen.generate` takes.
        arguments: of a template.
        progress: called with a few words before each step.

    Raises:
        StiffgenError: there is no such file, or the robot cannot be generated without options.

    """
    if not is_name(source) and not exists(source):
        raise OutputError(
            f"{source}: does not exist; give a robot's file, or the folder that 'stiffgen generate' wrote"
        )
    try:
        return _open_or_generate(source, GenerationOptions(arguments=arguments or None, progress=progress)).folder
    except ChainError as error:
        raise ChainError(f"{error}; with options: 'stiffgen generate', then give its folder here") from error


def _open_or_generate(file: str | Path, chosen: GenerationOptions) -> GeneratedRobot:
    """Open a robot of the cache; generate it there if it is not."""
    entry = _own(_entry(_name(file, chosen)), chosen.progress)
    robot = _open(entry, chosen.progress)
    if robot is not None:
        return robot
    compiler_command()  # the error of a missing compiler comes before a minute's work
    _make_folder(entry)
    with exclusive(entry.with_suffix(".lock"), lambda: chosen.progress(_WAITING)):
        robot = _open(entry, lambda _: None)  # another process may have made it just now
        if robot is not None:
            return robot
        shutil.rmtree(entry, ignore_errors=True)  # generation replaces no folder whose manifest is damaged
        _make_folder(entry)
        folder = generate_folder(file, replace(chosen, output=entry, force=True))
        _record(folder, file)
        return _opened(folder)


def keep(file: str | Path, options: GenerationOptions, folder: Path) -> None:
    """Keep a copy of a folder that was just generated and compiled with these options, so that :func:`load` finds it.

    A cache that cannot be written, or that another user can write, stays as it is.
    """
    if not (options.build and options.python):
        return
    with suppress(OSError, StiffgenError):
        entry = _entry(_name(file, options))
        if distrust(entry):
            return
        _make_folder(entry)
        with exclusive(entry.with_suffix(".lock"), _leave_it):
            if _open(entry, lambda _: None) is None:
                shutil.rmtree(entry, ignore_errors=True)
                _make_folder(entry)
                _record(Path(shutil.copytree(folder, entry / folder.name)), file)


def _leave_it() -> None:
    raise OutputError(_WAITING)


def _name(file: str | Path, options: GenerationOptions) -> str:
    """Return the beginning of an entry's name: the file, and the digest of all but the compiler."""
    digest = _digest(_input_of(file, options), _plain(options), _generator(), _machine())
    return f"{identifier(Path(file).stem)}-{digest[:20]}"


def _record(folder: Path, file: str | Path) -> None:
    """Write the record of an entry's folder: what it was made from, and the digests of its files."""
    for path in (folder, *folder.rglob("*")):
        path.chmod(stat.S_IMODE(path.stat().st_mode) & ~0o022)  # nobody else writes there, whatever the umask
    flush(folder)  # no record on the disk before the files that it vouches for
    record = {"file": str(Path(file).absolute()), "folder": folder.name, "version": __version__}
    write_atomically(folder.parent / _RECORD, json.dumps(record | {"digests": _digests(folder)}))


def _opened(folder: Path) -> LoadedRobot:
    """Return the robot of an entry's folder, which this process or the record vouches for."""
    robot = open_robot(folder, trust_potentials=True)
    return LoadedRobot(*(getattr(robot, each.name) for each in fields(robot)))


def spec_of(name: str) -> ModuleSpec:
    """Return the specification of an entry's module, as the package's finder asks for it.

    Raises:
        ModuleNotFoundError: the cache has no such robot, or another user can have written it.

    """
    return module_spec(name, _robot_of_module(name).folder)


def _robot_of_module(name: str) -> LoadedRobot:
    """Return the robot of the cache whose module has a name."""
    digests = name.removeprefix(_MODULE).replace("_", "-")
    told = []
    for place in _places():
        for record in sorted(place.glob(f"*-{digests}/{_RECORD}")):
            if reason := distrust(record.parent):
                told.append(reason)
            elif (robot := _open(record.parent, told.append)) is not None:
                return robot
    reasons = f" ({'; '.join(told)})" if told else ""
    raise ModuleNotFoundError(
        f"{name}: the cache {cache_folder()} has no such robot{reasons}; call stiffgen.load() with the robot's file "
        f"and options here, or set {_VARIABLE} to the cache of the process that wrote this name",
        name=name,
    )


def _places() -> list[Path]:
    """Return the folders that hold entries: the cache, and that of entries which cannot be trusted there."""
    own = f"stiffgen-{os.getuid()}" if hasattr(os, "getuid") else "stiffgen"
    return [cache_folder(), Path(tempfile.gettempdir()) / own]


def _own(entry: Path, say: Callable[[str], None]) -> Path:
    """Return an entry, or the one in its stead where nobody else can have written."""
    if not (reason := distrust(entry)):
        return entry
    other = _places()[1] / entry.name
    if not distrust(other):
        say(
            f"{reason}, who could change what runs here: using {printable(str(other.parent), 200)} in place of the "
            f"cache; take that right away, or set {_VARIABLE} to a folder of your own"
        )
        return other
    raise OutputError(f"{reason}, who could change what runs here; set {_VARIABLE} to a folder of your own")


def cache_folder() -> Path:
    """Return the folder of the cache, which need not exist: STIFFGEN_CACHE, else the system's folder for caches."""
    chosen = os.environ.get(_VARIABLE)
    if chosen:
        return Path(chosen)
    if os.name == "nt":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local")) / "stiffgen" / "cache"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "stiffgen"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "stiffgen"


@dataclass(frozen=True)
class CachedRobot:
    """Robot in the cache: its folder, the file that it was made from, its size [bytes]."""

    folder: Path
    file: str
    size: int


def entries() -> list[CachedRobot]:
    """Return the robots in the cache, by name."""
    robots = []
    for record in (each for place in _places() for each in sorted(place.glob(f"*/{_RECORD}"))):
        content = _read_record(record.parent)
        if content is not None:
            size = sum(each.stat().st_size for each in record.parent.rglob("*") if each.is_file())
            robots.append(CachedRobot(record.parent / content["folder"], content["file"], size))
    return robots


def clear(names: Sequence[str] = ()) -> int:
    """Remove robots from the cache, except those that a process is making; return how many were removed.

    Args:
        names: names of robots; default: all.

    Raises:
        OutputError: one of them cannot be removed.
        StiffgenError: the cache has no robot of a name.

    """
    names_by_entry = {each.folder.parent: each.folder.name for each in entries()}
    for name in names:
        if name not in names_by_entry.values():
            known = listed(sorted(set(names_by_entry.values()))) or "(none)"
            raise StiffgenError(f"the cache has no robot '{printable(name)}'; it has {known}")
    removed = 0
    for lock in (each for place in _places() for each in sorted(place.glob("*-*.lock"))):
        entry = lock.with_suffix("")
        if names and names_by_entry.get(entry) not in names:
            continue
        try:
            removed += remove_unlocked(lock, entry)
        except OSError as error:
            raise OutputError(f"{lock.parent}: cannot be cleared ({error.strerror})") from error
    return removed


def _print_step(step: str) -> None:
    print(f"stiffgen: {terminal_text(step)} ...", file=sys.stderr, flush=True)


def _open(entry: Path, say: Callable[[str], None]) -> LoadedRobot | None:
    """Return the robot of an entry; None if there is none, or a file is not what the record says."""
    content = _read_record(entry)
    if content is None:
        if (entry / _RECORD).exists():
            say(f"the cache's record of {entry.name} is damaged; generating the robot again")
        return None
    folder = entry / content["folder"]
    found = _digests(folder)
    damaged = sorted(file for file, digest in content["digests"].items() if found.get(file) != digest)
    try:
        if not damaged:
            return _opened(folder)
    except OutputError:
        damaged = [MANIFEST]
    say(f"the robot {content['folder']} in the cache is damaged ({listed(damaged, 3)}); generating it again")
    return None


def _digests(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of all files of a folder, by file; those that Python writes at an import are left out."""
    files = [each for each in folder.rglob("*") if each.is_file() and "__pycache__" not in each.parts]
    return {each.relative_to(folder).as_posix(): hashlib.sha256(each.read_bytes()).hexdigest() for each in files}


def _read_record(entry: Path) -> dict[str, Any] | None:
    """Return file, folder and digests of an entry; None without a record, or for one that is damaged."""
    try:
        content = json.loads((entry / _RECORD).read_text(encoding="utf-8"))
        name = checked_identifier(content["folder"])  # a path would lead out of the cache
        return {"file": str(content["file"]), "folder": name, "digests": dict(content["digests"])}
    except (OSError, ValueError, LookupError, TypeError, RecursionError, StiffgenError):
        return None


def _make_folder(entry: Path) -> None:
    """Make an entry's folder; name the variable of the cache if it cannot be written."""
    try:
        make_private(entry)
        entry.with_suffix(".lock").touch()
    except OSError as error:
        raise OutputError(
            f"{printable(str(entry.parent), 200)}: the cache cannot be written ({error.strerror}); "
            f"set {_VARIABLE} to a folder that can be written"
        ) from error


def _entry(name: str) -> Path:
    """Return the folder of an entry; without a compiler, that of any entry which another compiler made."""
    try:
        compiler = _compiler()
    except BuildError:
        made = sorted(cache_folder().glob(f"{name}-*/{_RECORD}"))
        return made[0].parent if made else cache_folder() / f"{name}-none"
    return cache_folder() / f"{name}-{_digest(compiler)[:8]}"


def _compiler() -> list[Any]:
    """Return the command of the compiler, its flags, and size and date of its program, which an update changes."""
    command = compiler_command()
    status = Path(command[0]).resolve().stat()
    return [*command, os.environ.get("CFLAGS", ""), status.st_size, status.st_mtime_ns]


def _input_of(file: str | Path, options: GenerationOptions) -> list[str]:
    """Return a digest of all that the file says, with its name, which the generated code states."""
    path = Path(file)
    if path.suffix == ".urdf" and is_file(path):
        data = path.read_bytes()
        if b"xacro" not in data:  # a URDF includes no other file, a template may
            return [path.name, hashlib.sha256(data).hexdigest()]
    return [repr(describe(file, options))]


@cache
def _generator() -> str:
    """Return a digest of this package's files: in a working tree they change, and the version does not."""
    digest = hashlib.sha256(__version__.encode())
    for file in sorted(Path(__file__).parents[1].rglob("*")):
        if file.is_file() and "__pycache__" not in file.parts:
            digest.update(file.name.encode() + file.read_bytes())
    return digest.hexdigest()


def _machine() -> list[Any]:
    """Return what the compiled module depends on: Python, NumPy's generation, the processor.

    The library of NAME.jax is compiled when it is first imported, where jax was missing before.
    """
    try:
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
    except OSError:
        lines = []
    features = next((line for line in lines if line.lower().startswith(("flags", "features"))), platform.processor())
    return [sysconfig.get_config_var("EXT_SUFFIX"), np.__version__.split(".")[0], platform.machine(), features]


def _plain(value: Any) -> Any:
    """Return an option as values of JSON."""
    if isinstance(value, GenerationOptions):
        skipped = {*_FIXED, "progress", "potentials"}
        plain = {each.name: _plain(getattr(value, each.name)) for each in fields(value) if each.name not in skipped}
        return plain | value.springs_record()
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    return (dict(value) or None) if isinstance(value, Mapping) else value  # none given, or an empty set of them


def _digest(*values: Any) -> str:
    """Return the SHA-256 of values as JSON; other types count by their text."""
    return hashlib.sha256(json.dumps(values, sort_keys=True, default=str).encode()).hexdigest()
