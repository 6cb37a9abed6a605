# SPDX-License-Identifier: MIT
"""Descriptions of options: fields of records, which Python, the command line and the docstrings read."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

_Options = ParamSpec("_Options")
_Record = TypeVar("_Record")
_Result = TypeVar("_Result")
_OPTIONS = "        options: record of options."
"""Line of a docstring that becomes the meanings of the record's fields."""


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


def with_keywords(
    name: str, options: Callable[_Options, _Record], run: Callable[[str | Path, _Record], _Result]
) -> Callable[Concatenate[str | Path, _Options], _Result]:
    """Return ``run`` under another name, with the fields of its record as keywords, known to type checkers."""

    def call(urdf: str | Path, *none: _Options.args, **keywords: _Options.kwargs) -> _Result:
        return run(urdf, options(*none, **keywords))

    call.__name__ = call.__qualname__ = name
    call.__module__ = run.__module__
    if run.__doc__ is not None:  # python -OO
        call.__doc__ = run.__doc__.replace(_OPTIONS, "\n".join(meanings(options)))
    file, _ = inspect.signature(run).parameters.values()
    keywords = inspect.signature(options).parameters.values()
    call.__signature__ = inspect.Signature([file, *keywords])  # type: ignore[attr-defined]
    return call  # type: ignore[return-value]  # the file may be a keyword, too
