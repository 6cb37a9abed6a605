# SPDX-License-Identifier: MIT
"""Search of ROS packages by the name in their package.xml, which is not always that of their folder.

The order is: folders of ``--package-path``, the template's own package, packages beside it, ``ROS_PACKAGE_PATH``,
``AMENT_PREFIX_PATH``. The working folder has no part in it. A place with two packages of the same name is refused,
since either could be meant.
"""

from __future__ import annotations

import os
import re
import stat
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from stiffgen.core.robot.files import FileError, read_regular

MANIFESTS = ("package.xml", "manifest.xml")
_NAME = re.compile(r"<name(?:\s[^>]*)?>\s*([^<>\s]+)\s*</name\s*>")
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
_IGNORED = ("CATKIN_IGNORE", "AMENT_IGNORE", "COLCON_IGNORE", "rospack_nosubdirs")
_DEPTH_BESIDE, _LEVELS_ABOVE, _DEPTH_NAMED = 2, 4, 8
"""Depth of packages beside a package, levels above it whose folders count, and depth below a folder that is named."""
_MAX_FOLDERS = 20_000
"""Folders of a tree that are looked into."""
_MAX_MANIFEST = 2**20
"""Bytes of a package.xml."""


class PackageError(Exception):
    """A package that is not found, or found twice; the text is a sentence for the user."""


class Packages:
    """Packages that a template may include.

    Attributes:
        own: folder of the template's own package; without one the folder of the template.
        found: folders of the packages asked for, by name.

    """

    def __init__(self, template: Path, named: list[Path], environment: Mapping[str, str]) -> None:
        """List the places where packages are searched, nearest first."""
        above = [template.parent, *template.parent.parents]  # nearest first
        self.own = next((each for each in above if _name_of(each) is not None), template.parent)
        self.found: dict[str, Path] = {}
        ros, ament = (_absolute(environment.get(key, "")) for key in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"))
        # the first place with a package of the name counts: folders of the user, the template's own package, folders
        # above it and beside it, and what the variables of ROS name
        self._places: list[Callable[[str], list[Path]]] = [
            *(_Tree(folder, _DEPTH_NAMED, by_folder=True) for folder in named),
            lambda name: [self.own] if _name_of(self.own) == name else [],
            *(_Tree(each, 0) for each in above if each != self.own),
            *(_Tree(each, _DEPTH_BESIDE, skipped=self.own) for each in (self.own, *_around(self.own))),
            *(_Tree(folder, _DEPTH_NAMED, by_folder=True) for folder in ros),
            *(_Installed(folder) for folder in ament),
        ]
        self.trusted = [*named, *ros, *ament]

    def find(self, name: str) -> str:
        """Return the folder of a package.

        Raises:
            PackageError: there is none, or a place has two.

        """
        if name not in self.found:
            self.found[name] = self._search(name)
        return str(self.found[name])

    def _search(self, name: str) -> Path:
        """Return the package of the first place that has one of this name; two in one place are refused."""
        for place in self._places:
            candidates = place(name)
            if len(candidates) > 1:
                raise PackageError(
                    f"needs the package '{name}', and there are two: '{candidates[0]}' and '{candidates[1]}'; "
                    "name the right one by --package-path DIR"
                )
            if candidates:
                return candidates[0]
        raise PackageError(
            f"needs the package '{name}', which is not found; name the folder that holds it: "
            "--package-path DIR, or the variable ROS_PACKAGE_PATH"
        )


class _Tree:
    """Packages in a folder and below it, to a depth; found when the first of them is asked for."""

    def __init__(self, root: Path, depth: int, by_folder: bool = False, skipped: Path | None = None) -> None:
        """Note the root and the depth; ``by_folder``: a folder's name counts, too; ``skipped`` is no package here."""
        self._root, self._depth, self._by_folder, self._skipped = root, depth, by_folder, skipped
        self._packages: list[tuple[int, str, Path]] | None = None

    def __call__(self, name: str) -> list[Path]:
        """Return the packages of a name at the smallest depth; the name of a folder counts last, where it may."""
        if self._packages is None:
            self._packages = list(self._crawl())
        depths = [depth for depth, each, _ in self._packages if each == name]
        if depths:
            return [path for depth, each, path in self._packages if each == name and depth == min(depths)]
        return self._named_folder(name)[:1] if self._by_folder else []

    def _named_folder(self, name: str) -> list[Path]:
        """Return the root or the folder in it that has a name, unless it is a package of another name."""
        folders = [each for each in (self._root, self._root / name) if each.name == name and each.is_dir()]
        return [each for each in folders if _name_of(each) is None]

    def _crawl(self) -> Iterator[tuple[int, str, Path]]:
        """Yield depth, name and folder of the packages, level by level; a package holds no other, but for the root."""
        pending, seen = deque([(0, self._root)]), 0
        while pending:
            if seen >= _MAX_FOLDERS:
                if self._by_folder:
                    raise PackageError(f"'{self._root}' holds more than {_MAX_FOLDERS} folders; name a smaller folder")
                return
            seen += 1
            depth, folder = pending.popleft()
            name = _name_of(folder)
            if name is not None and folder != self._skipped:
                yield depth, name, folder
            may_hold_packages = name is None or depth == 0
            if depth < self._depth and may_hold_packages:
                pending.extend((depth + 1, each) for each in _subfolders(folder))


class _Installed:
    """Packages that colcon has installed below a prefix."""

    def __init__(self, prefix: Path) -> None:
        self._share = prefix / "share"

    def __call__(self, name: str) -> list[Path]:
        """Return the folder of a package, if it is installed."""
        if re.fullmatch(r"[\w.-]+", name) is None or name.startswith("."):
            return []  # no name of a package: it may lead out of the folder
        folder = self._share / name
        has_marker = (self._share / "ament_index" / "resource_index" / "packages" / name).is_file()
        is_package = folder.is_dir() and (_name_of(folder) == name or has_marker)
        return [folder] if is_package else []


def _around(own: Path) -> Iterator[Path]:
    """Yield the folders above a package, the nearest first, as far as packages beside it are looked for.

    A folder for everybody's temporary files holds packages of anybody; the home folder and those above it hold too
    much. The search ends before them.
    """
    home = Path(os.environ.get("HOME") or os.environ.get("USERPROFILE") or os.sep).resolve()
    for folder in list(own.parents)[:_LEVELS_ABOVE]:
        is_root, is_home_or_above = folder == folder.parent, home.is_relative_to(folder)
        if is_root or is_home_or_above or _is_everybodys(folder):
            return
        yield folder


def _is_everybodys(folder: Path) -> bool:
    """Return whether everybody may write into a folder, each only their own files (/tmp), or it cannot be examined."""
    try:
        mode = folder.stat().st_mode
    except OSError:
        return True
    return bool(mode & stat.S_ISVTX and mode & stat.S_IWOTH)


def _subfolders(folder: Path) -> list[Path]:
    """Return the folders in a folder, by name; none where a file says so, or if it cannot be read."""
    try:
        with os.scandir(folder) as entries:
            listed = list(entries)
            if any(each.name in _IGNORED for each in listed):
                return []
            names = [each.name for each in listed if not each.name.startswith(".") and each.is_dir()]
    except OSError:
        return []
    return [folder / name for name in sorted(names)]


def _name_of(folder: Path) -> str | None:
    """Return the name of the package that a folder is; None for another folder."""
    try:
        text = _COMMENT.sub("", read_regular(folder / MANIFESTS[0], _MAX_MANIFEST).decode("utf-8", "replace"))
    except (OSError, FileError):
        return folder.name if (folder / MANIFESTS[1]).is_file() else None
    match = _NAME.search(text)
    return match[1] if match else None


def _absolute(variable: str) -> list[Path]:
    """Return the absolute folders of a variable; a relative one would depend on the working folder."""
    return [Path(each) for each in variable.split(os.pathsep) if Path(each).is_absolute() and Path(each).is_dir()]
