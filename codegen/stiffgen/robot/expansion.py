# SPDX-License-Identifier: MIT
"""Expand one xacro template, as a script in a process of its own: ``python expansion.py < request.json``.

A template runs expressions and may not end. The process bounds its time and memory, and keeps the settings that
xacro holds in globals away from the caller. Of stiffgen the script imports its limits alone.

The request holds ``file``, ``arguments`` and ``package_path``. The answer is JSON on standard output: ``text``,
``files`` (path and SHA-256 of each file read), ``packages`` (paths of those found), ``warnings``; or ``error``.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import re
import stat
import sys
from pathlib import Path
from typing import Any

from stiffgen.robot.limits import limit_process

SECONDS = 20
"""Processor time that an expansion may take; the largest known template takes 2 s."""
_GIBIBYTES = 2
_MAX_BYTES = 4 * 2**20
_ARGUMENT = re.compile(r"""<xacro:arg\s[^>]*?name\s*=\s*["']([^"']+)|\$\(arg\s+(\w+)\s*\)|\barg\(\s*["'](\w+)""")


class _TemplateError(Exception):
    """A sentence for the user."""


class _Files:
    """Files that the expansion reads; xacro opens them by this object's method."""

    def __init__(self) -> None:
        self.texts: dict[str, str] = {}
        self.digests: dict[str, str] = {}

    def open(self, path: str, *_: object) -> io.StringIO:
        """Return a file's text, as the function ``open`` of xacro."""
        with Path(path).open("rb") as stream:
            if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
                raise _TemplateError(f"'{path}' is not a regular file; include XML or YAML files")
            data = stream.read(_MAX_BYTES + 1)
        if len(data) > _MAX_BYTES:
            raise _TemplateError(
                f"'{path}' is larger than {_MAX_BYTES // 2**20} MiB; include files of a description alone"
            )
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            raise _TemplateError(f"'{path}' is not UTF-8 text ({error.reason}); save it as UTF-8") from error
        if re.search(r"<!\s*(DOCTYPE|ENTITY)", text):
            raise _TemplateError(
                f"'{path}' has a DOCTYPE; a template needs none: remove the <!DOCTYPE ...> declaration"
            )
        self.texts[path], self.digests[path] = text, hashlib.sha256(data).hexdigest()
        return io.StringIO(text)

    def check_arguments(self, given: dict[str, str]) -> None:
        """Refuse an argument that no file mentions; xacro would ignore a misspelt name."""
        found = [match for text in self.texts.values() for match in _ARGUMENT.findall(text)]
        known = sorted({next(filter(None, names)) for names in found})
        for name in given:
            if name not in known:
                raise _TemplateError(f"has no argument '{name}'; its arguments: {', '.join(known) or '(none)'}")


class _Context(dict[str, Any]):
    """Substitution context of xacro with the current file, which ``$(dirname)`` needs."""

    def get(self, key: str, default: Any = None) -> Any:
        """Return an entry; the current file for ``filename``."""
        import xacro

        return (xacro.filestack or [None])[-1] if key == "filename" else super().get(key, default)

    def __missing__(self, key: str) -> Any:
        return self.get(key)


def _expanded(request: dict[str, Any]) -> dict[str, Any]:
    """Return the answer to a request."""
    import xacro
    from xacrodoc import XacroDoc, packages

    file, folders = request["file"], [str(Path(each).resolve()) for each in request["package_path"]]
    files = _Files()
    xacro.open = files.open
    xacro.substitution_args_context = _Context()
    packages.walk_up_from(file)
    folders += [each for each in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if Path(each).is_dir()]
    for folder in reversed(folders):
        packages.look_in(folder)
        inside = [each for each in Path(folder).iterdir() if each.is_dir() and not each.name.startswith(".")]
        packages.update_package_cache({each.name: each for each in (*inside, Path(folder))})
    asked: dict[str, str] = {}
    find = packages.get_path

    def find_and_note(package: str) -> str:
        asked[package] = str(Path(find(package)).resolve())
        return asked[package]

    packages.get_path = find_and_note
    text = files.open(file).getvalue()
    xacro.init_stacks(file)
    try:
        document = XacroDoc.from_string(text, subargs=dict(request["arguments"]), resolve_packages=False)
    except Exception as error:
        raise _TemplateError(_reason(error, (xacro.filestack or [file])[-1] or file, file)) from error
    files.check_arguments(request["arguments"])
    for root in asked.values():  # its name is what the template asks for
        manifest = Path(root) / "package.xml"
        if manifest.is_file():
            files.digests[str(manifest)] = hashlib.sha256(manifest.read_bytes()).hexdigest()
    return {"text": document.dom.toxml(), "files": list(files.digests.items()), "packages": asked}


def _reason(error: BaseException, current: str, file: str) -> str:
    """Return the sentence for an error of xacro: the first cause that has a remedy, else xacro's own words."""
    from xacro.substitution_args import ArgException
    from xacrodoc.packages import PackageNotFoundError

    where = "" if current == file else f" in '{os.path.relpath(current, Path(file).parent)}'"
    for cause in _causes(error):
        if isinstance(cause, _TemplateError):
            return str(cause)
        if isinstance(cause, PackageNotFoundError):
            return (
                f"needs the package '{cause.args[0]}'{where}, which is not found; name the folder that holds it: "
                "--package-path DIR, or the variable ROS_PACKAGE_PATH"
            )
        if isinstance(cause, ArgException):
            return f"needs a value for its argument '{cause}'{where}; add {cause}:=VALUE"
        if isinstance(cause, OSError):
            return f"cannot read '{cause.filename}' ({cause.strerror}){where}; correct the path or add the file"
        if isinstance(cause, RecursionError):
            return f"calls itself without end{where}; correct the macro or include that repeats"
        if isinstance(cause, MemoryError):
            return f"needs more than {_GIBIBYTES} GiB of memory to expand{where}; correct what repeats in it"
        if type(cause).__name__ == "ExpatError":
            return f"is not well-formed XML{where}: {cause}; correct it"
    text = " ".join(str(error).split()) or type(error).__name__
    return f"xacro cannot expand it{where}: {text}; correct the template"


def _causes(error: BaseException | None) -> list[BaseException]:
    """Return an error and its causes, each once, as xacro and Python chain them."""
    found: list[BaseException] = []
    pending = [error]
    while pending:
        each = pending.pop()
        if isinstance(each, BaseException) and each not in found:
            found.append(each)
            pending += [getattr(each, "exc", None), each.__cause__, each.__context__]
    return found


def main() -> None:
    """Answer the request on standard input."""
    request = json.load(sys.stdin)
    limit_process(SECONDS, _GIBIBYTES)
    noise = io.StringIO()
    try:
        with contextlib.redirect_stderr(noise), contextlib.redirect_stdout(noise):
            answer = _expanded(request)
    except _TemplateError as error:
        answer = {"error": str(error)}
    except ImportError as error:
        answer = {"missing": str(error)}
    except Exception as error:
        answer = {"error": _reason(error, request["file"], request["file"])}
    plain = re.sub(r"\x1b\[[0-9;]*m", "", noise.getvalue())
    answer["warnings"] = [line[9:] for line in plain.splitlines() if line.startswith("warning: ")]
    json.dump(answer, sys.stdout)


if __name__ == "__main__":
    main()
