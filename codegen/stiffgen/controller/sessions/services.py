# SPDX-License-Identifier: MIT
"""Compare the functions of two controllers but for the step: defaults, checks, start, reset, texts, joint gains."""

from __future__ import annotations

import ctypes
import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from stiffgen.controller.fields import CONFIG
from stiffgen.controller.sessions.library import ControllerLibrary, is_same, set_field
from stiffgen.controller.sessions.policy_streams import compare_policy
from stiffgen.robot.chain import Chain
from stiffgen.robot.geometry import FloatArray


def compare_services(reference: ControllerLibrary, library: ControllerLibrary, chain: Chain) -> list[str]:
    """Return the names of functions whose results differ: all but step."""
    both, faults, n = (reference, library), [], len(chain.motor_coordinates)
    for each in both:
        each.call("default_config", each.config)
    if bytes(reference.config) != bytes(library.config):
        faults.append("default_config differs")
    for error in range(-80, 3):
        if reference.error_text(error) != library.error_text(error):
            faults.append(f"error_text({error}) differs")
    if any(each.call("self_check") != 0 for each in both):
        faults.append("self_check finds a wrong build")
    for field in CONFIG:
        for value in (field.least, field.most, np.nextafter(field.least, -np.inf), np.nextafter(field.most, np.inf),
                      math.nan, 0.0, -1.0, 1e9):  # fmt: skip
            results = []
            for each in both:
                each.call("default_config", each.config)
                set_field(each.config, field, value, -1)
                results.append(each.call("validate", each.config))
            if results[0] != results[1]:
                faults.append(f"validate differs at {field.name} {value:g}")
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
    for each in both:
        each.call("default_config", each.config)
        ctypes.memset(each.state, 0, ctypes.sizeof(each.state))
    for function, arguments in calls:
        if reference.call(function, *arguments(reference)) != library.call(function, *arguments(library)):
            faults.append(f"{function} differs with a null pointer or without a start")
    for scale in (0.5, 2.0, math.nan):
        torque = (ctypes.c_double * n)(*(scale * reference.config.effort_limit[i] for i in range(n)))
        results = [each.call("init", each.config, each.state, torque) for each in both]
        if results[0] != results[1] or not is_same(reference, library):
            faults.append(f"init differs with a torque of {scale:g} of the limit")
    faults += _compare_joint_gains(reference, library, n)
    faults += _compare_searches(reference, library, chain)
    return faults + compare_policy(reference, library, len(chain.tips))


def _compare_searches(reference: ControllerLibrary, library: ControllerLibrary, chain: Chain) -> list[str]:
    """Return "find_posture differs" if it does, for poses in and out of reach, and arguments that are refused."""
    random, n, tips = np.random.default_rng(8), len(chain.motor_coordinates), len(chain.tips)
    for each in (reference, library):
        each.call("default_config", each.config)
    for case in range(6):
        start = random.uniform(-1.0, 1.0, n)
        poses = np.tile(np.eye(4), (tips, 1, 1))
        for pose in poses:
            turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
            pose[:3, :3] = turn * np.linalg.det(turn)
            pose[:3, 3] = random.normal(size=3) * (5.0 if case == 0 else 0.3)
        tools = [np.tile(np.eye(4), (tips, 1, 1))] if chain.runtime_tool else []
        if case == 1:
            start[0] = math.nan
        given = [None if case == 2 else poses, *tools, start]
        results = [each.find_posture(*given, np.zeros(n + 1)) for each in (reference, library)]
        if results[0] != results[1]:
            return ["find_posture differs"]
    return []


def _compare_joint_gains(reference: ControllerLibrary, library: ControllerLibrary, n: int) -> list[str]:
    """Return the names of joint_gains and late_work if their results differ, for good, bad and missing arguments."""
    random, faults = np.random.default_rng(6), set()
    sizes = (n, n, n, n, n, n * n, n * n, n, n)
    for _ in range(20):
        arguments: list[FloatArray | None] = [random.normal(size=size) for size in sizes]
        arguments[7:] = np.abs(random.normal(size=(2, n)))
        cases = [arguments]
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
            work = [each.late_work(hold, q, q_des, dq_des, torque, kp, kd, kp) for each in (reference, library)]
            if not np.array_equal(work[0], work[1], equal_nan=True):
                faults.add("late_work differs")
    return sorted(faults)
