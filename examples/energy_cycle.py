"""Net work of joint stiffness round closed orbits at a held wrench, corrected and conventional, on the iiwa 14.

The paper's problem statement, quasi-statically: a spring whose torque field is tau = -K dq gives back what it took
exactly if K is symmetric. Otherwise, round a circle of radius r in the plane of two unit directions u and v,

    W = integral of tau . dq = integral over the area of the antisymmetric part = 2 pi r^2 u^T A v,   A = (K - K^T)/2.

First with the stiffness held at one posture and wrench: the statement as it is. Then with the stiffness following the
posture, as a controller has it: the corrected stiffness is then no longer conservative either (K varies along
the way), but its work grows with r^3, not r^2.

Writes energy_cycle.svg with --figure FILE (needs matplotlib: pip install 'stiffgen[examples]').
"""

import argparse
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from generated import iiwa14  # noqa: E402

TRAJECTORY = ROOT / "examples" / "bowl_wiping" / "zero_force_trajectory.csv"
TASK_STIFFNESS = np.diag([700.0, 700.0, 800.0, 30.0, 30.0, 30.0])  # N/m and N m/rad
WRENCH = np.array([5.0, -10.0, 15.0, 4.0, -3.0, 8.0])  # N and N m, applied by the environment, held
PLANES = ((0, 2), (4, 5), (1, 3), (2, 6))  # joint pairs (0-based) that span the orbits
STEPS = 20000
FORMULAS = {"corrected": iiwa14.hybrid.joint_stiffness, "conventional": iiwa14.hybrid.joint_stiffness_uncorrected}


def orbit(plane: tuple[int, int], radius: float, steps: int = STEPS) -> np.ndarray:
    """Displacements (steps + 1, n) round a circle through zero, first along u, then towards v [rad]."""
    phase = 2 * np.pi * np.arange(steps + 1)[:, None] / steps
    u, v = np.eye(iiwa14.DOF)[list(plane)]
    return np.asarray(radius * (np.sin(phase) * u + (1 - np.cos(phase)) * v))


def work(stiffness: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    """Work [J] that tau = -K dq has done up to each point of an orbit, by the trapezoidal rule."""
    torque = -np.einsum("...ij,...j->...i", stiffness, displacement)
    middle = (torque[1:] + torque[:-1]) / 2
    return np.concatenate([[0.0], np.cumsum(np.einsum("ti,ti->t", middle, np.diff(displacement, axis=0)))])


def held(q: np.ndarray, plane: tuple[int, int], radius: float, formula: str) -> np.ndarray:
    return work(FORMULAS[formula](q, WRENCH, TASK_STIFFNESS), orbit(plane, radius))


def following(q: np.ndarray, plane: tuple[int, int], radius: float, formula: str) -> np.ndarray:
    displacement = orbit(plane, radius)
    return work(FORMULAS[formula](q + displacement, WRENCH, TASK_STIFFNESS), displacement)


def area_integral(q: np.ndarray, plane: tuple[int, int], radius: float, formula: str) -> float:
    K = FORMULAS[formula](q, WRENCH, TASK_STIFFNESS)
    u, v = plane
    return float(np.pi * radius**2 * (K[u, v] - K[v, u]))


def table(q: np.ndarray) -> None:
    radius = 0.1
    print(f"iiwa14 at q [rad] = {np.round(q, 3)}")
    print(f"wrench applied by the environment, held [N, N m] = {WRENCH}; orbits of radius {radius} rad")
    print(f"\n{'':8s}{'stiffness held: net work and area integral [J]':^62s}   {'stiffness follows q [J]':^26s}")
    print(f"{'joints':8s}{'corrected':>14s}{'integral':>14s}{'conventional':>18s}{'integral':>14s}   ", end="")
    print(f"{'corrected':>12s}{'conventional':>14s}")
    for plane in PLANES:
        row = f"{plane[0] + 1}, {plane[1] + 1}    "
        for formula, width in (("corrected", 14), ("conventional", 18)):
            row += f"{held(q, plane, radius, formula)[-1]:{width}.3e}{area_integral(q, plane, radius, formula):14.6f}"
        row += "   " + "".join(
            f"{following(q, plane, radius, formula)[-1]:{width}.5f}"
            for formula, width in (("corrected", 12), ("conventional", 14))
        )
        print(row)
    plane = PLANES[0]
    print("\nGrowth with the radius, stiffness follows q (exponent of r between 0.01 and 0.02 rad):")
    for formula in FORMULAS:
        small, large = (abs(following(q, plane, radius, formula)[-1]) for radius in (0.01, 0.02))
        print(f"  {formula:14s}{np.log2(large / small):6.3f}")


def figure(q: np.ndarray, file: Path) -> None:
    import matplotlib as mpl

    mpl.use("svg")
    mpl.rcParams["svg.hashsalt"] = "energy_cycle"  # the same bytes every time
    import matplotlib.pyplot as plt

    plane, colours = PLANES[0], {"corrected": "#0072b2", "conventional": "#d55e00"}
    below = {"frameon": False, "loc": "upper center", "bbox_to_anchor": (0.5, -0.16), "ncols": 3, "columnspacing": 1.2}
    _, (left, right) = plt.subplots(1, 2, figsize=(9.5, 4.1), layout="constrained")
    turns = np.arange(3 * STEPS + 1) / STEPS
    for formula, colour in colours.items():
        once = held(q, plane, 0.1, formula)
        thrice = np.concatenate([once[:-1] + k * once[-1] for k in range(3)] + [[3 * once[-1]]])
        left.plot(turns[::50], thrice[::50], color=colour, label=formula)
    left.set(xlabel="orbits", ylabel="work put out [J]", title="stiffness held, radius 0.1 rad")
    left.axhline(0, color="0.6", linewidth=0.6)
    for k in range(1, 4):
        left.plot(k, k * area_integral(q, plane, 0.1, "conventional"), "o", color="0.2", markersize=4,
                  label="area integral" if k == 1 else None)  # fmt: skip
    left.legend(**below)
    radii = np.geomspace(0.005, 0.1, 10)
    for formula, colour in colours.items():
        values = [abs(following(q, plane, radius, formula)[-1]) for radius in radii]
        right.loglog(radii, values, "o-", color=colour, markersize=3, label=formula)
    right.loglog(radii, [abs(area_integral(q, plane, r, "conventional")) for r in radii], ":", color="0.2",
                 label="area integral")  # fmt: skip
    right.set(xlabel="radius [rad]", ylabel="|net work of an orbit| [J]", title="stiffness follows the posture")
    right.legend(**below)
    plt.savefig(file, metadata={"Date": None, "Creator": None})
    plt.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figure", type=Path, metavar="FILE", help="also draw an SVG")
    options = parser.parse_args()
    trajectory = np.loadtxt(TRAJECTORY, delimiter=",")
    q = trajectory[:, trajectory.shape[1] // 2]
    table(q)
    if options.figure:
        figure(q, options.figure)


if __name__ == "__main__":
    main()
