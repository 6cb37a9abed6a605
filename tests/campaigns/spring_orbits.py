# SPDX-License-Identifier: MIT
"""Work of a torque field on closed orbits: springs beside the laws in common use.

    python tests/campaigns/spring_orbits.py [ORBITS]

Every orbit is a closed curve of the iiwa 14's joints, q(t) = c + a (cos t d1 + sin t d2 + ...), 0.05 to 1 rad large,
with the equilibrium at a point near it. A torque that is the gradient of an energy does no work round it, whatever the
gains; what the others do is put into the robot, or taken out of it, once an orbit. A second table shows how the work of
the springs falls with the order of the quadrature, so that the zero is not the quadrature's.

The secant law Kq(q, F) (q0 - q) stands here as it is used: with a task stiffness that is chosen (blkdiag(Kt, Ko)) and a
measured wrench, held round the orbit. With F and K of one energy U at q it is conservative, too, since Kq is then U's
Hessian, and d((q - q0) . dU - U) = Kq (q - q0): the gradient of another energy than U.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

import stiffgen
from stiffgen.core.symbolic.choices import KINDS
from stiffgen.families.springs.springs import spring

URDF = Path(__file__).resolve().parents[2] / "urdf" / "iiwa14.urdf"
Array = np.ndarray
Law = Callable[[Array], Array]


class Orbit:
    """A closed curve in the space of joints, and a spring's parameters."""

    def __init__(self, random: np.random.Generator, lower: Array, upper: Array) -> None:
        """Draw a closed path of joint positions (three harmonics), a rest position, stiffnesses and a wrench."""
        self.size = float(np.exp(random.uniform(np.log(0.05), np.log(1.0))))  # [rad] largest distance from the centre
        self.centre = random.uniform(0.6 * lower, 0.6 * upper)
        self.waves = random.normal(size=(3, 2, len(lower))) * np.array([1.0, 0.3, 0.1])[:, None, None]
        largest = max(np.linalg.norm(self._away(t)) for t in np.linspace(0, 2 * np.pi, 200))
        self.waves *= self.size / largest
        self.rest = self.centre + 0.5 * self.size * random.normal(size=len(lower)) / np.sqrt(len(lower))
        roots = [random.normal(size=(3, 3)) for _ in range(2)]
        self.Kt, self.Ko = (scale * (r @ r.T + 0.1 * np.eye(3)) for r, scale in zip(roots, (300.0, 20.0), strict=True))
        coupling = random.normal(size=(6, 6))
        units = np.sqrt([300.0] * 3 + [20.0] * 3)
        self.K = np.outer(units, units) * (coupling @ coupling.T / 3 + 0.1 * np.eye(6))
        self.wrench = random.normal(size=6) * np.array([20.0, 20, 20, 5, 5, 5])

    def _away(self, t: float) -> Array:
        orders = t * np.arange(1, 4)
        return np.asarray(np.cos(orders) @ self.waves[:, 0] + np.sin(orders) @ self.waves[:, 1])

    def at(self, t: float) -> tuple[Array, Array]:
        """Position [rad] and dq/dt [rad] at the parameter t in [0, 2 pi)."""
        k = np.arange(1, 4)
        rate = (k * np.cos(k * t)) @ self.waves[:, 1] - (k * np.sin(k * t)) @ self.waves[:, 0]
        return self.centre + self._away(t), rate

    def work(self, law: Law, nodes: int = 512) -> float:
        """By the trapezoidal rule, exact to rounding for smooth periodic functions [J]."""
        return float(
            2 * np.pi / nodes * sum(law(q) @ dq for q, dq in map(self.at, 2 * np.pi * np.arange(nodes) / nodes))
        )

    def work_by_gauss(self, law: Law, points: int, pieces: int = 8) -> float:
        """Return the work [J] by Gauss's rule of order 2 points on pieces of equal length."""
        nodes, weights = np.polynomial.legendre.leggauss(points)
        half = np.pi / pieces
        total = 0.0
        for piece in range(pieces):
            for x, weight in zip(nodes, weights, strict=True):
                q, dq = self.at(half * (2 * piece + 1 + x))
                total += half * weight * float(law(q) @ dq)
        return total


def rotation_error(E: Array) -> tuple[Array, float]:
    """Axis times the sine of the angle, and the angle."""
    sine = np.array([E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]]) / 2
    return sine, float(np.arctan2(np.linalg.norm(sine), (np.trace(E) - 1) / 2))


def laws(model: stiffgen.StiffnessModel, orbit: Orbit) -> dict[str, Law]:
    """Return the laws by name: torques (n) [N m] as functions of q (n) [rad]."""
    H = np.array(model.forward_kinematics(orbit.rest))

    def potential(kind: str) -> Law:
        torque = getattr(model, spring(kind).name).torque
        given: tuple[object, ...] = (H, orbit.K) if kind == "coupled" else (H, orbit.Kt, orbit.Ko)
        if kind == "bounded":
            given += 200.0, 50.0  # force_limit, moment_limit
        return lambda q: np.array(torque(q, *given)).ravel()

    def common(moment: Callable[[Array, float], Array]) -> Law:
        """Return the law of a spring whose moment is a function of the rotation error (sine, angle)."""

        def law(q: Array) -> Array:
            pose, J = np.array(model.forward_kinematics(q)), np.array(model.hybrid.jacobian(q))
            sine, angle = rotation_error(H[:3, :3].T @ pose[:3, :3])
            turning = H[:3, :3] @ orbit.Ko @ moment(sine, angle)
            return np.asarray(-J.T @ np.concatenate([orbit.Kt @ (pose[:3, 3] - H[:3, 3]), turning]))

        return law

    def secant(name: str) -> Law:
        """Return the law that multiplies the joint stiffness at q by the deflection from rest, which has no energy."""
        stiffness = getattr(model.hybrid, name)

        K = np.zeros((6, 6))
        K[:3, :3], K[3:, 3:] = orbit.Kt, orbit.Ko

        def law(q: Array) -> Array:
            return np.asarray(np.array(stiffness(q, orbit.wrench, K)) @ (orbit.rest - q))

        return law

    return {
        **{f"{kind} spring": potential(kind) for kind in KINDS},
        "K log(R)": common(lambda s, a: s / np.sinc(a / np.pi)),
        "2 K quaternion vector": common(lambda s, a: s / np.cos(a / 2)),
        "K sin(angle) axis": common(lambda s, _: s),
        "secant Kq(q, F) (q0 - q), corrected": secant("joint_stiffness"),
        "secant Kq(q, F) (q0 - q), conventional": secant("joint_stiffness_uncorrected"),
    }


_NODES = {"bounded spring": 512}  # its force turns within a few decimetres


def table(count: int = 100, seed: int = 0) -> dict[str, tuple[float, float]]:
    """Median and largest absolute work [J] by law, over the same orbits."""
    model, orbits = _orbits(count, seed)
    works: dict[str, list[float]] = {}
    for orbit in orbits:
        for name, law in laws(model, orbit).items():
            works.setdefault(name, []).append(abs(orbit.work(law, _NODES.get(name, 256 if "spring" in name else 96))))
    return {name: (float(np.median(each)), max(each)) for name, each in works.items()}


def orders(points: tuple[int, ...] = (1, 2, 3, 4, 6, 8, 12), seed: int = 0) -> dict[int, dict[str, float]]:
    """Largest absolute work [J] of the springs round five orbits, by points of Gauss's rule; not of the bounded one."""
    model, orbits = _orbits(5, seed)
    result: dict[int, dict[str, float]] = {}
    for order in points:
        worst: dict[str, float] = {}
        for orbit in orbits:
            for name, law in laws(model, orbit).items():
                if name.endswith("spring") and name not in _NODES:
                    worst[name] = max(worst.get(name, 0.0), abs(orbit.work_by_gauss(law, order)))
        result[order] = worst
    return result


def _orbits(count: int, seed: int) -> tuple[stiffgen.StiffnessModel, list[Orbit]]:
    chain = stiffgen.load_chain(URDF)
    random = np.random.default_rng(seed)
    lower = np.array([c.lower for c in chain.coordinates])
    upper = np.array([c.upper for c in chain.coordinates])
    return stiffgen.StiffnessModel(chain, springs=KINDS), [Orbit(random, lower, upper) for _ in range(count)]


def main() -> None:
    """Print both tables in Markdown: work round orbits, and its fall with the order of the quadrature."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    print(f"Work round {count} closed orbits of 0.05 to 1 rad, iiwa 14, J\n")
    print("| torque | median | largest |\n|---|---|---|")
    for name, (median, largest) in table(count).items():
        print(f"| {name} | {median:.1e} | {largest:.1e} |")
    print("\nWork of the springs by points of Gauss's rule on eighths of an orbit (five orbits), J\n")
    by_order = orders()
    names = list(next(iter(by_order.values())))
    print("| points | " + " | ".join(names) + " |\n|---|" + "---|" * len(names))
    for order, worst in by_order.items():
        print(f"| {order} | " + " | ".join(f"{worst[name]:.1e}" for name in names) + " |")


if __name__ == "__main__":
    main()
