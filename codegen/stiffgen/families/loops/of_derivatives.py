# SPDX-License-Identifier: MIT
"""Family record: reverse rule of the step that closes loops."""

from __future__ import annotations

import casadi as ca

from stiffgen.core.family import Family
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.kinematics import Expressions
from stiffgen.core.symbolic.steps import CloseLoops, StraightLine
from stiffgen.families.derivatives.gradients import Gradients
from stiffgen.families.loops.closure import motor_gradient
from stiffgen.families.masks import ones_or_nan


def _closed_loops(run: Gradients, step: CloseLoops) -> None:
    """Append the product with G = dq/da at the closed configuration (theorem of implicit functions)."""
    (closed,), (motors, _) = step.outputs, step.arguments
    bars = tuple(run.bars[closed.name])

    def expressions(chain: Chain, q: ca.SX, *values: ca.SX) -> Expressions:
        gradient = motor_gradient(chain, q, sum(values, ca.SX.zeros(closed.size)))
        positions = ca.vertcat(*(q[k] for k in chain.actuated))
        # NaN where the loops do not close, also for motors outside of them.
        return Expressions(gradient * ones_or_nan(positions), ())

    heading = "gradient with respect to the motors: G^T cotangent"
    run.steps.append(StraightLine((run.new(motors),), expressions, (closed, *bars), heading=heading))


FAMILY = Family(rules={CloseLoops: _closed_loops})
