# SPDX-License-Identifier: MIT
"""Folders of results that appear whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from stiffgen.errors import OutputError, printable


@contextmanager
def swapped_in(target: Path) -> Iterator[Path]:
    """A new folder beside ``target`` to write into, which takes its place when the block ends well.

    After an error, ``target`` is what it was, and nothing is left beside it.

    Raises:
        OutputError: the folder cannot be made, or not put in its place.

    """
    output = target.parent
    try:
        created = _missing_parents(output)
        output.mkdir(parents=True, exist_ok=True)
        staging = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=output))
    except OSError as error:
        raise unwritable(output, error) from error
    try:
        yield staging
        _swap(staging, target)
    except BaseException as error:
        shutil.rmtree(staging, ignore_errors=True)
        for folder in created:
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()
        if isinstance(error, OSError):  # a full disk
            raise unwritable(target, error) from error
        raise


def unwritable(path: Path, error: OSError) -> OutputError:
    """The refusal of a folder that the system does not let us write: full, forbidden, a name too long."""
    return OutputError(
        f"{printable(str(path), 200)}: cannot be written ({error.strerror or error}); "
        "make room, or choose another --output"
    )


def _missing_parents(folder: Path) -> list[Path]:
    """Folders that do not exist yet, the innermost first."""
    return [each for each in (folder, *folder.parents) if not each.exists()]


def _swap(staging: Path, target: Path) -> None:
    umask = os.umask(0)
    os.umask(umask)
    try:
        staging.chmod(0o777 & ~umask)  # mkdtemp makes private folders
        if not target.exists():
            staging.rename(target)
            return
        old = Path(tempfile.mkdtemp(prefix=f".{target.name}.old.", dir=target.parent))
        target.rename(old / target.name)
        try:
            staging.rename(target)
        except OSError:
            (old / target.name).rename(target)
            raise
        finally:
            shutil.rmtree(old, ignore_errors=True)
    except OSError as error:
        raise OutputError(
            f"{target}: cannot be replaced ({error.strerror}); close what uses it and try again"
        ) from error
