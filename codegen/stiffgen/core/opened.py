# SPDX-License-Identifier: MIT
"""A robot's folder as one object: the chain it was generated from, its compiled module, its functions by name."""

from __future__ import annotations

import hashlib
import importlib.util
import sys
import textwrap
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

from stiffgen.core.errors import OutputError, StiffgenError, listed, printable
from stiffgen.core.given import checked_path
from stiffgen.core.lower.scalar import DOUBLE, Scalar
from stiffgen.core.manifest import (
    DAMAGE,
    MANIFEST,
    chain_from_manifest,
    read_manifest,
    scalar_of_manifest,
    springs_of_manifest,
)
from stiffgen.core.names import checked_identifier
from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.files import exists
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.kernel import PACKED, Kernel


@dataclass(frozen=True, repr=False)
class GeneratedRobot:
    """Folder that ``stiffgen generate`` wrote; from :func:`open_robot`.

    The folder was generated from ``chain`` and ``springs``. ``manifest`` is the parsed manifest.json, ``name`` the
    prefix of its C names, ``scalar`` the type of its numbers.
    """

    folder: Path
    name: str
    chain: Chain
    springs: KernelOptions
    manifest: Mapping[str, Any]
    scalar: Scalar

    def __repr__(self) -> str:
        return overview(self)

    @cached_property
    def table(self) -> tuple[Kernel, ...]:
        """The kernel table's records of its functions.

        Raises:
            OutputError: the manifest asks for functions that this version does not have.

        """
        # Opening needs no kernel, and importing all families takes longer than all else.
        from stiffgen.core.symbolic.kernels import chain_kernels

        try:
            return chain_kernels(self.chain, self.springs)
        except (*DAMAGE, NotImplementedError, RuntimeError, StiffgenError) as error:  # also what CasADi raises
            raise _damaged(self.folder, error) from error

    def require_doubles(self, what: str) -> None:
        """Raise OutputError unless the folder's numbers are doubles, as ``what`` takes them."""
        if self.scalar != DOUBLE:
            raise OutputError(
                f"{self.folder}: was generated with --scalar {self.scalar.name}, and {what} takes doubles; generate a "
                "second folder without --scalar, with another --name"
            )

    @property
    def has_controller(self) -> bool:
        """Whether the folder has an impedance controller."""
        return f"{self.name}_impedance.c" in self.manifest["files"]

    @property
    def has_batches(self) -> bool:
        """Whether the folder has functions of many configurations."""
        return f"{self.name}_batch.c" in self.manifest["files"]

    def kernel_text(self) -> str:
        """Return the C of all kernels in one piece.

        Raises:
            OutputError: a file cannot be read.

        """
        files = [f"{self.name}{end}" for end in ("_lanes.h", ".c", "_batch.c")]
        try:
            return joined_kernels(
                self.name,
                {
                    file: (self.folder / file).read_text(encoding="utf-8")
                    for file in files
                    if file in self.manifest["files"]
                },
            )
        except OSError as error:
            raise _unreadable(error) from error

    def source_digests(self) -> dict[str, str]:
        """Return the SHA-256 of every C source and header of the folder, by file.

        Raises:
            OutputError: one of them cannot be read, or the manifest lists none.

        """
        files = sorted(file for file in self.manifest["files"] if file.endswith((".c", ".h")))
        if f"{self.name}.c" not in files:
            raise OutputError(f"{self.folder / MANIFEST}: lists no {self.name}.c; generate the folder again")
        return self.digests(files)

    def digests(self, files: Iterable[str]) -> dict[str, str]:
        """Return the SHA-256 of files of the folder, by file.

        Raises:
            OutputError: a file cannot be read.

        """
        try:
            return {file: hashlib.sha256((self.folder / file).read_bytes()).hexdigest() for file in files}
        except OSError as error:
            raise _unreadable(error) from error

    @property
    def module_name(self) -> str:
        """Name of the module: the folder's path, so that every process of this machine finds it again."""
        path = str(self.folder.resolve())
        return _MODULE + path.replace("%", "%25").replace(".", "%2E")  # a dot would part a package from its module

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the folder's path alone; reading the pickle opens the folder."""
        trusted = not any(each.is_sealed for each in self.springs.potentials)
        return partial(open_robot, trust_potentials=trusted), (self.folder.resolve(),)

    @cached_property
    def module(self) -> ModuleType:
        """The Python package, imported under a name of its own, wherever the folder lies.

        Raises:
            OutputError: the folder has no Python module, or the module is not compiled for this Python.

        """
        if not (self.folder / "__init__.py").exists():
            raise OutputError(
                f"{self.folder}: has no Python module (--no-python), which is needed here; generate a second folder "
                "without --no-python, with another --name"
            )
        name = self.module_name
        spec = module_spec(name, self.folder)
        loaded = sys.modules.get(name)
        if loaded is not None and loaded.__spec__ is not None and loaded.__spec__.loader_state == spec.loader_state:
            return loaded  # pickles name classes, which must be the same for all that open the folder
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        try:
            spec.loader.exec_module(module)
        except (OSError, ImportError, SyntaxError) as error:
            del sys.modules[name]
            cause = f" ({error.__cause__})" if error.__cause__ is not None else ""
            raise OutputError(f"{self.folder}: {error}{cause}") from error
        return module

    @cached_property
    def kernels(self) -> dict[str, Callable[..., Any]]:
        """The functions of the module by qualified name ("hybrid_joint_stiffness"), those of ``packed`` with "_packed".

        Raises:
            OutputError: see :attr:`module`; also if a function is missing, as in a folder of another version.

        """
        return functions_of(self.module, self.table, self.folder)


def _damaged(folder: Path, error: Exception) -> OutputError:
    what = f"{type(error).__name__}: {printable(str(error), 150)}" if str(error) else type(error).__name__
    return OutputError(f"{folder / MANIFEST}: is damaged or of another version ({what}); generate it again")


_MODULE = "stiffgen._robot_in_"
"""Beginning of the name of a folder's module; its path follows."""


def module_spec(name: str, folder: Path) -> ModuleSpec:
    """Return the specification of a folder's module under a name; its ``loader_state`` is a digest of the manifest."""
    file = folder / "__init__.py"
    spec = importlib.util.spec_from_file_location(name, file, submodule_search_locations=[str(folder)])
    assert spec is not None  # a path that ends in .py has a loader
    with suppress(OSError):  # the module is then imported without it, or not at all
        spec.loader_state = hashlib.sha256((folder / MANIFEST).read_bytes()).hexdigest()
    return spec


def spec_of(name: str) -> ModuleSpec:
    """Return the specification of the module of a folder that was opened by its path, for the package's finder.

    Raises:
        ModuleNotFoundError: the folder is not there.

    """
    folder = Path(name.removeprefix(_MODULE).replace("%2E", ".").replace("%25", "%"))
    if not (folder / "__init__.py").exists():
        raise ModuleNotFoundError(f"{folder}: has no Python module; generate the robot there again", name=name)
    return module_spec(name, folder)


def _unreadable(error: OSError) -> OutputError:
    return OutputError(f"{error.filename}: cannot be read ({error.strerror}); generate the folder again")


_MOST_JOINTS = 20
_WIDTH = 100


def overview(robot: GeneratedRobot) -> str:
    """Return joints, tips and functions of a robot as a table of one screen."""
    chain = robot.chain
    rows: list[tuple[str, ...]] = [("q", "joint", "type", "lower", "upper", "velocity", "effort")]
    for k, each in enumerate(chain.coordinates[:_MOST_JOINTS]):
        limits = (f"{value:.5g}" for value in (each.lower, each.upper, each.velocity, each.effort))
        rows.append((str(k), printable(each.name, 30), each.type, *limits))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        f"{robot.name}: {chain.dof} coordinates, base {printable(chain.base)}, "
        f"tip {listed([tip.link for tip in chain.tips], 8)}, {robot.folder}",
        *(
            " ".join(cell.ljust(width) if k in (1, 2) else cell.rjust(width) for k, (cell, width) in enumerate(pairs))
            for pairs in (list(zip(row, widths, strict=True)) for row in rows)  # cells with their columns' widths
        ),
    ]
    if len(chain.coordinates) > _MOST_JOINTS:
        lines.append(f"and {len(chain.coordinates) - _MOST_JOINTS} more joints")
    lines.append("functions of .module (rad, m, N, N m; arguments: help(robot.module)):")
    for group, names in _functions_by_group(robot).items():
        text = f"  {group}: {', '.join(names)}" if group else f"  {', '.join(names)}"
        lines += textwrap.wrap(text, _WIDTH, initial_indent="  ", subsequent_indent="      ")
    if robot.has_controller:
        lines.append("  Impedance(**config): the impedance controller")
    return "\n".join(lines)


def _functions_by_group(robot: GeneratedRobot) -> dict[str, list[str]]:
    """Return the names of functions by the groups that have them ("body, spatial"); products are left out."""
    names_of: dict[str, list[str]] = {}
    for kernel in robot.table:
        if not kernel.product_of:
            names_of.setdefault(kernel.path[-1] if kernel.path else "", []).append(kernel.name)
    groups_with: dict[tuple[str, ...], list[str]] = {}
    for group, names in names_of.items():
        groups_with.setdefault(tuple(dict.fromkeys(names)), []).append(group)  # several tips repeat names
    return {", ".join(groups): list(names) for names, groups in groups_with.items()}


def joined_kernels(name: str, texts: Mapping[str, str]) -> str:
    """Return the C of all kernels in one piece: single calls and batches, behind the header that both include.

    The single calls use vectors as wide as those of the batches.
    """
    include = f'#include "{name}_lanes.h"\n'
    single, batch = texts[f"{name}.c"], texts.get(f"{name}_batch.c", "")
    return single.replace(f"#define SINGLE_CALLS\n{include}", texts[f"{name}_lanes.h"]) + batch.replace(include, "")


def functions_of(module: ModuleType, kernels: tuple[Kernel, ...], folder: Path) -> dict[str, Callable[..., Any]]:
    """Return the functions of a generated module by the qualified names of ``kernels``; OutputError if one is missing.

    Those that give symmetric results as upper triangles have "_packed" behind these names.
    """
    places = {kernel.qualified_name: (*kernel.path, kernel.name) for kernel in kernels}
    packed = [kernel.qualified_name for kernel in kernels if kernel.packed]
    places |= {f"{name}{PACKED}": ("packed", name) for name in packed}
    functions = {}
    for function, path in places.items():
        owner: Any = module
        try:
            for name in path:
                owner = getattr(owner, name)
        except AttributeError as error:
            raise OutputError(f"{folder}: has no function {function}; generate the folder again") from error
        functions[function] = owner
    return functions


def open_robot(folder: str | Path, *, trust_potentials: bool = False) -> GeneratedRobot:
    """Open a robot's folder. Its module is imported when it is first asked for.

    Importing the module runs the folder's code: open folders of people you trust (docs/guarantees.md).

    Args:
        folder: what ``stiffgen generate`` wrote.
        trust_potentials: run the source of potentials in manifest.json; without it they have names and parameters, and
            programs of their functions are refused.

    Returns:
        The robot: ``chain``, ``springs``, ``module``, ``table``, ``kernels``, ``manifest``, ``name``, ``folder``.

    Raises:
        OutputError: the folder is none of stiffgen's, or its manifest is damaged.

    """
    folder = Path(checked_path(folder, "open_robot"))
    manifest = read_manifest(folder)
    if manifest is None and not exists(folder):
        raise OutputError(f"{folder}: does not exist; give the folder that 'stiffgen generate' wrote")
    if manifest is None:
        raise OutputError(
            f"{folder}: is not a folder that 'stiffgen generate' wrote (it has no readable {MANIFEST} of stiffgen); "
            "give the robot's own folder"
        )
    try:
        chain = chain_from_manifest(manifest)
        name = checked_identifier(manifest["name"])
        springs = springs_of_manifest(manifest, trust_potentials)
        scalar = scalar_of_manifest(manifest)
    except (*DAMAGE, NotImplementedError, RuntimeError, StiffgenError) as error:
        raise _damaged(folder, error) from error
    return GeneratedRobot(folder, name, chain, springs, manifest, scalar)
