# SPDX-License-Identifier: MIT
"""Family record: compliance of a tip in motor coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from stiffgen.core.family import Asked, Family
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic import arguments
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.core.symbolic.program import Array
from stiffgen.families.compliance.kernels import LOAD_STIFFNESS, CompliantTip, Loaded, increment, load_of_tip
from stiffgen.families.loops import programs as motor_programs
from stiffgen.families.loops.kernels import CLOSED, GROUP


def _of_motors(chain: Chain, wrench: Argument, *, reads_J: bool) -> Loaded:
    """Return the load of a wrench on a tip in motor coordinates: load and Jacobian of the tree, reduced."""
    # The reduction takes the columns of the joints, not their sums over coordinates.
    of_tree, load, _ = load_of_tip(chain, "hybrid", wrench, reads_J=False)
    gradient = Array("gradient_of_tree", (chain.dof,))
    tree = (*of_tree, *motor_programs.wrench_gradient(chain, wrench.array(chain), gradient))
    of_motors = replace(LOAD_STIFFNESS, name="load_of_motors", shape=("a", "a"))
    J = Argument("J_of_motors", (6, "a"), "", "", symbol="J")
    if reads_J:
        columns = Array("J", (6, len(chain.joints)))
        steps = motor_programs.reduction(chain, tree, gradient, load, (of_motors, J), "KJ", columns=columns)
    else:
        steps = motor_programs.reduction(chain, tree, gradient, load, (of_motors,), "K")
    return Loaded(steps, of_motors.array(chain), J.array(chain))


def _of_loops(configuration: tuple[Argument, ...]) -> CompliantTip:
    """Return the kernels of a tip in motor coordinates."""
    wrench = arguments.wrench("hybrid")
    load = partial(_of_motors, wrench=wrench)
    return CompliantTip(
        GROUP, configuration, wrench, increment("hybrid"), load, size="a", prefix="motors_", domain=CLOSED
    )


def _kernels(of: Asked) -> Sequence[Kernel]:
    """Return the kernels of a tip; fewer than six motors leave its stiffness infinite."""
    if not of.chain.loops:
        return ()
    kernels = _of_loops(of.configuration).kernels()
    return [each for each in kernels if each.name != "tip_stiffness" or len(of.chain.motors) >= 6]


FAMILY = Family(kernels={"compliance, tip": _kernels}, oracles="loops.oracles_of_compliance")
