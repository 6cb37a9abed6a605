# SPDX-License-Identifier: MIT
"""Self-motion to stiff postures: the published gradient, Pinocchio and scipy along the self-motion, and the picture."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType

import numpy as np
import pinocchio
import pytest
from scipy.optimize import root

from examples import stiff_postures
from examples.stiff_postures import Arm
from support.pictures import difference
from support.project import ROOT, URDF


@pytest.fixture(scope="module")
def cases(robot: ModuleType, panda: ModuleType) -> tuple[Arm, ...]:
    return stiff_postures.arms(robot, panda)


@pytest.mark.slow
def test_equal_springs_without_a_load_are_the_published_case(cases: tuple[Arm, ...]) -> None:
    """|J^T f|^2 and its gradient are k times the compliance and its gradient; the postures are the same."""
    for arm in cases:
        equal = replace(arm, springs=np.full(7, 200.0), load=0.0)
        assert 200 * equal.compliance(arm.start) == pytest.approx(arm.torque_squared(arm.start), rel=1e-13)
        theirs = arm.torque_slopes(arm.start)
        assert np.abs(200 * equal.slopes(arm.start) - theirs).max() <= 1e-13 * np.abs(theirs).max()
        assert np.abs(equal.stiffest(equal.slopes) - arm.stiffest(arm.torque_slopes)).max() <= 1e-6


@pytest.mark.slow
def test_the_descent_ends_in_the_valley_of_the_self_motion(cases: tuple[Arm, ...]) -> None:
    """Descend along the self-motion: the tip stays, and no posture on the way or 0.2 rad beyond is stiffer."""
    for arm in cases:
        found = arm.stiffest(arm.slopes)
        off = arm.robot.forward_kinematics(found) - arm.robot.forward_kinematics(arm.start)
        assert np.abs(off).max() < 1e-12
        assert arm.is_within_limits(found)
        distance, postures = arm.self_motion()
        near = np.abs(postures - found).max(axis=1).argmin()
        start = np.abs(distance).argmin()
        first, last = sorted((start, near))
        values = arm.compliance(postures[max(first - 10, 0) : last + 11])
        assert values.min() >= arm.compliance(found)
        assert values.min() <= arm.compliance(found) * (1 + 1e-3)


@pytest.mark.slow
def test_the_iiwa_gives_way_by_as_much_as_solved_equilibria_say(cases: tuple[Arm, ...]) -> None:
    """Pinocchio reads the URDF: 1 N more in each posture moves the tip by the compliance of the table."""
    model = pinocchio.buildModelFromUrdf(str(URDF))
    data, tip, arm = model.createData(), model.getFrameId("link_ee"), cases[1]

    def solved(q: np.ndarray, load: float) -> float:
        """Return the tip's position along the load [m] under `load` [N], by Pinocchio and a root search."""

        def jacobian(at: np.ndarray) -> np.ndarray:
            frame = pinocchio.LOCAL_WORLD_ALIGNED
            return np.array(pinocchio.computeFrameJacobian(model, data, at, tip, frame)[:3])

        rest = q - jacobian(q).T @ arm.direction * arm.load / arm.springs

        def torque(at: np.ndarray) -> np.ndarray:
            return np.asarray(arm.springs * (at - rest) - jacobian(at).T @ arm.direction * load)

        pinocchio.framesForwardKinematics(model, data, root(torque, q, tol=1e-14).x)
        return float(data.oMf[tip].translation @ arm.direction)

    for q in (arm.start, arm.stiffest(arm.torque_slopes), arm.stiffest(arm.slopes)):
        moved = (solved(q, arm.load + 0.01) - solved(q, arm.load - 0.01)) / 0.02
        assert arm.compliance(q) == pytest.approx(moved, rel=1e-6)


@pytest.mark.slow
def test_the_picture_is_todays(cases: tuple[Arm, ...]) -> None:
    drawn = stiff_postures.figure((cases[1], cases[2]))
    assert difference(drawn, (ROOT / "docs" / "stiff_postures.svg").read_text(), 1.0) == ""
