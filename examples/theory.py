# SPDX-License-Identifier: MIT
"""Compute the numbers and pictures of docs/theory.md: basis vectors, tangent and secant, work of an orbit.

Everything here is written out from the definitions in NumPy; of stiffgen it uses one kernel, the conventional stiffness
of the iiwa 14.

    python -m examples.theory             prints the page's tables
    python -m examples.theory --figures   also draws docs/theory_*.svg (needs matplotlib: the extra examples)
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Moment = Callable[[Array, Array], Array]
"""(turn of the tip from the equilibrium (3, 3), stiffness (3, 3) [N m/rad]) -> moment that acts on the tip [N m]."""

ROOT = Path(__file__).resolve().parent.parent
STEPS = 2000
"""Steps of an orbit."""
EVERY = 20
"""Samples of the recorded trajectory from one configuration that is used to the next."""


def cross_matrix(w: Array) -> Array:
    """[w] with [w] x = w x x."""
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


def vector(A: Array) -> Array:
    """Return the vector w whose cross-product matrix is A."""
    return np.array([A[2, 1], A[0, 2], A[1, 0]])


def turn(w: Array) -> Array:
    """Return the rotation about w by the angle |w| [rad] (Rodrigues)."""
    angle = float(np.linalg.norm(w))
    if angle == 0:
        return np.eye(3)
    W = cross_matrix(w / angle)
    return np.asarray(np.eye(3) + np.sin(angle) * W + (1 - np.cos(angle)) * W @ W)


def rotation_vector(R: Array) -> Array:
    """Return the w of :func:`turn`, for angles below pi."""
    axis = vector(R - R.T) / 2  # sin(angle) times the unit axis
    sine, cosine = float(np.linalg.norm(axis)), (np.trace(R) - 1) / 2
    return axis if sine == 0 else axis * (np.arctan2(sine, cosine) / sine)


def _quaternion_vector(R: Array) -> Array:
    """Return twice the vector part of a rotation's unit quaternion: 2 sin(angle / 2) times the unit axis."""
    w = rotation_vector(R)
    angle = float(np.linalg.norm(w))
    return w if angle == 0 else 2 * np.sin(angle / 2) / angle * w


def gradient(R: Array, K: Array) -> Array:
    """Return minus the gradient of the trace energy tr(G (I - R)), G = tr(K)/2 I - K.

    A small turn w changes R by [w] R, and the energy by -tr(G [w] R) = -tr(A [w]) = vector(A - A^T) . w with A = R G.
    """
    A = R @ (np.trace(K) / 2 * np.eye(3) - K)
    return -vector(A - A.T)


LAWS: dict[str, Moment] = {
    "K times rotation vector": lambda R, K: -K @ rotation_vector(R),
    "2 K times quaternion vector": lambda R, K: -K @ _quaternion_vector(R),
    "K times sin(angle) axis": lambda R, K: -K @ vector(R - R.T) / 2,
    "gradient of an energy": gradient,
}


def orbit(centre: Array, radius: float, first: Array, second: Array) -> list[Array]:
    """Return orientations round a circle of rotation vectors, the first one again at the end."""
    phase = 2 * np.pi * np.arange(STEPS + 1) / STEPS
    return [turn(centre + radius * (np.cos(s) * first + np.sin(s) * second)) for s in phase]


def work(law: Moment, K: Array, orientations: list[Array]) -> Array:
    """Return the work [J] of a law up to each point of an orbit, by the midpoint rule."""
    done = [0.0]
    for here, there in itertools.pairwise(orientations):
        step = rotation_vector(there @ here.T)
        done.append(done[-1] + float(law(turn(step / 2) @ here, K) @ step))
    return np.array(done)


def example_orbit() -> list[Array]:
    """Return an orbit of radius 0.3 rad about a rotation by 0.5 rad about x."""
    x, y, z = np.eye(3)
    return orbit(0.5 * x, 0.3, z, y)


def orbit_table() -> list[tuple[str, list[float]]]:
    """Return the net work of the orbit for each law, at K = diag(30, 30, 10), diag(30, 20, 10), diag(30, 30, 30)."""
    orientations = example_orbit()
    stiffnesses = [np.diag(k) for k in ([30.0, 30.0, 10.0], [30.0, 20.0, 10.0], [30.0, 30.0, 30.0])]
    return [(name, [work(law, K, orientations)[-1] for K in stiffnesses]) for name, law in LAWS.items()]


def asymmetry(robot: ModuleType) -> tuple[Array, Array]:
    """Return the largest singular values of the conventional stiffness' antisymmetric and symmetric part [N m/rad].

    The configurations are every 20th of the paper's recorded trajectory; moments of 1 N m act about each base axis.
    """
    trajectory = np.loadtxt(ROOT / "examples" / "bowl_wiping" / "zero_force_trajectory.csv", delimiter=",").T[::EVERY]
    K = np.diag([700.0, 700.0, 800.0, 30.0, 30.0, 30.0])
    moments = np.hstack([np.zeros((3, 3)), np.eye(3)])  # (3, 6): a wrench per axis
    Ku = robot.hybrid.joint_stiffness_uncorrected(trajectory[:, None], moments, K)  # (configurations, 3, n, n)
    turned = np.swapaxes(Ku, -1, -2)
    return np.linalg.norm((Ku - turned) / 2, 2, axis=(-2, -1)), np.linalg.norm((Ku + turned) / 2, 2, axis=(-2, -1))


def pendulum_spring(angle: Array, k: float = 1.0) -> dict[str, Array]:
    """Return torque and tangent stiffness of one joint on the trace spring, and the tangent used as a secant."""
    return {"torque": -k * np.sin(angle), "tangent": k * np.cos(angle), "secant_law": -k * np.cos(angle) * angle}


def pair_forces(aside: float, angle: float, apart: float, k: float) -> dict[str, float]:
    """Return the force [N] that pulls tip B back, along y, of three springs of ``k`` [N/m] between tips A and B.

    At rest B lies at (``apart``, 0) of A [m] and has A's axes. It is ``aside`` [m] along y and turned by ``angle``
    [rad] about z. Seen from a tip alone, the spring acts on the displacement of the other one in its axes.
    """
    B = turn(np.array([0.0, 0.0, angle]))
    between, rest = np.array([apart, aside, 0.0]), np.array([apart, 0.0, 0.0])
    from_a = between - rest
    from_b = between - B @ rest
    half_way = between - (np.eye(3) + B) @ rest / 2
    return {name: float(k * e[1]) for name, e in (("A", from_a), ("half-way", half_way), ("B", from_b))}


def tables(robot: ModuleType) -> str:
    """Return the printed tables: work of the laws round an orbit, and asymmetry along the trajectory."""
    lines = [f"{'net work of the orbit [J]':30s}{'30, 30, 10':>12s}{'30, 20, 10':>12s}{'30, 30, 30':>12s}"]
    lines += [f"{name:30s}" + "".join(f"{round(value, 9) + 0.0:12.4f}" for value in row) for name, row in orbit_table()]
    antisymmetric, symmetric = asymmetry(robot)
    lines.append(
        "\nconventional stiffness under 1 N m, along the recorded trajectory [N m/rad]:\n"
        f"antisymmetric part {antisymmetric.min():.2f} to {antisymmetric.max():.2f}, "
        f"symmetric part {symmetric.min():.0f} to {symmetric.max():.0f}"
    )
    return "\n".join(lines)


def draw() -> dict[str, str]:
    """Return the page's figures: file name to SVG text."""
    import matplotlib as mpl

    from examples.style import STYLE, themed_svg

    with mpl.rc_context(STYLE):
        return {
            "theory_basis.svg": themed_svg(_basis_figure()),
            "theory_tangent.svg": themed_svg(_tangent_figure()),
            "theory_orbit.svg": themed_svg(_orbit_figure()),
            "theory_pair.svg": themed_svg(_pair_figure()),
        }


def _arrow(
    axes: Any,
    start: ArrayLike,
    way: ArrayLike,
    colour: str,
    *,
    width: float = 1.6,
    text: str = "",
    shift: tuple[float, float] = (0.04, 0.04),
) -> None:
    """Draw an arrow [start, start + way] with a name at its end."""
    start, way = np.asarray(start), np.asarray(way)
    axes.annotate(
        "", xy=(start[0] + way[0], start[1] + way[1]), xytext=start,
        arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": width, "shrinkA": 0, "shrinkB": 0},
    )  # fmt: skip
    if text:
        axes.text(start[0] + way[0] + shift[0], start[1] + way[1] + shift[1], text, color=colour)


def _basis_figure() -> Any:
    """Draw a force's components in polar axes, and two steps that do not commute."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.8, 3.7), layout="constrained")
    left, right = figure.subplots(1, 2)
    _draw_polar_axes(left)
    _draw_two_orders(right)
    for axes in (left, right):
        axes.set(xticks=[], yticks=[])
        axes.grid(False)
        axes.spines[:].set_visible(False)
    return figure


def _direction(angle: float) -> Array:
    """Return the unit vector at an angle [rad] from the x axis."""
    return np.array([np.cos(angle), np.sin(angle)])


def _draw_polar_axes(axes: Any) -> None:
    """Draw one force at three places on a circle of radius 1.6, with its component along e_2 there."""
    from examples.style import AXES, INK

    radius, force = 1.6, np.array([0.55, 0.0])
    for angle in np.radians([15, 50, 85]):
        out, along = _direction(angle), np.array([-np.sin(angle), np.cos(angle)])  # e_1, e_2
        at = radius * out
        _arrow(axes, at, 0.5 * out, AXES[0], text="$e_1$" if angle < 0.3 else "")
        _arrow(axes, at, 0.5 * along, AXES[1], text="$e_2$" if angle < 0.3 else "")
        _arrow(axes, at, force, INK, width=2.2, text="$F$" if angle > 1 else "", shift=(0.03, -0.04))
        axes.plot(*at, "o", color=INK, markersize=4)
        axes.text(*(at - 0.42 * out), f"$F_2={-np.sin(angle):.2f}$", fontsize=8, ha="center", va="center")
    arc = np.radians(np.linspace(0, 95, 60))
    axes.plot(radius * np.cos(arc), radius * np.sin(arc), color=INK, linewidth=0.7, alpha=0.5)
    axes.set(xlim=(-0.7, 2.7), ylim=(-0.15, 2.5), aspect="equal",
             title="one force F, three places: its component\non $e_2$ changes because $e_2$ turns")  # fmt: skip


def _draw_two_orders(axes: Any) -> None:
    """Draw a step of 1.5 along e_1 and a turn of 40 deg, in both orders."""
    from examples.style import AXES, INK

    _draw_walk(axes, ("step", "turn"), AXES[0], "-", "first along $e_1$, then turn", (-1.0, -0.32))
    _draw_walk(axes, ("turn", "step"), AXES[1], "--", "first turn, then along $e_1$", (-1.35, 0.45))
    axes.plot(0, 0, "o", color=INK, markersize=4)
    axes.set(xlim=(-0.4, 2.4), ylim=(-0.6, 2.0), aspect="equal",
             title="the same two steps of the tip's own axes,\nin the other order, end elsewhere")  # fmt: skip


def _draw_walk(
    axes: Any, moves: tuple[str, str], colour: str, style: str, label: str, shift: tuple[float, float]
) -> None:
    """Draw a walk of two moves from the origin, the axes at its end, and a label beside them."""
    from examples.style import AXES

    position, heading = np.zeros(2), 0.0
    for move in moves:
        if move == "step":
            step = 1.5 * _direction(heading)
            axes.plot(*np.array([position, position + step]).T, style, color=colour, linewidth=2)
            position = position + step
        else:
            heading += np.radians(40)
            arc = np.linspace(0, np.radians(40), 30)
            axes.plot(position[0] + 0.35 * np.cos(arc), position[1] + 0.35 * np.sin(arc), color=colour, linewidth=1)
    _arrow(axes, position, 0.4 * _direction(heading), AXES[0])
    _arrow(axes, position, 0.4 * _direction(heading + np.pi / 2), AXES[1])
    axes.text(*(position + shift), label, color=colour, fontsize=8)


def _tangent_figure() -> Any:
    """Draw the torque of a pendulum's spring, its tangent, and the tangent used as a secant."""
    from matplotlib.figure import Figure

    from examples.style import CORRECTED, INK, POTENTIAL

    figure = Figure(figsize=(7.8, 3.4), layout="constrained")
    axes = figure.subplots()
    angle = np.linspace(0, np.radians(150), 300)
    spring = pendulum_spring(angle)
    degrees = np.degrees(angle)
    axes.plot(
        degrees, -spring["torque"], color=POTENTIAL, linewidth=2, label=r"restoring torque of the energy, $k\sin q$"
    )
    axes.plot(degrees, -spring["secant_law"], color=CORRECTED, linewidth=2,
              label=r"its tangent used as a secant, $(k\cos q)\,q$")  # fmt: skip
    for at in np.radians([30, 75, 120]):
        here = pendulum_spring(np.array([at]))
        span = at + np.radians([-18, 18])
        line = -here["torque"] + here["tangent"] * (span - at)
        axes.plot(np.degrees(span), line, "--", color=INK, linewidth=1.2, label="tangent" if at < 1 else None)
        axes.plot(np.degrees(at), -here["torque"], "o", color=INK, markersize=4)
    axes.axhline(0, color=INK, linewidth=0.8)
    axes.annotate("pushes away", xy=(110, -0.66), xytext=(66, -1.0), arrowprops={"arrowstyle": "-|>", "color": INK})
    axes.set(xlabel="joint angle q from the equilibrium [deg]", ylabel="torque towards the equilibrium / k",
             xlim=(0, 150), ylim=(-1.4, 1.25))  # fmt: skip
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _orbit_figure() -> Any:
    """Draw the energy [J] that each law puts out over three laps of an orbit."""
    from matplotlib.figure import Figure

    from examples.style import CONVENTIONAL, INK, POTENTIAL, SHADES

    figure = Figure(figsize=(7.8, 3.3), layout="constrained")
    axes = figure.subplots()
    orientations, K = example_orbit(), np.diag([30.0, 30.0, 10.0])  # [N m/rad]
    colours = (CONVENTIONAL, SHADES[0], SHADES[1], POTENTIAL)
    for (name, law), colour, line in zip(LAWS.items(), colours, ("-", "--", ":", "-"), strict=True):
        lap = work(law, K, orientations)
        energy = np.concatenate([lap, lap[1:] + lap[-1], lap[1:] + 2 * lap[-1]])  # each lap adds the same work
        axes.plot(np.linspace(0, 3, len(energy))[::20], energy[::20], line, color=colour, linewidth=1.8, label=name)
    axes.axhline(0, color=INK, linewidth=0.8)
    axes.set(xlabel="laps", ylabel="energy put out by\nthe law [J]", xlim=(0, 3))
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _pair_figure() -> Any:
    """Draw the forces of three springs between two frames, by the place of their centre."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.8, 2.6), layout="constrained")
    apart, aside, angle, k = 0.4, 0.02, 0.1, 800.0  # [m], [m], [rad], [N/m]
    scale = 4.0  # of displacements and turns, which are small beside the distance
    a, b = np.zeros(2), np.array([apart, scale * aside])
    out = -_direction(scale * angle)  # from B towards A, in B's axes
    # where the spring pulls, and where that point is at rest, seen from the other frame
    places = {
        "A": (b, np.array([apart, 0.0])),
        "half-way": (b + apart / 2 * out, np.array([apart / 2, 0.0])),
        "B": (a, b + apart * out),
    }
    titles = {"A": "centre at B, seen from A", "half-way": "centre half-way", "B": "centre at A, seen from B"}
    forces = pair_forces(aside, angle, apart, k)
    for axes, (name, (there, wanted)) in zip(figure.subplots(1, 3), places.items(), strict=True):
        _draw_frames(axes, a, b, apart, out)
        _draw_pull(axes, there, wanted, is_pulled=abs(forces[name]) > 1)
        pull = f"{forces[name]:.0f} N" if abs(forces[name]) > 1 else "no force"
        axes.set(
            xlim=(-0.06, 0.46), ylim=(-0.12, 0.14), aspect="equal", title=f"{titles[name]}: {pull}", xticks=[],
            yticks=[],
        )  # fmt: skip
        axes.grid(False)
        axes.spines[:].set_visible(False)
    return figure


def _draw_frames(axes: Any, a: Array, b: Array, apart: float, out: Array) -> None:
    """Draw tips A and B, and the first axis of each over the distance at rest."""
    from examples.style import AXES, INK

    axes.plot([0, apart], [0, 0], color=AXES[0], linewidth=2)
    axes.plot(*np.array([b, b + apart * out]).T, color=AXES[1], linewidth=2)
    for point, letter in ((a, "A"), (b, "B")):
        axes.plot(*point, "o", color=INK, markersize=5)
        axes.text(point[0], point[1] + 0.025, letter, ha="center", color=INK)


def _draw_pull(axes: Any, there: Array, wanted: Array, *, is_pulled: bool) -> None:
    """Draw the displacement that a spring pulls back, or a dot where there is none."""
    from examples.style import CORRECTED

    if is_pulled:
        _arrow(axes, there, wanted - there, CORRECTED, width=2)
    else:
        axes.plot(*there, "o", color=CORRECTED, markersize=6)


def main() -> None:
    """Print the tables, and draw the figures of docs/theory.md with --figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figures", action="store_true", help="draw docs/theory_*.svg")
    options = parser.parse_args()
    from generated import iiwa14

    print(tables(iiwa14))
    if options.figures:
        for name, svg in draw().items():
            (ROOT / "docs" / name).write_text(svg)


if __name__ == "__main__":
    main()
