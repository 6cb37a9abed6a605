# SPDX-License-Identifier: MIT
"""Compile a robot's folder into its NumPy module, with the system's C compiler alone."""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import subprocess
import sys
import sysconfig
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from stiffgen.core.errors import BuildError, NoCompilerError
from stiffgen.core.family import part
from stiffgen.core.folder import temporary_folder
from stiffgen.core.signals import signals_deferred
from stiffgen.rooms import optional

_LAST_LINES = 20
_FLAGS = ("-O3", "-DNDEBUG", "-std=gnu99", "-fPIC")
"""Flags of CMake's release build of the folder; those in CFLAGS follow them."""
_FAST_TO_COMPILE = ("-O1",)
FORWARDS = ("-O0",)
"""These files hold hundreds of functions of one line: optimising them takes longer than it saves."""


def kernel_sources(folder: Path, name: str) -> list[Path]:
    """Return the C files of a folder's kernels: single calls, and batches where there are any."""
    batch = folder / f"{name}_batch.c"
    return [folder / f"{name}.c", *([batch] if batch.exists() else [])]


def build_module(folder: Path, name: str) -> None:
    """Compile the NumPy module of a generated folder into its python/, for the instruction set of this machine.

    CC names the compiler; CFLAGS follow the build's own flags, and so win.

    A folder with derivatives also gets the libraries of its wrappers, NAME.jax where jax is installed.

    Args:
        folder: the robot's folder.
        name: the robot's identifier.

    Raises:
        BuildError: no compiler, no Python headers, or the compiler failed; with its last lines.

    """
    compiler = compiler_command()
    header = Path(sysconfig.get_path("include")) / "Python.h"
    if not header.exists():
        raise BuildError(
            "Python's C headers are missing; install them (Debian: apt-get install python3-dev) or use --no-build"
        )
    folder = folder.resolve()
    with temporary_folder("build") as build:
        sources = _sources(folder, name)
        command, objects = _compile(compiler, sources, build)
        python = [source.stem.removeprefix(f"{name}_") for source in sources if source.parent.name == "python"]
        wrappers = [which for which in python if which not in ("python", "calls")]
        wrapper_links = [_wrapper_link(command, objects, folder, name, which) for which in wrappers]
        of_wrappers = {f"{name}_{each}" for each in (*wrappers, "calls")}
        of_module = [file for stem, file in objects.items() if stem not in of_wrappers]
        module = folder / "python" / f"{name}_python{sysconfig.get_config_var('EXT_SUFFIX')}"
        link = [*command, *_link_options(), *of_module, "-o", str(module), *_libraries()]
        run_all([link, *wrapper_links], compiler[0], build)
        # refuses flags in CFLAGS that changed the arithmetic, such as -ffast-math
        checked = [*(source.stem for source in kernel_sources(folder, name)), f"{name}_impedance"]
        _self_check([*command, *(objects[stem] for stem in checked if stem in objects)], folder, name, build)


def build_wrapper(folder: Path, name: str, which: str) -> None:
    """Compile the library of a wrapper (NAME_WHICH.c) alone.

    Raises:
        BuildError: no compiler, or it failed; with its last lines.

    """
    compiler, folder = compiler_command(), folder.resolve()
    needed = {*kernel_sources(folder, name), *(folder / "python" / f"{name}_{each}.c" for each in ("calls", which))}
    with temporary_folder("build") as build:
        chosen = {source: options for source, options in _sources(folder, name).items() if source in needed}
        command, objects = _compile(compiler, chosen, build)
        run_all([_wrapper_link(command, objects, folder, name, which)], compiler[0], build)


def _compile(
    compiler: Sequence[str], sources: Mapping[Path, Sequence[str]], build: Path
) -> tuple[list[str], dict[str, str]]:
    """Compile C files with the options of each; return the compiler's command, and the objects by the files' stems."""
    flags, user_flags = [*compiler, *_FLAGS, *_native(compiler, build)], shlex.split(os.environ.get("CFLAGS", ""))
    objects = {source.stem: str(build / f"{source.name}.o") for source in sources}
    commands = [
        [*flags, *options, *user_flags, "-c", str(source), "-o", objects[source.stem]]
        for source, options in sources.items()
    ]
    run_all(commands, compiler[0], build)
    return [*flags, *user_flags], objects


def _wrapper_link(command: Sequence[str], objects: Mapping[str, str], folder: Path, name: str, which: str) -> list[str]:
    """Return the command that links the library of a wrapper."""
    stems = [f"{name}_{which}", f"{name}_calls", *(source.stem for source in kernel_sources(folder, name))]
    library = folder / "python" / f"{name}_{which}{'.pyd' if os.name == 'nt' else '.so'}"
    return [*command, "-shared", *(objects[stem] for stem in stems), "-o", str(library), *_libraries()]


def _sources(folder: Path, name: str) -> dict[Path, Sequence[str]]:
    """Return the folder's C files with the compiler's options for each."""
    python, jax, companions = folder / "python" / name, part("jax.build"), optional("control.companions")
    options: dict[Path, Sequence[str]] = {
        **{source: [] for source in kernel_sources(folder, name)},
        **{folder / f"{name}_{each}.c": [] for each in ("impedance", *(companions.COMPANIONS if companions else ()))},
        Path(f"{python}_python.c"): [
            f"-I{sysconfig.get_path('include')}",
            f"-I{np.get_include()}",
            "-fvisibility=hidden",
        ],
        Path(f"{python}_calls.c"): _FAST_TO_COMPILE,  # it copies, and calls
        Path(f"{python}_casadi.c"): FORWARDS,
        **({Path(f"{python}_jax.c"): jax.compiler_options()} if jax and jax.headers() else {}),
    }
    return {source: chosen for source, chosen in options.items() if source.exists()}


def build_library(
    folder: Path, name: str, build: Path, flags: Sequence[str] = (), *, more: Sequence[Path] = ()
) -> Path:
    """Compile the kernels of a generated folder, and further files, into a shared library in ``build``.

    Without an optimisation in ``flags`` it compiles fast and runs slowly.

    Raises:
        BuildError: no compiler, or it failed; with its last lines.

    """
    compiler = compiler_command()
    library = build / f"{name}_kernels{sysconfig.get_config_var('SHLIB_SUFFIX') or '.so'}"
    command = [*compiler, "-std=gnu99", *_FAST_TO_COMPILE, *flags, "-fPIC", "-shared", f"-I{folder.resolve()}"]
    command += map(str, (*kernel_sources(folder.resolve(), name), *more))
    run_all([[*command, "-o", str(library), *(["-lm"] if os.name != "nt" else [])]], compiler[0], build)
    return library


def _self_check(command: Sequence[str], folder: Path, name: str, build: Path) -> None:
    """Raise BuildError if the compiler's flags changed the arithmetic of kernels or controller."""
    source, program = build / "self_check.c", build / "self_check"
    calls, headers = [f"{name}_self_check()"], [f"{name}.h"]
    if len(kernel_sources(folder, name)) > 1:
        calls.append(f"{name}_batch_self_check()")
    if (folder / f"{name}_impedance.c").exists():
        calls.append(f"{name}_impedance_self_check()")
        headers.append(f"{name}_impedance.h")
    includes = "".join(f'#include "{header}"\n' for header in headers)
    source.write_text(f"{includes}int main(void) {{ return {' | '.join(calls)}; }}\n")
    libraries = ["-lm"] if os.name != "nt" else []
    run_all([[*command, f"-I{folder}", str(source), "-o", str(program), *libraries]], command[0], build)
    try:
        wrong = subprocess.run([str(program)], stdin=subprocess.DEVNULL, check=False).returncode
    except OSError as error:
        raise BuildError(
            f"{build.parent}: a program compiled there cannot be run ({error.strerror}), as on a mount with noexec; "
            "set TMPDIR to another folder, or use --no-build"
        ) from error
    if wrong != 0:
        raise BuildError(
            f"{shlex.join(command[:1])} compiles with flags that change its arithmetic (self-check {wrong}, see "
            f"{name}.h); take them out of CC and CFLAGS"
        )


def compiler_command() -> list[str]:
    """Return the C compiler and its leading arguments: CC if set, else the first of cc, gcc, clang on the PATH."""
    found = find_compiler("CC", "cc", "gcc", "clang")
    if found:
        return found
    chosen = shlex.split(os.environ.get("CC", ""))
    what = (
        f"the C compiler '{chosen[0]}' named by CC was not found" if chosen else "no C compiler (cc, gcc, clang) found"
    )
    raise NoCompilerError(f"{what}; install one (Debian: apt-get install gcc), set CC, or use --no-build")


def find_compiler(variable: str, *candidates: str) -> list[str]:
    """Return the command that a variable of the environment names, else the first on the PATH; [] without one."""
    chosen = shlex.split(os.environ.get(variable, ""))
    for candidate in [chosen] if chosen else [[each] for each in candidates]:
        if program := shutil.which(candidate[0]):
            return [program, *candidate[1:]]
    return []


def _native(compiler: Sequence[str], build: Path) -> list[str]:
    """Return -march=native where the compiler accepts it; the module refuses to load on other machines."""
    probe = build / "probe.c"
    probe.write_text("int probe;\n")
    try:
        run_all([[*compiler, "-march=native", "-c", str(probe), "-o", str(build / "probe.o")]], compiler[0], build)
    except BuildError:
        return []
    return ["-march=native"]


def _link_options() -> list[str]:
    return ["-bundle", "-undefined", "dynamic_lookup"] if sys.platform == "darwin" else ["-shared"]


def _libraries() -> list[str]:
    if os.name != "nt":
        return ["-lm"]
    return [f"-L{Path(sys.base_prefix) / 'libs'}", f"-lpython{sys.version_info.major}{sys.version_info.minor}"]


def run_all(commands: Sequence[Sequence[str]], compiler: str, temporary: Path) -> None:
    """Run commands in parallel; after an error none is left running and none of their files stays."""
    running: list[subprocess.Popen[str]] = []
    with signals_deferred() as deliver:
        try:
            for command in commands:
                running.append(_start(command, temporary))  # one by one: those before an error are ended, too
            deliver()
            for process in running:
                output, _ = process.communicate()
                if process.returncode != 0:
                    lines = output.rstrip().splitlines()[-_LAST_LINES:]
                    raise BuildError(
                        f"compiling with {compiler} failed (exit code {process.returncode}); repair the compiler, "
                        "choose another one with CC, or use --no-build. Its last lines:\n  " + "\n  ".join(lines)
                    )
        except OSError as error:
            raise BuildError(f"{compiler} cannot be run ({error.strerror}); set CC, or use --no-build") from error
        finally:
            for process in running:
                if process.poll() is None:
                    _kill(process)
                elif process.stdout is not None:
                    process.stdout.close()


def _start(command: Sequence[str], temporary: Path) -> subprocess.Popen[str]:
    """Start a command whose temporary files lie in ``temporary``, which the caller removes."""
    return subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        env=os.environ | {"TMPDIR": str(temporary)},
        start_new_session=True,  # with the compiler's own children
    )


def _kill(process: subprocess.Popen[str]) -> None:
    """End a command with all that it has started, and take its output."""
    if os.name == "nt":
        process.kill()
    else:
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
