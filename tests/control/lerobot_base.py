# SPDX-License-Identifier: MIT
"""Import the plug-in for LeRobot, from its wheel.

LeRobot needs PyTorch, gigabytes. The tests need LeRobot's base class, its registry and its discovery. LeRobot itself
is its wheel, installed with ``pip install --no-deps lerobot``. Stand-ins replace modules that are not installed and
that LeRobot's annotations take types from.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType

from support.project import ROOT

PACKAGE = ROOT / "examples" / "lerobot_robot_stiffgen"
EPISODE = PACKAGE / "episode"
IS_WHOLE = all(importlib.util.find_spec(name) for name in ("torch", "datasets"))
"""Whether LeRobot's replay can be imported."""
MODULES = ("torch", "accelerate", "datasets", "serial", "deepdiff")
STAND_INS = (*(name for name in MODULES if not importlib.util.find_spec(name)), "lerobot.processor")
"""Modules without which LeRobot's base classes cannot be imported."""


class _StandIns(MetaPathFinder, Loader):
    """Modules whose every attribute is a class without content."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find a stand-in."""
        found = any(fullname == name or fullname.startswith(f"{name}.") for name in STAND_INS)
        return ModuleSpec(fullname, self, is_package=True) if found else None

    def exec_module(self, module: ModuleType) -> None:
        """Fill a stand-in."""
        vars(module)["__getattr__"] = lambda name: type(name, (), {})


@contextmanager
def installed_plugin(folder: Path) -> Iterator[None]:
    """Build the plug-in's wheel and install it into an empty folder on Python's path, until the context ends."""
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(build, cwd=PACKAGE, check=True, capture_output=True)
    with zipfile.ZipFile(next(folder.glob("*.whl"))) as wheel:
        wheel.extractall(folder)
    before = set(sys.modules)
    stand_ins = _StandIns()
    sys.path.insert(0, str(folder))
    if not IS_WHOLE:
        sys.meta_path.insert(0, stand_ins)
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        if not IS_WHOLE:
            sys.meta_path.remove(stand_ins)
        own = ("lerobot", "lerobot_robot_stiffgen", *(() if IS_WHOLE else STAND_INS))
        for name in set(sys.modules) - before:
            if name.split(".")[0] in own:
                del sys.modules[name]
