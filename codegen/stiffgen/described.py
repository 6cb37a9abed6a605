# SPDX-License-Identifier: MIT
"""Descriptions of options: fields of records, which Python, the command line and the docstrings read."""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, Field, dataclass, field, fields
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

from stiffgen.errors import StiffgenError

_Options = ParamSpec("_Options")
_Record = TypeVar("_Record")
_Result = TypeVar("_Result")
_OPTIONS = "        options: record of options."
"""Line of a docstring that becomes the meanings of the record's fields."""
_WITH_VALUE = ("accept_inertia", "base", "ignore", "package_path", "springs")
"""Options whose name a message puts before a value."""
_FLAG = re.compile(r"""(--[a-z][a-z-]*)( ((?:'[^']*'|"[^"]*"|[^\s,;:()'"])+))?""")
"""Option in a message, and the word behind it as a shell takes it."""
_QUOTED = re.compile(r"""'([^']*)'|"([^"]*)\"""")


@dataclass(frozen=True)
class Help:
    """Description of an option, for the docstring and for --help.

    Attributes:
        meaning: a phrase with unit and default.
        negative: meaning of the flag --no-NAME, for an option that is True by default.
        command: keyword arguments of argparse; None where the command line has no such option.
        flag: name on the command line; "" for the field's own.
        group: heading of the option in --help; "" for none.
        record: record whose fields the option sets one by one, as NAME=VALUE; None for other options.

    """

    meaning: str
    negative: str = ""
    command: Mapping[str, Any] | None = field(default_factory=dict)
    flag: str = ""
    group: str = ""
    record: type[Any] | None = None


def described(
    meaning: str,
    negative: str = "",
    flag: str = "",
    group: str = "",
    record: type[Any] | None = None,
    **command: Any,
) -> dict[str, Help]:
    """Return the metadata of a field that is an option in Python and on the command line."""
    return {"help": Help(meaning, negative, command, flag, group, record)}


def option(meaning: str, *, default: Any = MISSING, factory: Any = MISSING, **more: Any) -> Any:
    """Return a field with a default that is an option in Python and on the command line (:func:`described`)."""
    return field(default=default, default_factory=factory, metadata=described(meaning, **more))


def python_option(meaning: str, *, default: Any = MISSING, factory: Any = MISSING) -> Any:
    """Return a field of a record that the command line does not have."""
    return field(default=default, default_factory=factory, metadata={"help": Help(meaning, command=None)})


def help_of(option: Field[Any]) -> Help:
    """Return the description of a field of a record of options."""
    metadata = option.metadata["help"]
    assert isinstance(metadata, Help)
    return metadata


def flag_of(option: Field[Any]) -> str:
    """Return the name of an option on the command line; of an option that is True by default, without "no"."""
    return help_of(option).flag or f"--{option.name.replace('_', '-')}"


def with_attributes(record: type[Any]) -> str:
    """Return the docstring of a record of options, with the meaning of each field."""
    lines = (f"    {option.name}: {help_of(option).meaning}." for option in fields(record))
    return "\n".join([f"{record.__doc__}\n\nAttributes:", *lines])


def meanings(record: Any) -> list[str]:
    """Return the lines of a docstring with the meaning of each field, as arguments."""
    return [
        line
        for each in fields(record)
        for line in textwrap.wrap(
            f"{each.name}: {help_of(each).meaning}.", 108, initial_indent=8 * " ", subsequent_indent=12 * " "
        )
    ]


def in_python(text: str, record: Any) -> str:
    """Return a message with the keywords of Python, fields of ``record``, in place of the command line's options."""
    keywords = {flag_of(each): each for each in fields(record)}

    def keyword(match: re.Match[str]) -> str:
        flag, rest, value = match[1], match[2] or "", _QUOTED.sub(r"\1\2", match[3] or "")
        if flag.startswith("--no-") and f"--{flag[5:]}" in keywords:
            return f"{flag[5:].replace('-', '_')}=False{rest}"
        if flag not in keywords:
            return match[0]
        name = keywords[flag].name
        if f"{name} {value}" == "tool runtime":
            return "runtime_tool=True"
        part_of, (part, _, given) = help_of(keywords[flag]).record, value.partition("=")
        if part_of is not None and part != "link" and part in [each.name for each in fields(part_of)]:
            return f"{name}={part_of.__name__}({part}={given or '...'})"
        if keywords[flag].default is False:
            return f"{name}=True{rest}"
        if value and name in _WITH_VALUE:
            return f"{name}=[{value!r}]" if name != "base" else f"{name}={value!r}"
        return f"{name}=...{rest}"

    return _FLAG.sub(keyword, text)


@contextmanager
def speaking_python(record: Any) -> Iterator[None]:
    """Word refusals for a caller from Python (:func:`in_python`)."""
    try:
        yield
    except StiffgenError as error:
        error.reword(lambda text: in_python(text, record))
        raise


def with_keywords(
    name: str, options: Callable[_Options, _Record], run: Callable[[str | Path, _Record], _Result]
) -> Callable[Concatenate[str | Path, _Options], _Result]:
    """Return ``run`` under another name, with the fields of its record as keywords, known to type checkers.

    Refusals name these keywords where those of ``run`` name options of the command line.
    """

    def call(urdf: str | Path, *none: _Options.args, **keywords: _Options.kwargs) -> _Result:
        with speaking_python(options):
            return run(urdf, options(*none, **keywords))

    call.__name__ = call.__qualname__ = name
    call.__module__ = run.__module__
    if run.__doc__ is not None:  # python -OO
        call.__doc__ = run.__doc__.replace(_OPTIONS, "\n".join(meanings(options)))
    file, _ = inspect.signature(run).parameters.values()
    keywords = inspect.signature(options).parameters.values()
    call.__signature__ = inspect.Signature([file, *keywords])  # type: ignore[attr-defined]
    return call  # type: ignore[return-value]  # the file may be a keyword, too
