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

from stiffgen.core.errors import StiffgenError
from stiffgen.core.given import checked_keywords, checked_path

_Options = ParamSpec("_Options")
_Chosen = TypeVar("_Chosen")
_Result = TypeVar("_Result")
_OPTIONS = "        options: record of options."
"""Line of a docstring that becomes the meanings of the record's fields."""
_LISTS = ("accept_inertia", "ignore", "package_path", "pairs", "springs", "topics")
"""Options with a list of words, one of which a message puts behind the name."""
_WORDS = ("base", "calibration", "dask", "export", "kernels", "name", "q", "representation", "scalar", "tip", "wrench")
"""Options with one word, which a message may put behind the name."""
_FLAG = re.compile(r"""(--[a-z][a-z-]*)( ((?:'[^']*'|"[^"]*"|[^\s,;:()'"]|:(?=[^\s'"]))+))?(:?)""")
"""Option in a message, the word behind it as a shell takes it, and a colon."""
_COMMAND = re.compile(r"'stiffgen (analyze|generate)'")
"""Command in a message that is a function of the package, too."""
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


def in_python(text: str, *records: Any) -> str:
    """Return a message in the words of Python: keywords for options of the command line, functions for commands.

    The keywords are the fields of ``records``; the first record that has an option decides.
    """
    keywords = {flag_of(each): each for record in reversed(records) for each in fields(record)}

    def keyword(match: re.Match[str]) -> str:
        """Return an option of the message as a keyword; ``rest`` is a blank and the word behind the option."""
        flag, rest, word, colon = match[1], match[2] or "", match[3] or "", match[4]
        if flag.startswith("--no-") and f"--{flag[5:]}" in keywords:
            return f"{flag[5:].replace('-', '_')}=False{rest}{colon}"
        return match[0] if flag not in keywords else f"{_keyword(keywords[flag], rest, word, bool(colon))}{colon}"

    return _COMMAND.sub(r"stiffgen.\1()", _FLAG.sub(keyword, text))


def _keyword(option: Field[Any], rest: str, word: str, has_colon: bool) -> str:
    """Return an option as a keyword, with the word behind it in a message: its value, or part of the sentence.

    In order: a tool at run time has a keyword of its own; NAME=VALUE is a field of the option's record; a switch is
    True, and the word belongs to the sentence; a list holds the word. A single word is the value where it must be
    one: a base, a choice, in quotes, or before a colon. All others are "...": a placeholder in capitals (DIR) goes, a
    word of the sentence stays.
    """
    name, value, described = option.name, _QUOTED.sub(r"\1\2", word), help_of(option)
    if (name, value) == ("tool", "runtime"):
        return "runtime_tool=True"
    part, _, entry = value.partition("=")
    if part != "link" and described.record is not None and part in {each.name for each in fields(described.record)}:
        return f"{name}={described.record.__name__}({part}={entry or '...'})"
    if option.default is False:
        return f"{name}=True{rest}"
    if value and name in _LISTS:
        return f"{name}=[{value!r}]"
    if value and name in _WORDS and _is_value(option, value, word, has_colon):
        return f"{name}={value!r}"
    is_placeholder = value.isalpha() and value.isupper()
    return f"{name}=..." if is_placeholder else f"{name}=...{rest}"


def _is_value(option: Field[Any], value: str, word: str, has_colon: bool) -> bool:
    """Return whether a single word behind an option must be its value."""
    is_choice = value in (help_of(option).command or {}).get("choices", ())
    return option.name == "base" or is_choice or has_colon or word[0] in "\"'"


@contextmanager
def speaking_python(*records: Any) -> Iterator[None]:
    """Word refusals for a caller from Python (:func:`in_python`)."""
    try:
        yield
    except StiffgenError as error:
        error.reword(lambda text: in_python(text, *records))
        raise


def with_keywords(
    name: str, options: Callable[_Options, _Chosen], run: Callable[[str | Path, _Chosen], _Result]
) -> Callable[Concatenate[str | Path, _Options], _Result]:
    """Return ``run`` under another name, with the fields of its record as keywords, known to type checkers.

    Refusals name these keywords where those of ``run`` name options of the command line.
    """

    def call(urdf: str | Path, *none: _Options.args, **keywords: _Options.kwargs) -> _Result:
        with speaking_python(options):
            checked_keywords(options, keywords, name)
            return run(checked_path(urdf, name), options(*none, **keywords))

    call.__name__ = call.__qualname__ = name
    call.__module__ = run.__module__
    if run.__doc__ is not None:  # python -OO
        call.__doc__ = run.__doc__.replace(_OPTIONS, "\n".join(meanings(options)))
    file, _ = inspect.signature(run).parameters.values()
    keywords = inspect.signature(options).parameters.values()
    call.__signature__ = inspect.Signature([file, *keywords])  # type: ignore[attr-defined]
    return call  # type: ignore[return-value]  # the file may be a keyword, too
