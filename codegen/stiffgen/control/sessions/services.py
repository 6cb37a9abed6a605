# SPDX-License-Identifier: MIT
"""Compare the functions of two controllers but for the step: defaults, start, reset, texts."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from stiffgen.control.sessions.library import ControllerLibrary, is_same, set_field

Both = tuple[ControllerLibrary, ControllerLibrary]
"""The reference and the library that is compared with it."""


def compare_services(reference: ControllerLibrary, library: ControllerLibrary) -> list[str]:
    """Return the names of functions whose results differ: all but step."""
    both = (reference, library)
    return [
        *_compare_constants(both),
        *_compare_rules(both),
        *_compare_refused_calls(both),
        *_compare_init(both),  # behind the refused calls, whose outputs it compares
    ]


def _set_defaults(both: Both) -> None:
    for each in both:
        each.take_defaults()


def _compare_constants(both: Both) -> list[str]:
    """Compare defaults and texts of errors; both self-checks must pass."""
    faults, (reference, library) = [], both
    for each in both:
        each.call("default_config", each.config)
    if bytes(reference.config) != bytes(library.config):
        faults.append("default_config differs")
    for error in range(-80, 3):  # every code, and some that are none
        if reference.error_text(error) != library.error_text(error):
            faults.append(f"error_text({error}) differs")
    if any(each.call("self_check") != 0 for each in both):
        faults.append("self_check finds a wrong build")
    return faults


def _compare_rules(both: Both) -> list[str]:
    """Compare the error of each field, all others at their defaults, at its bounds, just beyond, and far away."""
    faults = []
    for field in both[0].fields:
        for value in (field.least, field.most, np.nextafter(field.least, -np.inf), np.nextafter(field.most, np.inf),
                      math.nan, 0.0, -1.0, 1e9):  # fmt: skip
            _set_defaults(both)
            for each in both:
                set_field(each.config, field, value, -1)
            errors = [each.call("init", each.config, each.state, None) for each in both]
            if errors[0] != errors[1]:
                faults.append(f"init differs at {field.name} {value:g}")
    return faults


def _compare_refused_calls(both: Both) -> list[str]:
    """Compare the errors of calls with a null pointer, or with a state that was never initialised: zeros."""
    calls: tuple[tuple[str, Callable[[ControllerLibrary], tuple[Any, ...]]], ...] = (
        ("init", lambda each: (None, each.state, None)),
        ("init", lambda each: (each.config, None, None)),
        ("reset", lambda each: (None,)),
        ("reset", lambda each: (each.state,)),
        ("step", lambda each: (each.state, each.input, None)),
        ("step", lambda each: (each.state, None, each.output)),
        ("step", lambda each: (None, each.input, each.output)),
        ("step", lambda each: (each.state, each.input, each.output)),
    )
    faults, (reference, library) = [], both
    _set_defaults(both)
    for each in both:
        ctypes.memset(each.state, 0, ctypes.sizeof(each.state))
    for function, arguments in calls:
        if reference.call(function, *arguments(reference)) != library.call(function, *arguments(library)):
            faults.append(f"{function} differs with a null pointer or without a start")
    return faults


def _compare_init(both: Both) -> list[str]:
    """Compare states after starts with a torque in force, good and bad, and outputs of the refused calls before."""
    faults, n = [], len(both[0].output.torque)
    _set_defaults(both)
    for scale in (0.5, 2.0, math.nan):
        torque = (ctypes.c_double * n)(*(scale * both[0].config.effort_limit[i] for i in range(n)))
        errors = [each.call("init", each.config, each.state, torque) for each in both]
        if errors[0] != errors[1] or not is_same(*both):
            faults.append(f"init differs with a torque of {scale:g} of the limit")
    return faults
