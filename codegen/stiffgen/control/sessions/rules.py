# SPDX-License-Identifier: MIT
"""Compare defaults and rules of a controller's configuration with the table of its fields and with the chain."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from stiffgen.control.core.config import CONFIG
from stiffgen.control.core.field import Field
from stiffgen.control.page import config_of
from stiffgen.control.presets import motor_tables
from stiffgen.control.sessions.library import ControllerLibrary, set_field, value_without_default
from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.verify.result import Check, faultless

_FIRST_FIELD_ERROR = -20
"""Error code of the first field; each following field has one less (docs/controller.md)."""


def check_rules(library: ControllerLibrary, module: Any, chain: Chain) -> list[Check]:
    """Compare the defaults, in C and in Python, and the bounds of every field with the table.

    Args:
        library: the folder's controller, called from C's side.
        module: the folder's Python module.
        chain: the robot, whose limits some defaults are.

    """
    library.call("default_config", library.config)
    names = [field.name for field in library.fields]
    expected = {field.name: default_of(field, chain) for field in config_of(chain) if field.name in names}
    faults = [f"{name} in C" for name, value in expected.items() if not _is(getattr(library.config, name), value)]
    faults += [f"{name} in Python" for name in _wrong_in_python(library, module, expected)]
    return [
        faultless("controller: defaults", "table of fields", faults),
        faultless("controller: rules", "table of fields", _rule_faults(library, chain)),
    ]


def _wrong_in_python(library: ControllerLibrary, module: Any, expected: Mapping[str, FloatArray]) -> list[str]:
    """Return the fields of a new controller in Python that have neither their defaults nor what it was given."""
    # Numbers that a user must state, since there is no default, or since the robot's file lacks them.
    stated = {f.name: value_without_default(f) for f in library.fields if not _is_allowed(f, expected[f.name])}
    config = module.Impedance(**stated).config
    wrong = []
    for field in library.fields:
        shown = getattr(config, field.name)
        number = field.choices.index(shown) + 1 if isinstance(shown, str) else shown  # choices count from 1
        if not _is(number, stated.get(field.name, expected[field.name])):
            wrong.append(field.name)
    return wrong


def _is_allowed(field: Field, value: FloatArray) -> bool:
    """Return whether a field takes a value; it takes no NaN."""
    return bool(np.all((value >= field.least) & (value <= field.most)))


def _is(value: Any, expected: FloatArray | float) -> bool:
    """Return whether all entries of a field are the expected ones; one that must be stated is NaN, or an int -1."""
    entries = np.array(value, dtype=float).ravel()
    return np.array_equal(np.broadcast_to(np.ravel(expected), entries.shape), entries, equal_nan=True)


def default_of(field: Field, chain: Chain) -> FloatArray:
    """Return the default of a field from the table, as the configuration in C should have it.

    A field that must be stated has NaN, or -1. The table has the word of a choice, "identity", numbers with ", "
    between them, or a product of a number and a limit with one entry per motor.
    """
    if not field.default:
        return np.array(math.nan if field.type == "double" else -1.0)
    if field.default == "identity":
        return np.tile(np.eye(4), (len(chain.tips), 1, 1)).ravel()
    if field.choices:
        return np.array(field.choices.index(field.default) + 1.0)  # choices count from 1
    if ", " in field.default:
        return np.array([float(entry.replace("HUGE_VAL", "inf")) for entry in field.default.split(", ")])
    value = np.ones(1)
    for factor in field.default.split(" * "):
        value = value * _factor(factor, chain)
    return value


def _factor(text: str, chain: Chain) -> FloatArray | float:
    """Return a factor of a default: a number, or one entry per motor.

    "{name}_velocity[{i}]" is a limit of the joint, "{name}_torque_rate[i]" an entry of the motors' tables.
    """
    if not text.startswith("{name}_"):
        return float(text)
    limit = text.removeprefix("{name}_").removesuffix("[i]").removesuffix("[{i}]")
    motors = motor_tables(chain)
    if hasattr(motors, limit):
        return np.array(getattr(motors, limit))
    return np.array([getattr(coordinate, limit) for coordinate in chain.motor_coordinates])


def _tried_entries(field: Field, dof: int) -> Sequence[int]:
    """Return the entries of a field that are tried: one per joint, the last of a fixed shape, or -1 for a number."""
    if field.shape == ("n",):
        return range(dof)
    return [math.prod(extent for extent in field.shape if isinstance(extent, int)) - 1] if field.shape else [-1]


def _rule_faults(library: ControllerLibrary, chain: Chain) -> list[str]:
    """Try every field at its bounds and just beyond; the error code must name the field beyond, and there alone.

    At its bounds a field may be refused by a rule about several fields, whose code is another one.
    """
    faults = []
    for field in library.fields:
        code = _FIRST_FIELD_ERROR - [each.name for each in CONFIG].index(field.name)
        inside, beyond = _tried_values(field)
        tried = [*((value, False) for value in inside), *((value, True) for value in beyond)]
        for place in _tried_entries(field, len(chain.motor_coordinates)):
            for value, is_beyond in tried:
                library.take_defaults()
                library.config.tank_initial = 1.0  # sizing takes long
                set_field(library.config, field, value, place)
                is_named = library.call("init", library.config, library.state, None) == code
                if is_named != is_beyond:
                    faults.append(f"{field.name} {value!r}")
    return faults


def _tried_values(field: Field) -> tuple[list[float], list[float]]:
    """Return the finite bounds of a field, and the values next to them that it refuses; an infinite bound has none."""
    least, most = field.least, field.most
    inside = [each for each in (least, most) if math.isfinite(each)]
    if field.type == "int":
        return [int(each) for each in inside], [int(least) - 1, int(most) + 1]
    beyond = []
    if math.isfinite(least):
        beyond.append(float(np.nextafter(least, -np.inf)))
    if math.isfinite(most):
        beyond.append(float(np.nextafter(most, np.inf)))
    return inside, [*beyond, math.nan]
