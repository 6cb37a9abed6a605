# SPDX-License-Identifier: MIT
"""Compare the functions of two controllers but for the step: defaults, checks, start, reset, texts, joint gains."""

from __future__ import annotations

import ctypes
import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from stiffgen.control.fields import CONFIG
from stiffgen.control.sessions.library import ControllerLibrary, is_same, set_field
from stiffgen.control.sessions.policy_streams import compare_policy
from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray

Both = tuple[ControllerLibrary, ControllerLibrary]
"""The reference and the library that is compared with it."""


def compare_services(reference: ControllerLibrary, library: ControllerLibrary, chain: Chain) -> list[str]:
    """Return the names of functions whose results differ: all but step."""
    both, n = (reference, library), len(chain.motor_coordinates)
    return [
        *_compare_constants(both),
        *_compare_validate(both),
        *_compare_refused_calls(both),
        *_compare_init(both, n),  # behind the refused calls, whose outputs it compares
        *_compare_joint_gains(reference, library, n),
        *_compare_searches(reference, library, chain),
        *compare_policy(reference, library, len(chain.tips)),
    ]


def _set_defaults(both: Both) -> None:
    for each in both:
        each.call("default_config", each.config)


def _compare_constants(both: Both) -> list[str]:
    """Compare defaults and texts of errors; both self-checks must pass."""
    faults, (reference, library) = [], both
    _set_defaults(both)
    if bytes(reference.config) != bytes(library.config):
        faults.append("default_config differs")
    for error in range(-80, 3):  # every code, and some that are none
        if reference.error_text(error) != library.error_text(error):
            faults.append(f"error_text({error}) differs")
    if any(each.call("self_check") != 0 for each in both):
        faults.append("self_check finds a wrong build")
    return faults


def _compare_validate(both: Both) -> list[str]:
    """Compare the error of each field, all others at their defaults, at its bounds, just beyond, and far away."""
    faults = []
    for field in CONFIG:
        for value in (field.least, field.most, np.nextafter(field.least, -np.inf), np.nextafter(field.most, np.inf),
                      math.nan, 0.0, -1.0, 1e9):  # fmt: skip
            _set_defaults(both)
            for each in both:
                set_field(each.config, field, value, -1)
            errors = [each.call("validate", each.config) for each in both]
            if errors[0] != errors[1]:
                faults.append(f"validate differs at {field.name} {value:g}")
    return faults


def _compare_refused_calls(both: Both) -> list[str]:
    """Compare the errors of calls with a null pointer, or with a state that was never initialised: zeros."""
    calls: tuple[tuple[str, Callable[[ControllerLibrary], tuple[Any, ...]]], ...] = (
        ("validate", lambda each: (None,)),
        ("init", lambda each: (None, each.state, None)),
        ("init", lambda each: (each.config, None, None)),
        ("reset", lambda each: (None,)),
        ("reset", lambda each: (each.state,)),
        ("step", lambda each: (each.config, each.state, each.input, None)),
        ("step", lambda each: (each.config, each.state, None, each.output)),
        ("step", lambda each: (None, each.state, each.input, each.output)),
        ("step", lambda each: (each.config, None, each.input, each.output)),
        ("step", lambda each: (each.config, each.state, each.input, each.output)),
    )
    faults, (reference, library) = [], both
    _set_defaults(both)
    for each in both:
        ctypes.memset(each.state, 0, ctypes.sizeof(each.state))
    for function, arguments in calls:
        if reference.call(function, *arguments(reference)) != library.call(function, *arguments(library)):
            faults.append(f"{function} differs with a null pointer or without a start")
    return faults


def _compare_init(both: Both, n: int) -> list[str]:
    """Compare states after starts with a torque in force, good and bad, and outputs of the refused calls before."""
    faults = []
    for scale in (0.5, 2.0, math.nan):
        torque = (ctypes.c_double * n)(*(scale * both[0].config.effort_limit[i] for i in range(n)))
        errors = [each.call("init", each.config, each.state, torque) for each in both]
        if errors[0] != errors[1] or not is_same(*both):
            faults.append(f"init differs with a torque of {scale:g} of the limit")
    return faults


def _compare_searches(reference: ControllerLibrary, library: ControllerLibrary, chain: Chain) -> list[str]:
    """Return "find_posture differs" if it does.

    Case 0 has poses out of reach, case 1 a start that is not finite, case 2 no poses; the others may be in reach.
    """
    random, n, tips = np.random.default_rng(8), len(chain.motor_coordinates), len(chain.tips)
    _set_defaults((reference, library))
    for case in range(6):
        start = random.uniform(-1.0, 1.0, n)
        poses = np.tile(np.eye(4), (tips, 1, 1))
        for pose in poses:
            turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
            pose[:3, :3] = turn * np.linalg.det(turn)  # right-handed
            pose[:3, 3] = random.normal(size=3) * (5.0 if case == 0 else 0.3)
        tools = [np.tile(np.eye(4), (tips, 1, 1))] if chain.runtime_tool else []
        if case == 1:
            start[0] = math.nan
        given = [None if case == 2 else poses, *tools, start]
        # one number more than the function may write
        results = [each.find_posture(*given, np.zeros(n + 1)) for each in (reference, library)]
        if results[0] != results[1]:
            return ["find_posture differs"]
    return []


def _compare_joint_gains(reference: ControllerLibrary, library: ControllerLibrary, n: int) -> list[str]:
    """Return the names of joint_gains and late_work if their results differ, for good, bad and missing arguments."""
    random, faults = np.random.default_rng(6), set()
    # q, dq, q_des, dq_des, torque, joint_stiffness, damping, kp_limit, kd_limit
    sizes = (n, n, n, n, n, n * n, n * n, n, n)
    for _ in range(20):
        arguments: list[FloatArray | None] = [random.normal(size=size) for size in sizes]
        arguments[7:] = np.abs(random.normal(size=(2, n)))
        cases = [arguments]  # and copies in which one argument is missing or has one bad entry
        for place, value in itertools.product(range(len(sizes)), (None, math.nan, math.inf, -1.0)):
            changed = [None if each is None else each.copy() for each in arguments]
            array = changed[place]
            if value is None or array is None:
                changed[place] = None
            else:
                array[int(random.integers(len(array)))] = value
            cases.append(changed)
        for case in cases:
            if reference.joint_gains(*case) != library.joint_gains(*case):
                faults.add("joint_gains differs")
            hold = float(random.choice([1e-3, 0.1, 0.0, -1.0]))
            q, _, q_des, dq_des, torque, _, _, kp, kd = case
            # the torque as tau_ff, the limits as gains, kp once more as speed: any numbers will do
            work = [each.late_work(hold, q, q_des, dq_des, torque, kp, kd, kp) for each in (reference, library)]
            if not np.array_equal(work[0], work[1], equal_nan=True):
                faults.add("late_work differs")
    return sorted(faults)
