# SPDX-License-Identifier: MIT
"""Options of the command line from records of options, and the records' values from the command line."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, Field, fields
from typing import Any

from stiffgen.core.described import Help, flag_of, help_of
from stiffgen.core.errors import StiffgenError, printable
from stiffgen.core.potentials import read_potential
from stiffgen.core.robot.chain import Sensor, Tool

GROUPS = {
    "robot": "how the file is read, and what of it moves",
    "frames": "",
    "springs": "springs in addition to the default one, their axes and centre",
    "tool": "tool and sensor at the tip, fixed at generation; of --tool runtime the functions take the pose",
    "output": "",
}
"""Headings of --help in their order, with a sentence."""
_RUNTIME = "runtime"
"""Word of --tool in place of NAME=VALUE: the functions take the tool's pose."""


def group_of(command: argparse.ArgumentParser, title: str, text: str = "") -> argparse._ActionsContainer:
    """Return the group of options with a title, made on first use; the command itself without a title."""
    made: dict[str, Any] = {str(group.title): group for group in command._action_groups}
    if not title:
        return command
    return made.get(title) or command.add_argument_group(title, text or GROUPS.get(title) or None)


def add_options(command: argparse.ArgumentParser, record: type[Any], *names: str) -> None:
    """Add the options of fields of a record in their groups; without names, those of all fields."""
    chosen = [
        each for each in fields(record) if (not names or each.name in names) and help_of(each).command is not None
    ]
    for option in sorted(chosen, key=lambda each: list(GROUPS).index(help_of(each).group)):
        add_option(group_of(command, help_of(option).group), option)


def add_option(command: argparse._ActionsContainer, option: Field[Any], **more: Any) -> None:
    """Add the option of a field of a record (:func:`stiffgen.core.described.help_of`); ``more`` goes to argparse."""
    described, flag = help_of(option), flag_of(option)
    if option.default is True:
        command.add_argument(f"--no-{flag[2:]}", dest=option.name, action="store_false", help=described.negative)
    elif option.default is False:
        command.add_argument(flag, action="store_true", help=described.meaning)
    else:
        keywords = _collected(option.name, described) if _collects(described) else _single(option)
        keywords |= dict(described.command or {}) | more
        command.add_argument(flag, dest=option.name, help=_meaning(described), **keywords)


def _meaning(described: Help) -> str:
    if described.record is None:
        return described.meaning
    return f"{described.meaning}; NAME: {', '.join(each.name for each in fields(described.record))}"


def _collects(described: Help) -> bool:
    return described.record is not None or (described.command or {}).get("action") == "append"


def _single(option: Field[Any]) -> dict[str, Any]:
    return {} if option.default is MISSING else {"default": option.default or None}


def _collected(name: str, described: Help) -> dict[str, Any]:
    """Return the settings of an option that collects words, or properties of a record."""
    keywords: dict[str, Any] = {"action": "append", "default": []}
    if described.record is not None:
        keywords |= {"type": _part_of(described.record), "metavar": "NAME=VALUE"}
    return keywords | ({"type": _lock} if name == "lock" else {})


def values_of(options: argparse.Namespace, record: type[Any]) -> dict[str, Any]:
    """Return the values of the fields of a record that the command line has; defaults of records are left out."""
    values: dict[str, Any] = {}
    for option in (each for each in fields(record) if each.name in options):
        value, described = getattr(options, option.name), help_of(option)  # value: a word, or a list of them
        if described.record is Tool:
            values |= _tool(value, options)
        elif described.record is Sensor:
            values[option.name] = _sensor(value)
        elif described.record is not None:
            values |= {option.name: described.record(**_once(flag_of(option), value))} if value else {}
        elif option.name in _READERS:
            values[option.name] = _READERS[option.name](value)
        else:
            values[option.name] = tuple(value) if isinstance(value, list) else value
    return values


def _once(flag: str, parts: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Return pairs as a dictionary; refuse a name that occurs twice."""
    found: dict[str, Any] = {}
    for name, value in parts:
        if name in found:
            raise StiffgenError(f"{flag} names '{printable(name)}' twice; leave one of them out")
        found[name] = value
    return found


def _tool(parts: list[tuple[str, Any]], options: argparse.Namespace) -> dict[str, Any]:
    """Return the tool that the options describe, and whether the functions take its pose."""
    chosen = _once("--tool", parts)
    runtime = chosen.pop(_RUNTIME, False)
    if not options.masses and chosen.keys() - {"xyz", "rpy"}:
        raise StiffgenError("--no-masses ignores all masses; leave out --no-masses, or mass, com and inertia of --tool")
    if runtime and chosen.keys() & {"xyz", "rpy"}:
        raise StiffgenError("--tool runtime takes the tool's pose at run time; leave out --tool xyz and --tool rpy")
    return {"tool": Tool(**chosen) if chosen else None} | ({"runtime_tool": True} if runtime else {})


def _sensor(parts: list[tuple[str, Any]]) -> Sensor | None:
    """Return the sensor that the options describe; None without one."""
    chosen = _once("--sensor", parts)
    if chosen and "link" not in chosen:
        raise StiffgenError(f"--sensor {next(iter(chosen))}=... without its link; add --sensor LINK")
    return Sensor(**chosen) if chosen else None


def _part_of(record: type[Any]) -> Callable[[str], tuple[str, Any]]:
    """Return the reader of NAME=VALUE, a field of a record; VALUE is a word, a number, or numbers with commas."""
    defaults: Mapping[str, Any] = {each.name: each.default for each in fields(record)}

    def part(text: str) -> tuple[str, Any]:
        """Return name and value; the default of the field tells their kind."""
        name, separator, value = text.partition("=")
        if record is Tool and text == _RUNTIME:
            return text, True
        if record is Sensor and not separator:  # --sensor LINK
            return "link", text
        if name not in defaults or not separator:
            raise argparse.ArgumentTypeError(f"'{text}' is not NAME=VALUE with a NAME among {', '.join(defaults)}")
        default = defaults[name]
        if default in (None, MISSING) or isinstance(default, str):
            return name, value
        if isinstance(default, tuple):
            return name, _numbers(text, name, value, len(default))
        return name, _numbers(text, name, value, 1)[0]

    return part


def _numbers(text: str, name: str, value: str, count: int) -> tuple[float, ...]:
    """Return the numbers of a value; argparse.ArgumentTypeError for another number of them."""
    try:
        numbers = tuple(map(float, value.split(",")))
    except ValueError:
        numbers = ()
    if len(numbers) != count:
        wanted = "a number" if count == 1 else f"{count} numbers with commas"
        raise argparse.ArgumentTypeError(f"'{text}': {name} is {wanted}{_remedy(value) if count == 1 else ''}")
    return numbers


def _lock(text: str) -> tuple[str, float]:
    """Parse JOINT=VALUE into the joint's name and its position [rad or m]."""
    joint, separator, value = text.rpartition("=")
    if not separator or not joint:
        raise argparse.ArgumentTypeError(f"'{text}' is not JOINT=VALUE")
    try:
        return joint, float(value)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}': VALUE is a number [rad or m]{_remedy(value)}") from None


def _remedy(value: str) -> str:
    """Return the remedy for a number with a decimal comma."""
    return f"; write {value.replace(',', '.')}" if re.fullmatch(r"[+-]?\d*,\d+", value) else ""


def _tip(links: Any) -> Any:
    """Return one link, or the links of several tips; None without one."""
    if isinstance(links, str):
        return links
    return links[0] if len(links or ()) == 1 else links or None


_READERS: Mapping[str, Callable[[Any], Any]] = {
    "tip": _tip,
    "lock": lambda pairs: _once("--lock", pairs),
    "potentials": lambda texts: tuple(map(read_potential, texts)),
    "actuated": lambda text: text or (),
}
"""What becomes of the words of an option, by the field's name."""
