# SPDX-License-Identifier: MIT
"""Random linkages, and energies of their motors with 60 digits: the loops are closed again for every difference.

The oracle reads the URDF and the text of --loop. It knows no constraint Jacobian, no multipliers and no kinematic
stiffness: U(a) is the energy at the configuration that Newton's method finds, and it is differentiated twice.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mpmath
import numpy as np

from stiffgen import load_chain
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.symbolic.model import casadi_function
from support.exact_tree import AT_ORIGIN, STEP, ExactTree, Pose, as_array, differentiated, exponential, mp

_LIMIT = "<limit lower='-3' upper='3' effort='9' velocity='1'/>"
STEP_OF_MASS = mp.mpf(10) ** -10
MOST_MOTORS_WITH_MASS = 3
WORST_CONDITION = 1000
_UP = (0.0, 0.0, 1.0)


@dataclass
class Linkage:
    """URDF, texts of --loop, names of the actuated joints of the loops, and the tip link; closed at q = 0."""

    urdf: str
    loops: list[str]
    actuated: list[str]
    tip: str

    @property
    def options(self) -> dict[str, Any]:
        """Options of ``load_chain``."""
        return {"tip": self.tip, "loop": self.loops, "actuated": self.actuated}


@dataclass
class _Builder:
    source: random.Random
    parts: list[str] = field(default_factory=lambda: ['<link name="world"/>'])
    loops: list[str] = field(default_factory=list)
    actuated: list[str] = field(default_factory=list)
    count: int = 0

    def numbers(self, size: float, count: int = 3) -> list[float]:
        return [round(self.source.uniform(-size, size), 4) for _ in range(count)]

    def link(
        self,
        parent: str,
        xyz: Sequence[float],
        rpy: Sequence[float],
        axis: Sequence[float] | None,
        kind: str = "revolute",
    ) -> str:
        """Add a link on a joint; without an axis the joint is fixed."""
        self.count += 1
        name, size = f"l{self.count}", self.source.uniform(0.02, 0.04)
        kind = kind if axis else "fixed"
        com = " ".join(map(str, self.numbers(0.1)))
        place, turn, along = (" ".join(map(repr, each)) for each in (xyz, rpy, axis or _UP))
        self.parts.append(
            f'<link name="{name}"><inertial><origin xyz="{com}" rpy="{com}"/><mass value="{size * 40:.4f}"/>'
            f'<inertia ixx="{size:.5f}" iyy="0.03" izz="0.028" ixy="0.001" ixz="-0.002" iyz="0.0015"/></inertial>'
            "</link>"
            f'<joint name="j{self.count}" type="{kind}"><parent link="{parent}"/><child link="{name}"/>'
            f'<origin xyz="{place}" rpy="{turn}"/><axis xyz="{along}"/>{_LIMIT}</joint>'
        )
        return name

    def joint(self, parent: str, size: float = 0.3, kind: str = "revolute") -> str:
        return self.link(parent, self.numbers(size), self.numbers(2), self.numbers(1), kind)

    def tree(self) -> ExactTree:
        names = [f"j{k + 1}" for k in range(self.count)]
        return ExactTree(f"<robot name='r'>{''.join(self.parts)}</robot>", names)

    def close(self, first: str, second: str, point: Sequence[float]) -> None:
        """Close a loop at a point of the first link, where it is at q = 0."""
        poses = self.tree().poses(AT_ORIGIN, [mp.mpf(0)] * self.count)
        (R, p), (S, s) = poses[first], poses[second]
        other = S.T * (p + R * mp.matrix([mp.mpf(float(x)) for x in point]) - s)
        texts = (",".join(repr(float(x)) for x in each) for each in (point, other))
        self.loops.append(f"{first}:{next(texts)}={second}:{next(texts)}")

    def planar(self, start: str) -> str:
        """Add a four-bar whose axes are parallel; its coupler is returned."""
        mount = self.link(start, self.numbers(0.2), self.numbers(2), None)
        crank = self.link(mount, [0.0, 0.0, 0.0], self._turn(), _UP)
        self.actuated.append(f"j{self.count}")
        coupler = self.link(crank, [self.source.uniform(0.1, 0.2), *self.numbers(0.1, 2)], self._turn(), _UP)
        rocker = self.link(mount, [0.25, self.source.uniform(-0.2, -0.1), 0.05], self._turn(), _UP)
        self.close(coupler, rocker, [0.2, 0.05, 0.0])
        return coupler

    def _turn(self) -> list[float]:
        return [0.0, 0.0, self.source.uniform(-1, 1)]

    def spatial(self, start: str) -> str:
        """Add a loop of four random joints, one of them a motor, sometimes with a sliding joint."""
        crank = self.joint(start)
        self.actuated.append(f"j{self.count}")
        middle = self.joint(self.joint(crank), kind=self.source.choice(("revolute", "prismatic")))
        self.close(middle, self.joint(start), self.numbers(0.3))
        return middle

    def ankle(self, start: str) -> str:
        """Add a platform on two joints with two motors, each with a crank and a rod on two joints."""
        platform = self.link(self.joint(start), self.numbers(0.02), self.numbers(2), self.numbers(1))
        for side in (-1, 1):
            crank = self.link(start, [side * 0.2, 0.1, 0.3], self.numbers(2), self.numbers(1))
            self.actuated.append(f"j{self.count}")
            rod = self.link(self.joint(crank, 0.15), [0.0, 0.0, 0.0], self.numbers(2), self.numbers(1))
            self.close(rod, platform, self.numbers(0.3))
        return platform


def random_linkage(seed: int) -> Linkage:
    """Return a linkage with one to three loops, planar or spatial, and joints before and after them."""
    source = random.Random(seed)
    b = _Builder(source)
    link = "world"
    for _ in range(source.randint(0, 2)):
        link = b.joint(link)
    kinds = {0: ["planar"], 1: ["spatial"], 2: ["ankle"], 3: ["planar", "spatial"], 4: ["spatial", "planar", "spatial"]}
    for kind in kinds[seed % 5]:
        link = getattr(b, kind)(link)
    for _ in range(source.randint(0, 2)):
        link = b.joint(link)
    return Linkage(f"<robot name='r'>{''.join(b.parts)}</robot>", b.loops, b.actuated, link)


class ExactLinkage:
    """Closed configurations of a linkage with 60 digits, as a function of the motors' positions."""

    def __init__(self, linkage: Linkage, coordinates: list[str], motors: Sequence[int], q: np.ndarray) -> None:
        """Read the linkage, and close its loops at the motor positions of q."""
        self.tree = ExactTree(linkage.urdf, coordinates)
        self.passive = [k for k in range(len(coordinates)) if k not in motors]
        self.motors = list(motors)
        ends = [end.rpartition(":") for text in linkage.loops for end in text.split("=")]
        points = [(link, mp.matrix([mp.mpf(float(x)) for x in xyz.split(",")])) for link, _, xyz in ends]
        self.loops = list(zip(points[::2], points[1::2], strict=True))
        self.q = [mp.mpf(float(x)) for x in q]
        self.base: Pose = AT_ORIGIN
        slopes = mp.matrix(3 * len(self.loops), len(self.passive))
        for column, k in enumerate(self.passive):
            up, down = list(self.q), list(self.q)
            up[k], down[k] = up[k] + STEP, down[k] - STEP
            slopes[:, column] = (self.gaps(up) - self.gaps(down)) / (2 * STEP)
        self.inverse = (slopes.T * slopes) ** -1 * slopes.T
        self.q = self.closed([self.q[k] for k in self.motors])

    def gaps(self, q: list[mpmath.mpf]) -> mpmath.matrix:
        """Return the distances between the ends of the loops, three entries per loop."""
        poses = self.tree.poses(self.base, q)
        gaps = []
        for (one, x), (other, y) in self.loops:
            gaps += [*(poses[one][1] + poses[one][0] * x - poses[other][1] - poses[other][0] * y)]
        return mp.matrix(gaps)

    def closed(self, motors: Sequence[mpmath.mpf]) -> list[mpmath.mpf]:
        """Return the closed configuration near ``self.q``."""
        q = list(self.q)
        for k, value in zip(self.motors, motors, strict=True):
            q[k] = value
        for _ in range(60):
            step = self.inverse * self.gaps(q)
            for k, value in zip(self.passive, step, strict=True):
                q[k] -= value
            if max(abs(x) for x in step) < mp.mpf(10) ** -52:
                return q
        raise ArithmeticError("the linkage does not close")

    def kinetic(self, rates: list[mpmath.mpf]) -> tuple[np.ndarray, np.ndarray]:
        """Return the mass matrix of the motors, and the Coriolis and centrifugal forces at their rates (Lagrange)."""
        n = len(self.motors)

        def units(k: int) -> list[mpmath.mpf]:
            return [mp.mpf(int(i == k)) for i in range(n)]

        here = [mp.mpf(0)] * n
        mass = self._mass(here)
        forces = mp.matrix(n, 1)
        along = self._change([STEP_OF_MASS * rate for rate in rates]) * mp.matrix(rates)
        for k in range(n):
            change = self._change([STEP_OF_MASS * x for x in units(k)])
            forces[k] = along[k] - (mp.matrix(rates).T * change * mp.matrix(rates))[0] / 2
        return as_array(mass), as_array(forces).ravel()

    def _change(self, step: list[mpmath.mpf]) -> mpmath.matrix:
        return (self._mass(step) - self._mass([-x for x in step])) / (2 * STEP_OF_MASS)

    def _mass(self, away: list[mpmath.mpf]) -> mpmath.matrix:
        """Return the mass matrix at displaced motors, from differences of the bodies' poses."""
        n, bodies = len(self.motors), self.tree.bodies
        ends = [[self._poses([a + s * STEP * (i == k) for i, a in enumerate(away)]) for s in (1, -1)] for k in range(n)]
        here, total = self._poses(away), mp.matrix(n, n)
        for link, (mass, (place, com), tensor) in bodies.items():
            linear, angular = mp.matrix(3, n), mp.matrix(3, n)
            for k, (up, down) in enumerate(ends):
                (R1, p1), (R0, p0), R = up[link], down[link], here[link][0]
                linear[:, k] = (p1 + R1 * com - p0 - R0 * com) / (2 * STEP)
                W = R.T * (R1 - R0) / (2 * STEP)
                angular[:, k] = place.T * mp.matrix([W[2, 1], W[0, 2], W[1, 0]])
            total += mass * linear.T * linear + angular.T * tensor * angular
        return total

    def _poses(self, away: Sequence[mpmath.mpf]) -> dict[str, Pose]:
        motors = [self.q[k] + d for k, d in zip(self.motors, away, strict=True)]
        return self.tree.poses(self.base, self.closed(motors))

    def of_motors(self, energy: Callable[[dict[str, Pose]], mpmath.mpf]) -> Callable[[list[mpmath.mpf]], mpmath.mpf]:
        """Return an energy of the links' poses as a function of the motors' displacements."""

        def value(x: list[mpmath.mpf]) -> mpmath.mpf:
            return energy(self._poses(x))

        return value


def closed_state(chain: Chain, seed: int) -> tuple[SimpleNamespace, np.ndarray]:
    """Return CasADi's functions and a closed configuration away from singularities."""
    functions = SimpleNamespace(
        **{k.qualified_name: casadi_function(chain, k) for k in chain_kernels(chain) if k.qualified_name in _NEEDED}
    )
    source, start = np.random.default_rng(seed), np.array(chain.start)
    for _ in range(40):
        away = source.uniform(-0.3, 0.3, len(chain.actuated))
        q = np.array(functions.close(start[list(chain.actuated)] + away, start)).ravel()
        if np.isfinite(q).all() and float(functions.motors_condition(q)) < WORST_CONDITION:
            return functions, q
    raise ArithmeticError("no closed configuration found")


_NEEDED = (
    "close", "spring_wrench", "spring_task_stiffness", "motors_condition", "motors_torque", "motors_joint_stiffness",
    "motors_spring_torque", "motors_spring_joint_stiffness", "motors_gravity_gradient", "motors_jacobian",
    "motors_gravity_joint_stiffness", "motors_mass_matrix", "motors_bias_forces",
)  # fmt: skip


def linkage_errors(seed: int, file: Path) -> dict[str, float]:
    """Return the errors of a random linkage's functions, relative to the largest entry."""
    linkage = random_linkage(seed)
    file.write_text(linkage.urdf)
    chain = load_chain(file, **linkage.options)
    functions, q = closed_state(chain, seed)
    source = np.random.default_rng([seed, 1])
    exact = ExactLinkage(linkage, [c.name for c in chain.coordinates], chain.actuated, q)
    errors = {"close": max(abs(float(a - b)) for a, b in zip(exact.q, q, strict=True))}

    def compare(name: str, reference: np.ndarray, *given: object) -> None:
        value = np.array(getattr(functions, name)(*given)).reshape(reference.shape)
        errors[name] = float(np.abs(value - reference).max() / np.abs(reference).max())

    spring, given = _spring(linkage.tip, source)
    n = len(chain.actuated)
    gradient, hessian = differentiated(exact.of_motors(spring), n)
    load = functions.spring_wrench(q, *given), functions.spring_task_stiffness(q, *given)
    compare("motors_spring_torque", -gradient, q, *given)
    compare("motors_spring_joint_stiffness", hessian, q, *given)
    compare("motors_torque", -gradient, q, load[0])
    compare("motors_joint_stiffness", hessian, q, *load)
    fall = source.normal(size=3) * 6
    weight = mp.matrix(fall.tolist())
    gradient, hessian = differentiated(exact.of_motors(lambda p: exact.tree.potential_energy(p, weight)), n)
    compare("motors_gravity_gradient", gradient, q, fall)
    compare("motors_gravity_joint_stiffness", hessian, q, fall)
    if n > MOST_MOTORS_WITH_MASS:
        return errors
    rates = source.normal(size=n)
    mass, forces = exact.kinetic([mp.mpf(float(x)) for x in rates])
    compare("motors_mass_matrix", mass, q)
    compare("motors_bias_forces", forces + gradient, q, rates, fall)
    return errors


def _spring(
    tip: str, source: np.random.Generator
) -> tuple[Callable[[dict[str, Pose]], mpmath.mpf], tuple[object, ...]]:
    """Return the energy of a random spring at the tip, and the arguments of its functions."""
    roots = source.normal(size=(2, 3, 3))
    Kt, Ko = (size * (root @ root.T + np.eye(3)) for root, size in zip(roots, (300.0, 20.0), strict=True))
    rest = np.eye(4)
    rest[:3, :3] = as_array(exponential(mp.matrix(source.normal(size=3).tolist())))
    rest[:3, 3] = source.normal(size=3) * 0.3
    R0, p0, kt, ko = (mp.matrix(each.tolist()) for each in (rest[:3, :3], rest[:3, 3], Kt, Ko))
    trace = (ko[0, 0] + ko[1, 1] + ko[2, 2]) / 2 * mp.eye(3) - ko

    def energy(poses: dict[str, Pose]) -> mpmath.mpf:
        R, p = poses[tip]
        away, turned = p - p0, trace * (mp.eye(3) - R0.T * R)
        return (away.T * kt * away)[0] / 2 + turned[0, 0] + turned[1, 1] + turned[2, 2]

    return energy, (rest, Kt, Ko)
