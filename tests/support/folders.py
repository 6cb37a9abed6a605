# SPDX-License-Identifier: MIT
"""Copy generated folders, so that tests can change them."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path


def copy_folder(folder: Path, parent: Path) -> Path:
    """Copy a robot's folder, without what was compiled, into ``parent``."""
    target = parent / folder.name
    shutil.copytree(folder, target, ignore=shutil.ignore_patterns("__pycache__"))
    return target


def restamp(folder: Path) -> None:
    """Write the digests of the present files into the manifest, as somebody who tampers would."""
    file = folder / "manifest.json"
    manifest = json.loads(file.read_text())
    for name in manifest["files"]:
        manifest["files"][name] = hashlib.sha256((folder / name).read_bytes()).hexdigest()
    text = json.dumps(manifest, indent=1) + "\n"
    if text != file.read_text():
        file.write_text(text)
