# SPDX-License-Identifier: MIT
"""Move the elbow of a redundant arm until the tip is stiffest against a force, while the tip stays where it is.

Woolfrey, Ajoudani, Lu, Natale, "Optimal configurations for stiffness and compliance in human & robot arms", PLoS ONE
19(5) e0302987, 2024: a posture is stiffest against a force f where the force causes the least torque. Their program for
a humanoid descends the gradient of |J^T f|^2 with respect to q in the null space of its task.

    theirs     |J^T f|^2       gradient: 2 (dJ^T/dq_i f) . J^T f
    ours       f^T C f         C = J H^-1 J^T, of the arm's own springs, under its load (stiffgen.compliance_gradient)

Both are the same, up to a factor, for equal springs and no load. The paper has a UR3 and the humanoid ergoCub, which
holds two coordinates of its hand; here a KUKA iiwa 14 and a Franka Panda hold all six coordinates of the tip.

With --figure FILE the example draws an SVG (needs matplotlib: pip install -e '.[examples]').
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

import stiffgen

Array = NDArray[np.float64]
Slopes = Callable[[Array], Array]

PANDA = Path(__file__).resolve().parent.parent / "tests" / "data" / "panda.urdf"
STRIDE = 0.02  # rad, along the self-motion
CORRECTIONS = 3  # steps of Newton's method, back to the tip's pose


@dataclass(frozen=True)
class Arm:
    """A redundant arm of seven joints on springs (n,) [N m/rad], in a posture (n,) [rad], pushed along a direction."""

    name: str
    push: str
    robot: ModuleType
    start: Array
    springs: Array
    direction: Array  # (3,) unit vector, base axes
    load: float  # N

    @property
    def title(self) -> str:
        """Name and push of the arm."""
        return f"{self.name}, {self.push} by {self.load:.0f} N"

    @property
    def wrench(self) -> Array:
        """Hybrid wrench of the load (6,) [N, N m]."""
        return np.concatenate([self.load * self.direction, np.zeros(3)])

    def compliance(self, q: Array) -> Array:
        """Return the compliance against the force [m/N], at one posture or many."""
        return stiffgen.compliance_gradient(self.robot, q, self.wrench, self.springs, self.direction)[0]

    def slopes(self, q: Array) -> Array:
        """Return the gradient of the compliance with respect to q (n,)."""
        return stiffgen.compliance_gradient(self.robot, q, self.wrench, self.springs, self.direction)[1]

    def torque_squared(self, q: Array) -> Array:
        """Return |J^T f|^2 of a unit force [m^2]: the quantity that the paper makes smallest."""
        return np.asarray(((self.robot.hybrid.jacobian(q)[..., :3, :].swapaxes(-1, -2) @ self.direction) ** 2).sum(-1))

    def torque_slopes(self, q: Array) -> Array:
        """Return the gradient of |J^T f|^2 with respect to q (n,)."""
        torque = self.direction @ self.robot.hybrid.jacobian(q)[:3]
        return np.asarray(2 * self.robot.hybrid.jacobian_transpose_derivative(q)[..., :3] @ self.direction @ torque)

    def null_direction(self, q: Array) -> Array:
        """Return the unit motion of the joints that leaves the tip where it is (n,)."""
        return np.asarray(np.linalg.svd(self.robot.hybrid.jacobian(q))[2][-1])

    def moved(self, q: Array, length: float, along: Array) -> Array:
        """Return the posture at a distance [rad] along the self-motion, with the tip at the start's pose."""
        goal, z = self.robot.forward_kinematics(self.start), self.null_direction(q)
        # step along the null direction, then Newton's steps back to the start's pose
        q = q + length * np.copysign(1.0, z @ along) * z
        for _ in range(CORRECTIONS):
            pose = self.robot.forward_kinematics(q)
            turn = goal[:3, :3] @ pose[:3, :3].T
            # turn that is missing [rad], to first order
            axial = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
            error = np.concatenate([goal[:3, 3] - pose[:3, 3], axial])
            q = q + np.linalg.pinv(self.robot.hybrid.jacobian(q)) @ error
        return q

    def is_within_limits(self, q: Array) -> bool:
        """Return whether all joints are within their limits."""
        return bool(((q > self.robot.LOWER) & (q < self.robot.UPPER)).all())

    def self_motion(self) -> tuple[Array, Array]:
        """Return distances from the start [rad] and postures (k, n) along the self-motion, up to joint limits."""
        halves = []
        for sign in (-1, 1):
            along, half = sign * self.null_direction(self.start), [self.start]
            while len(half) < 3.5 / STRIDE and self.is_within_limits(half[-1]):
                half.append(self.moved(half[-1], STRIDE, along))
                along = half[-1] - half[-2]
            halves.append(half[1:-1])
        postures = np.array([*halves[0][::-1], self.start, *halves[1]])
        return STRIDE * np.arange(-len(halves[0]), len(halves[1]) + 1, dtype=float), postures

    def stiffest(self, slopes: Slopes) -> Array:
        """Return the posture that a descent along the self-motion reaches from the start."""
        q, stride, along = self.start, STRIDE, self.null_direction(self.start)
        along = -np.copysign(1.0, slopes(q) @ along) * along
        while stride > 1e-9:
            ahead = self.moved(q, stride, along)
            if slopes(ahead) @ (ahead - q) > 0 or not self.is_within_limits(ahead):
                stride /= 2  # it passes the minimum, or a limit
            else:
                q, along = ahead, ahead - q
        return q


def arms(iiwa: ModuleType, panda: ModuleType) -> tuple[Arm, ...]:
    """Return the iiwa on soft gains and the Panda on those of libfranka's example, pushed sideways and pressed down.

    The forces downwards are those of the payloads, 14 kg and 3 kg.
    """
    # [N m/rad] per joint
    soft, firm = 0.2 * np.array([800.0, 800, 600, 500, 300, 200, 150]), np.array([600.0] * 4 + [250, 150, 50])
    sideways, down = np.array([0.0, 1, 0]), np.array([0.0, 0, -1])
    # Postures [rad]; the last number of an arm is the load [N].
    bent, raised = np.array([0.3, 0.9, 0.8, -1.5, 0.4, 0.8, 0.0]), np.array([0.07, 1.46, 1.6, -1.5, -0.82, 0.94, 0.81])
    turned = np.array([-0.4, 0.3, 0.8, -1.8, -0.5, 1.9, 0.8])
    return (
        Arm("iiwa 14", "pushed sideways", iiwa, bent, soft, sideways, 40.0),
        Arm("iiwa 14", "pressed down", iiwa, raised, soft, down, 140.0),
        Arm("Panda", "pushed sideways", panda, turned, firm, sideways, 30.0),
        Arm("Panda", "pressed down", panda, turned, firm, down, 30.0),
    )


def rows(cases: Sequence[Arm]) -> list[tuple[str, ...]]:
    """Return per arm the compliance [mm/N] at the start, where the torque is least, and where the tip is stiffest."""
    made = []
    for arm in cases:
        postures = arm.start, arm.stiffest(arm.torque_slopes), arm.stiffest(arm.slopes)
        apart = np.linalg.norm(postures[2] - postures[1])
        made.append((arm.title, *(f"{1e3 * arm.compliance(q):.3f}" for q in postures), f"{apart:.2f}"))
    return made


def panda() -> ModuleType:
    """Return the Panda's functions, generated into the user's cache on first use."""
    return stiffgen.load(PANDA, tip="panda_hand", controller=False).module


def figure(both: Sequence[Arm]) -> str:
    """Return the SVG text: compliance along the self-motions, and the postures that both gradients lead to."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from examples.style import CONVENTIONAL, CORRECTED, INK, STYLE, themed_svg

    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(7.5, 3.6), layout="constrained")
        for axes, arm, legend in zip(drawing.subplots(1, 2), both, ("upper left", "lower left"), strict=True):
            distance, postures = arm.self_motion()
            ours = arm.stiffest(arm.slopes)
            equal = arm.torque_squared(arm.start) / arm.compliance(arm.start)  # springs that agree at the start
            axes.plot(distance, 1e3 * arm.torque_squared(postures) / equal, "--", color=CONVENTIONAL,
                      label="equal springs, no load")  # fmt: skip
            axes.plot(distance, 1e3 * arm.compliance(postures), color=CORRECTED, label="its springs, its load")
            for q, colour, label in (
                (arm.start, INK, "start"),
                (arm.stiffest(arm.torque_slopes), CONVENTIONAL, "least torque"),
                (ours, CORRECTED, "stiffest"),
            ):
                place = distance[np.abs(postures - q).max(axis=1).argmin()]
                axes.plot(place, 1e3 * arm.compliance(q), "o", color=colour, label=label)
            axes.set(xlabel="self-motion from the start [rad]", ylabel="compliance against the force [mm/N]",
                     title=arm.title)  # fmt: skip
            axes.legend(loc=legend)
        return themed_svg(drawing)


def main() -> None:
    """Print the table; draw the figure if requested."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figure", type=Path, metavar="FILE", help="also draw an SVG")
    options = parser.parse_args()
    from generated import iiwa14

    cases = arms(iiwa14, panda())
    for row in rows(cases):
        print(*(f"{value:>26}" for value in row))
    if options.figure:
        options.figure.write_text(figure((cases[1], cases[2])))


if __name__ == "__main__":
    main()
