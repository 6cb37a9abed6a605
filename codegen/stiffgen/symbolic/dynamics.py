"""CasADi expressions of the joint-space mass matrix, by composite bodies in base axes.

M_ij = J_i . h_j for i <= j, where h_j = I^c_j J_j is the momentum (linear, and angular about the base's origin)
that everything beyond joint j has at a unit rate of joint j (Featherstone, Rigid Body Dynamics Algorithms, 2008,
composite-rigid-body algorithm; all inertias are taken about the base's origin, so that they add up without
transformations).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from stiffgen.robot.chain import Body, Chain
from stiffgen.symbolic.kinematics import Expressions, Section, cross, outward_frames, spatial_column


def columns_and_momenta(chain: Chain, q: ca.SX) -> Expressions:
    """Spatial Jacobian columns over momenta: a (12 x number of joints) matrix, rows 0..5 J_j, rows 6..11 h_j."""
    recursion, frames = outward_frames(chain, q)
    beyond = [_Composite(0.0, ca.SX.zeros(3), ca.SX.zeros(3, 3)) for _ in chain.joints]
    stacked: list[ca.SX] = []
    for index in reversed(range(len(chain.joints))):
        joint, (rotation, origin, axis) = chain.joints[index], frames[index]
        composite = beyond[index] + _about_base(joint.body, rotation, origin)
        if joint.parent >= 0:
            beyond[joint.parent] = beyond[joint.parent] + composite
        tensor = composite.tensor
        upper = {f"I{index}_{r}{c}": tensor[r, c] for r in range(3) for c in range(r, 3)}
        recursion.sections.append(
            Section(
                f"from joint {joint.name} outwards: first moment m{index} [kg m] and inertia I{index} [kg m^2]",
                {f"m{index}_": composite.moment, **upper},
            )
        )
        column = spatial_column(joint, origin, axis)
        linear = composite.mass * column[:3] - cross(composite.moment, column[3:])
        angular = cross(composite.moment, column[:3]) + tensor @ column[3:]
        stacked.append(ca.vertcat(column, linear, angular))
    return Expressions(ca.densify(ca.horzcat(*reversed(stacked))), tuple(recursion.sections))


@dataclass(frozen=True)
class _Composite:
    """Mass [kg], first moment [kg m] and inertia tensor [kg m^2] about the base's origin, in base axes."""

    mass: float
    moment: ca.SX
    tensor: ca.SX

    def __add__(self, other: _Composite) -> _Composite:
        return _Composite(self.mass + other.mass, self.moment + other.moment, self.tensor + other.tensor)


def _about_base(body: Body, rotation: ca.SX, origin: ca.SX) -> _Composite:
    xx, xy, xz, yy, yz, zz = body.tensor
    local = ca.SX(ca.sparsify(ca.DM([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])))
    own_moment = ca.densify(rotation @ ca.SX(ca.sparsify(ca.DM(body.moment))))
    shift = own_moment + body.mass * origin  # = the first moment about the base's origin
    # Steiner twice over: sym(p c^T) terms of the shift from the frame's origin to the base's.
    square = ca.dot(origin, own_moment + shift)
    turned = ca.triu2symm(ca.triu(ca.densify(rotation @ local @ rotation.T)))
    outer = own_moment @ origin.T + origin @ shift.T
    steiner = ca.triu2symm(ca.triu(square * ca.SX.eye(3) - outer))
    return _Composite(body.mass, shift, turned + steiner)
