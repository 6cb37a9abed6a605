# SPDX-License-Identifier: MIT
"""Expand one xacro template, as a script in a process of its own: ``python expansion.py < request.json``.

The template may be anybody's. xacro's own evaluation, which Python's ``eval`` does, is replaced by
:mod:`stiffgen.files.expressions`. Files are read inside the template's packages alone. The process bounds its time and
memory, may not write, run programs or connect, and keeps the settings that xacro holds in globals away from the caller.

The request holds ``file``, ``arguments`` and ``package_path``. The answer is JSON on standard output: ``text``,
``files`` (path and SHA-256 of each file read), ``packages`` (paths of those found), ``warnings``; or ``error``.
"""

from __future__ import annotations

import contextlib
import glob
import hashlib
import io
import json
import os
import re
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from types import MappingProxyType, SimpleNamespace
from typing import Any

from stiffgen.core.robot.files import FileError, read_regular
from stiffgen.files.expressions import FUNCTIONS, MATH, Evaluator, ExpressionError, size
from stiffgen.files.limits import forbid_harm, limit_process
from stiffgen.files.packages import MANIFESTS, PackageError, Packages

SECONDS = 20
"""Processor time that an expansion may take; the largest known template takes 2 s."""
_GIBIBYTES = 2
_MAX_BYTES = 4 * 2**20
_MAX_FILES, _MAX_ELEMENTS = 500, 40_000  # 20 and 1659 in the largest of 35 known templates
_ARGUMENT = re.compile(r"""<xacro:arg\s[^>]*?name\s*=\s*["']([^"']+)|\$\(arg\s+(\w+)\s*\)|\barg\(\s*["'](\w+)""")

_PATH = re.compile(
    r"""<xacro:include\s[^>]*?filename\s*=\s*(?:"([^"]*)"|'([^']*)')|load_yaml\(((?:[^()]|\([^()]*\))*)\)"""
)
_DECLARED = re.compile(r"<xacro:arg\s([^>]*)>")
_ATTRIBUTE = re.compile(r"""(\w+)\s*=\s*["']([^"']*)["']""")
_REPLACED = ("safe_eval", "eval_text", "eval_all", "eval_extension", "load_yaml", "_global_symbols", "NameSpace")


class _TemplateError(Exception):
    """A sentence for the user."""


class _Files:
    """Files that the expansion reads; xacro opens them by this object's method."""

    def __init__(self, packages: Packages) -> None:
        self.packages = packages
        self.texts: dict[str, str] = {}
        self.digests: dict[str, str] = {}
        self._count = 0

    def open(self, path: str, *_: object) -> io.StringIO:
        """Return a file's text, as the function ``open`` of xacro."""
        self._count += 1
        if self._count > _MAX_FILES:
            raise _TemplateError(f"includes more than {_MAX_FILES} files; correct the include that repeats")
        data = read_regular(self._inside(path), _MAX_BYTES)
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

    def matching(self, pattern: str) -> list[str]:
        """Return the files that a pattern names, as the function ``glob`` of xacro."""
        normal = os.path.normpath(pattern)
        self._inside(re.split(r"[*?\[]", normal)[0])
        return glob.glob(normal)  # noqa: PTH207 - as xacro does; Path.glob finds hidden files, too

    def _inside(self, path: str) -> str:
        """Return the path of a file in the template's packages; refuse another one.

        A link is followed, except in folders that the user has named: colcon installs links.
        """
        packages = self.packages
        if os.path.lexists(path) and not _is_below(os.path.realpath(path), [packages.own, *packages.found.values()]):
            path = os.path.normpath(path)
            if not _is_below(path, packages.trusted, links=True):
                raise _TemplateError(
                    f"reads '{path}', which is outside the template's packages; if you trust it, name its folder: "
                    "--package-path DIR"
                )
        return path

    def check_arguments(self, given: dict[str, str]) -> None:
        """Refuse an argument that no file mentions; xacro would ignore a misspelt name."""
        found = [match for text in self.texts.values() for match in _ARGUMENT.findall(text)]
        known = sorted({next(filter(None, names)) for names in found})
        for name in given:
            if name not in known:
                raise _TemplateError(f"has no argument '{name}'; its arguments: {', '.join(known) or '(none)'}")

    def named(self, path: str) -> list[str]:
        """Return the expressions of includes and of load_yaml that a path can come from: it has their last part."""
        found = ["".join(match) for text in self.texts.values() for match in _PATH.findall(text)]
        return [each for each in found if path.endswith(re.split(r"[^\w./-]+", each.rstrip("'\"} "))[-1])]

    def parameters(self) -> dict[str, str | None]:
        """Return the arguments that the files declare or use, in order, with their defaults (None without one)."""
        found: dict[str, str | None] = {}
        for text in self.texts.values():
            for element in _DECLARED.findall(text):
                attributes = dict(_ATTRIBUTE.findall(element))
                name, default = attributes.get("name"), attributes.get("default")
                if name is not None and found.get(name) is None:
                    found[name] = default
            for names in _ARGUMENT.findall(text):
                found.setdefault(next(filter(None, names)), None)
        return found


def _is_below(path: str, folders: list[Path], links: bool = False) -> bool:
    """Return whether a path lies in one of some folders."""
    roots = [os.path.normpath(each) if links else os.path.realpath(each) for each in folders]
    return any(Path(path).is_relative_to(root) for root in roots)


class _Context(dict[str, Any]):
    """Substitution context of xacro with the current file, which ``$(dirname)`` needs."""

    def get(self, key: str, default: Any = None) -> Any:
        """Return an entry; the current file for ``filename``."""
        import xacro

        return (xacro.filestack or [None])[-1] if key == "filename" else super().get(key, default)

    def __missing__(self, key: str) -> Any:
        return self.get(key)


def _expanded(request: dict[str, Any]) -> dict[str, Any]:
    """Return the answer to a request: the template's text after xacro, with files, packages and variables it used."""
    import xacro
    from xacrodoc import XacroDoc

    file = request["file"]
    named = [Path(each).resolve() for each in request["package_path"]]
    packages = Packages(Path(file), named, os.environ)
    files = _Files(packages)
    # the template reads through these, so that each file is noted
    xacro.open, xacro.glob = files.open, SimpleNamespace(glob=files.matching)
    xacro.substitution_args_context = _Context()
    variables = _confine(xacro, packages)
    text = files.open(file).getvalue()
    xacro.init_stacks(file)
    try:
        document = XacroDoc.from_string(text, subargs=dict(request["arguments"]), resolve_packages=False)
    except Exception as error:
        values: dict[str, str | None] = files.parameters() | dict(request["arguments"])
        reason = _reason(error, (xacro.filestack or [file])[-1] or file, file, values, files.named)
        raise _TemplateError(reason) from error
    files.check_arguments(request["arguments"])
    found = {name: os.path.realpath(root) for name, root in packages.found.items()}
    for root in found.values():  # its name is what the template asks for
        manifest = Path(root) / MANIFESTS[0]
        if manifest.is_file():
            files.digests[str(manifest)] = hashlib.sha256(manifest.read_bytes()).hexdigest()
    used = [f"the template reads the environment variable {name}" for name in sorted(variables)]
    return {
        "text": document.dom.toxml(),
        "files": list(files.digests.items()),
        "packages": found,
        "used": used,
        "parameters": list(files.parameters().items()),
    }


def _confine(xacro: Any, packages: Packages) -> set[str]:
    """Replace all of xacro that runs code or finds files; return the set for variables of the environment it reads.

    The order matters: the tables are read before :func:`_replace_names` empties them, and xacro's functions that the
    new ones call are taken before :func:`_patch` replaces them. An expression can call a function only if the evaluator
    holds it, whatever name it has.
    """
    from xacro import substitution_args

    missing = [name for name in _REPLACED if not hasattr(xacro, name)]
    if missing:
        raise ImportError(f"xacro of another version, without {missing[0]}")
    variables: set[str] = set()
    read = substitution_args._eval_env

    def environment(name: str) -> str:
        variables.add(name)
        return str(read(name))

    def optional(name: str, default: str = "") -> str:
        return environment(name) if name in os.environ else default

    namespaces, bare = _tables(xacro)
    functions = [*namespaces["xacro"].values(), *bare.values(), environment, optional, packages.find]
    evaluator = Evaluator(functions, xacro.NameSpace, xacro.YamlDictWrapper)
    _replace_names(xacro._global_symbols, namespaces, bare)
    _patch(xacro, evaluator, {"env": environment, "optenv": optional, "find": packages.find})
    return variables


def _tables(xacro: Any) -> tuple[dict[str, Mapping[str, Any]], dict[str, Any]]:
    """Return the names that a template may use: those of each namespace ("math.pi"), and those without one ("pi").

    Functions of xacro stay, but for ``load_yaml`` without a bound on its result, and for ``tokenize``, which compiles
    the template's separators as a regular expression. Those of Python are the ones in ``FUNCTIONS`` and ``MATH``.
    """
    symbols = xacro._global_symbols
    load = _checked(xacro.load_yaml)
    own = dict(symbols["xacro"].items()) | {"load_yaml": load, "tokenize": FUNCTIONS["tokenize"]}
    bare = {name: value for name, value in {**FUNCTIONS, **MATH}.items() if name in symbols}
    # older templates call these without the namespace xacro
    bare |= {name: symbols[name] for name in ("load_yaml", "abs_filename", "dotify") if name in symbols}
    if "load_yaml" in bare:
        bare["load_yaml"] = load
    return {"xacro": own, "python": FUNCTIONS, "math": MATH}, bare


def _replace_names(
    symbols: dict[str, Any], namespaces: Mapping[str, Mapping[str, Any]], bare: Mapping[str, Any]
) -> None:
    """Leave no names in xacro's global symbols but those of the tables; xacro's objects themselves stay in use."""
    spaces = {name: symbols[name] for name in namespaces}
    for name, space in spaces.items():
        # the methods of dict: assignment to a namespace of xacro evaluates texts
        dict.clear(space)
        dict.update(space, namespaces[name])
    symbols.clear()
    symbols.update({**bare, **spaces})


def _patch(xacro: Any, evaluator: Evaluator, calls: dict[str, Any]) -> None:
    """Replace xacro's functions; after this call, no path of xacro leads to Python's eval.

    ``calls`` are the replacements of env, optenv and find by these names, under which ``$(eval ...)`` has them, too.
    """
    from xacro import substitution_args

    substitution_args._eval_env, substitution_args._eval_optenv = calls["env"], calls["optenv"]  # $(env X), $(optenv X)
    substitution_args._eval_find = calls["find"]  # $(find PACKAGE): the template's packages alone
    substitution_args._eval = _substitution(substitution_args, evaluator, calls)  # $(eval ...)
    xacro.safe_eval = lambda text, symbols, *_: evaluator.evaluate(text, symbols)  # ${...}, and units in YAML
    xacro.eval = substitution_args.eval = None  # hides Python's eval from both modules
    xacro.eval_text, xacro.eval_all = _short(xacro.eval_text), _counted(xacro.eval_all)
    xacro.eval_extension = _without_working_folder(xacro.eval_extension)  # $(cwd)


def _checked(load_yaml: Callable[[str], Any]) -> Callable[[str], Any]:
    """Return ``load_yaml`` that refuses aliases which repeat content without end."""

    def load(filename: str) -> Any:
        content = load_yaml(filename)
        if size(content) > _MAX_BYTES:
            raise _TemplateError(f"'{filename}' repeats content by aliases without end; write it out")
        return content

    return load


def _substitution(module: Any, evaluator: Evaluator, calls: dict[str, Any]) -> Callable[[str, Any], str]:
    """Return the evaluation of ``$(eval ...)``."""

    def evaluate(text: str, context: Any) -> str:
        names = {"true": True, "false": False, **FUNCTIONS, **MATH, **calls}
        given = {name: module.convert_value(value, "auto") for name, value in context["arg"].items()}
        names |= {"arg": given.__getitem__, "dirname": lambda: module._eval_dirname(context["filename"])}
        for each in (names["arg"], names["dirname"]):
            evaluator.functions[id(each)] = each
        return str(evaluator.evaluate(text, given | names))

    return evaluate


def _short(eval_text: Callable[..., Any]) -> Callable[..., Any]:
    """Return xacro's evaluation of a text with a bound on the result."""

    def evaluate(*arguments: Any, **named: Any) -> Any:
        result = eval_text(*arguments, **named)
        if isinstance(result, str) and len(result) > _MAX_BYTES:
            raise _TemplateError(f"has a text above {_MAX_BYTES // 2**20} MiB; correct the property that repeats")
        return result

    return evaluate


def _counted(eval_all: Callable[..., None]) -> Callable[..., None]:
    """Return xacro's evaluation of an element with a bound on their number."""
    count = 0

    def evaluate(*arguments: Any) -> None:
        nonlocal count
        count += 1
        if count > _MAX_ELEMENTS:
            raise _TemplateError(f"expands to more than {_MAX_ELEMENTS} elements; correct the macro that repeats")
        eval_all(*arguments)

    return evaluate


def _without_working_folder(eval_extension: Callable[[str], Any]) -> Callable[[str], Any]:
    """Return the evaluation of ``$(...)`` without the working folder, which no robot may depend on."""

    def evaluate(text: str) -> Any:
        if text == "$(cwd)":
            raise _TemplateError("asks for the working folder by $(cwd); write $(dirname), the template's own folder")
        return eval_extension(text)

    return evaluate


def _reason(
    error: BaseException,
    current: str,
    file: str,
    values: Mapping[str, str | None] = MappingProxyType({}),
    named: Callable[[str], list[str]] = lambda path: [],
) -> str:
    """Return the sentence for an error of xacro: the first cause that has a remedy, else xacro's own words.

    ``values`` are those of the template's arguments; None for an argument without a default that is not given.
    ``named`` returns the expressions that a path can come from.
    """
    from xacro.substitution_args import ArgException

    where = "" if current == file else f" in '{os.path.relpath(current, Path(file).parent)}'"
    for cause in _causes(error):
        if isinstance(cause, (_TemplateError, ExpressionError, FileError)):
            return str(cause)
        if isinstance(cause, PackageError):
            return f"{cause}{where}"
        if isinstance(cause, ArgException):
            names = dict.fromkeys([str(cause), *(name for name, value in values.items() if value is None)])
            return f"{_needs(list(names))}{where}; add {_added(list(names))}"
        if isinstance(cause, OSError):
            text = f"cannot read '{cause.filename}'"
            if empty := _empty(values, " ".join(named(str(cause.filename)))):
                return _said_of_empty(empty, where, text)
            return f"{text} ({cause.strerror}){where}; correct the path or add the file"
        if isinstance(cause, RecursionError):
            return f"calls itself without end{where}; correct the macro or include that repeats"
        if isinstance(cause, MemoryError):
            return f"needs more than {_GIBIBYTES} GiB of memory to expand{where}; correct what repeats in it"
        if type(cause).__name__ == "ExpatError":
            return f"is not well-formed XML{where}: {cause}; correct it"
    text = " ".join(str(error).split()) or type(error).__name__
    if empty := _empty(values, text):
        return _said_of_empty(empty, where, text)
    return f"xacro cannot expand it{where}: {text}; correct the template"


def _empty(values: Mapping[str, str | None], text: str) -> list[str]:
    """Return the arguments that are empty and that a text names."""
    words = set(re.findall(r"\w+", text))
    return [name for name, value in values.items() if value == "" and name in words]


def _added(names: list[str]) -> str:
    return " ".join(f"{name}:=VALUE" for name in names)


def _said_of_empty(names: list[str], where: str, text: str) -> str:
    verb = "is" if len(names) == 1 else "are"
    return f"{_needs(names)}{where}, which {verb} empty: {text}; add {_added(names)}"


def _needs(names: list[str]) -> str:
    quoted = ", ".join(f"'{name}'" for name in names)
    return f"needs a value for its argument {quoted}" if len(names) == 1 else f"needs values for its arguments {quoted}"


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


def _import_all() -> None:
    """Import what xacro imports late, before imports are forbidden."""
    with contextlib.suppress(ImportError):
        import xml.dom.expatbuilder

        import xacrodoc

        xml.dom.expatbuilder.parseString("<a/>")
        xacrodoc.XacroDoc.from_string('<robot name="a"/>')
        import_module("yaml").safe_load("[]")


def main() -> None:
    """Answer the request on standard input."""
    request = json.load(sys.stdin)
    limit_process(SECONDS, _GIBIBYTES)
    _import_all()
    forbid_harm()
    noise = io.StringIO()
    try:
        with contextlib.redirect_stderr(noise), contextlib.redirect_stdout(noise):
            answer = _expanded(request)
    except ImportError as error:
        answer = {"missing": str(error)}
    except Exception as error:
        answer = {"error": _reason(error, request["file"], request["file"])}
    plain = re.sub(r"\x1b\[[0-9;]*m", "", noise.getvalue())
    warnings = [line[9:] for line in plain.splitlines() if line.startswith("warning: ")]
    answer["warnings"] = [*answer.pop("used", ()), *warnings]
    json.dump(answer, sys.stdout)


if __name__ == "__main__":
    main()
