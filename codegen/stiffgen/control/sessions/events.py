# SPDX-License-Identifier: MIT
"""Rare events of a hostile session: other commands and stiffnesses, a load, a reset, another configuration, a restart.

Each function takes the session. A seed names a session by its draws, so that their number and order must stay.
"""

from __future__ import annotations

import ctypes
import math
from typing import Any

import numpy as np

from stiffgen.control.sessions.library import fill, set_field
from stiffgen.core.robot.geometry import FloatArray

_JUMP_AT = 5
"""Step at which every session commands a jump, so that no session is at rest alone."""
_CALM_RATE = 0.15
"""Factor of the probability of troubles in a calm session."""


def _happens(session: Any, probability: float) -> bool:
    """Draw whether an event happens in this step."""
    return bool(session.random.random() < probability)


def random_torque(session: Any, share: float) -> FloatArray:
    """Return a normally distributed torque (n) [N m or N], of some share of the effort limit."""
    return np.asarray(session.random.normal(size=session.n) * np.array(session.config.effort_limit) * share)


def choose_commands(session: Any, number: int) -> None:
    """Change goal, stiffness, wrench, torque offset or plan, each with a probability of 1 or 2 % per sample."""
    random = session.random
    if number == _JUMP_AT or _happens(session, 0.01):
        way = random.normal(size=session.n)
        session.goal = session.q + way * 10.0 ** random.uniform(-3, -0.5 if session.calm else 0)  # 1 mrad to 1 rad
    if _happens(session, 0.02):
        session.goal = session.goal + random.normal(size=session.n) * 1e-3
    if _happens(session, 0.01):
        choose_stiffness(session)
    if _happens(session, 0.02):
        largest = np.repeat(session.config.heaviest_wrench, 3) * random.choice([0.0, 0.1, 0.7])  # (6) of one tip
        session.pressed = (random.uniform(-1.0, 1.0, (len(session.pressed) // 6, 6)) * largest).ravel()
    if _happens(session, 0.01):
        session.offset = random_torque(session, random.choice([0.0, 0.01, 0.2, 0.9]))
    if _happens(session, 0.02):
        _choose_plan(session)


def choose_stiffness(session: Any) -> None:
    """Choose translational and rotational stiffness of the springs, (2, springs, 3, 3), and of the posture.

    One in ten is not positive.
    """
    random = session.random
    roots = random.normal(size=(2, len(session.input.rotation_stiffness) // 9, 3, 3))
    scale = np.array([500.0, 20.0]) * 10.0 ** random.uniform(-1.5, 0.5)  # [N/m], [N m/rad]
    session.stiffness = (roots @ np.swapaxes(roots, 2, 3) / 3) * scale[:, None, None, None]
    shares = random.uniform(0.0, 1.0, session.n)  # of the joints
    session.posture = shares * 10.0 ** random.uniform(-1.0, 2.0) * random.integers(0, 2)  # [N m/rad]; half have none
    if _happens(session, 0.1):
        session.stiffness[:, :, 0, 0] *= -1.0


def _choose_plan(session: Any) -> None:
    """Choose the rate of the goal, and the acceleration that the plan states: some, or none."""
    random, limit = session.random, np.nan_to_num(np.array(session.config.velocity_limit))
    session.rate = random.uniform(-0.3, 0.3, session.n) * limit * random.integers(0, 2)
    session.shaped = int(random.integers(0, 2))
    share = random.choice([0.0, 0.01, 0.3, 1.0], p=[0.4, 0.3, 0.2, 0.1])
    session.stated = share * random.uniform(-3.0, 3.0, session.n) * limit / max(session.config.ramp_time, 1e-4)


def choose_troubles(session: Any) -> None:
    """Let a load, a reset, another configuration, an obstacle or a clock's restart happen, each rarely."""
    random, rate = session.random, _CALM_RATE if session.calm else 1.0
    if _happens(session, 0.03 * rate):
        session.load = random_torque(session, 0.02 if session.calm else random.choice([0, 0.3]))
    if _happens(session, 0.08 if session.output.fault else 0.01):
        for each in session.both:
            each.call("reset", each.state)
    if _happens(session, 0.003 if session.calm else 0.006):
        _change_config(session)
    if _happens(session, 0.004 * rate):
        session.switch_clock()
    if _happens(session, 0.004):  # an obstacle holds the arm, perhaps far from the goal
        session.held = int(random.integers(5, 80))
        session.goal = session.goal + random.normal(size=session.n) * random.choice([0.0, 1.0])
    if _happens(session, 0.003 * rate):  # the robot's clock starts again
        session.ticks -= int(random.integers(2, 2000))
    if _happens(session, 0.05 if session.output.fault else 0.001 * rate):
        session.dq = 0.1 * session.dq
        session.start()


def _change_config(session: Any) -> None:
    """Begin anew with the torque in force and one field changed, now and then to a value that is refused.

    Of the refused ones one in five stays: the state is then none, until another start.
    """
    before = bytes(session.config)
    _change_field(session)
    torque = (ctypes.c_double * session.n)(*session.output.torque)
    is_refused = session.initialise(torque) != 0
    if is_refused and _happens(session, 0.8):
        ctypes.memmove(ctypes.byref(session.config), before, len(before))
        session.initialise(torque)


def _change_field(session: Any) -> None:
    """Change one field of the configuration: limits around q, a tool's pose, a value that is refused, or another."""
    random, fields = session.random, session.both[0].fields
    field = fields[int(random.integers(len(fields)))]
    if field.name in ("lower_limit", "upper_limit"):
        outwards = -1.0 if field.name == "lower_limit" else 1.0
        fill(getattr(session.config, field.name), session.q + outwards * random.uniform(-0.2, 0.6, session.n))
    elif field.name == "tool_pose":
        session.config.tool_pose[3] += 0.01 if _happens(session, 0.8) else math.nan  # [m] along x of the first tip
    elif _happens(session, 0.2):
        refused = math.nan if field.type == "double" else -1
        set_field(session.config, field, refused, int(random.integers(session.n)))
    else:
        session.vary(field)
