# SPDX-License-Identifier: MIT
"""Calls of functions on loaded arms that are refused, each with its sentence."""

from __future__ import annotations

import re
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

import stiffgen

CALLS = """
settle(robot, q, np.ones(6), F)                                | settle: joint_stiffness must have the shape
settle(robot, q, np.eye(7) + np.eye(7, k=1), F)                | settle: joint_stiffness is not symmetric
settle(SimpleNamespace(close=None), q, np.ones(7), F)          | settle: the robot has closed loops
settle(robot, q[:6], np.ones(7), F)                            | settle: takes a robot with a fixed base
settle(robot, q, np.ones(7), F[:3])                            | settle: takes a wrench
settle(robot, q, np.ones(7), F, gravity=9.81)                  | settle: takes an acceleration of gravity
buckling_load(robot, q, np.ones(7), F)                         | buckling_load: takes directions
buckling_load(robot, q, np.ones(7), np.zeros(3))               | buckling_load: takes directions
external_wrench(robot, np.ones(7), np.ones(6), 1.0)            | external_torque must end with 7
external_wrench(robot, np.ones(7), np.ones(7), np.ones(3))     | deviation must be one number or end with 7
external_wrench(robot, np.ones(7), np.ones(7), 0.0)            | every standard deviation must be positive
external_wrench(robot, np.ones(7), np.ones(7), np.nan)         | every standard deviation must be positive
move_stiffness(pose, F, C, "world", "body")                    | no representation 'world'
move_stiffness(pose, F[:3], C, "hybrid", "body")               | wrench must have the shape
find_postures(robot, pose.T, near=q + 0.4)                     | the pose is none
find_postures(robot, pose * [-1, 1, 1, 1], near=q + 0.4)       | the pose is none
find_postures(robot, pose * [1.01, 1.01, 1.01, 1], near=q)     | the pose is none
find_postures(robot, 1000 * pose, near=q + 0.4)                | the pose is none
find_postures(robot, np.eye(3), near=q)                        | find_postures
find_postures(robot, far * np.nan, near=q)                     | find_postures
find_postures(robot, far, near=q[:6])                          | find_postures
find_postures(robot, far, near=[np.nan] * 7)                   | find_postures
in_series(np.eye(3), [1.0, 2.0])                               | as Kq is
in_series(np.ones(3), np.ones(3))                              | Kq must have the shape
in_series(np.eye(2), [1.0, -1.0])                              | must be positive
in_series(np.eye(2), [1.0, np.nan])                            | must be positive
in_series(np.eye(2), np.diag([1.0, -1.0]))                     | negative eigenvalue -1
in_series([[1, 2], [0, 1]], np.ones(2))                        | Kq is not symmetric
in_series(np.eye(2), [[1, 2], [0, 1]])                         | Kc is not symmetric
tip_compliance_in_series(C, H, [(C, np.eye(3))])               | frame 0 must have the shape
tip_compliance_in_series(C, H, [(np.eye(3), H)])               | compliance of part 0 must have the shape
tip_compliance_in_series(C + np.eye(6, k=1), H, [])            | compliance is not symmetric
tip_compliance_in_series(C, H, [], "world")                    | no representation 'world'
"""
"""Call and sentence; q is seven zeros, F a wrench of zeros, C and H identities, far a pose out of reach."""


@pytest.mark.parametrize("line", CALLS.strip().split("\n"))
def test_a_refused_call_has_its_sentence(line: str, robot: ModuleType) -> None:
    """Call with wrong arguments: each refusal has the sentence listed."""
    code, words = (part.strip() for part in line.split(" | "))
    far = np.eye(4)
    far[0, 3] = 3.0
    names = {"robot": robot, "q": np.zeros(7), "F": np.zeros(6), "C": np.eye(6), "H": np.eye(4), "far": far, "np": np}
    names |= {
        "pose": robot.forward_kinematics(np.full(7, 0.4)),
        "SimpleNamespace": SimpleNamespace,
        "stiffgen": stiffgen,
    }
    error = ValueError if code.startswith(("external_wrench", "move_stiffness")) else stiffgen.StiffgenError
    with pytest.raises(error, match=re.escape(words)):
        eval(f"stiffgen.{code}", names)
