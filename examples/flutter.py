# SPDX-License-Identifier: MIT
"""Push a ball joint that three position drives hold: it flutters. The gradient of an energy lets it rest.

Simulators drive a ball joint by three position drives: kp times the difference of rotation vectors, c - phi(R), as a
torque about the body's axes. At its target c this drive has the stiffness kp Jr^-1(c), whose antisymmetric part
(kp / 2) [c]x feeds a motion round the target. Two motions across c have the complex stiffness
kp (a +- i |c| / 2), a = (|c| / 2) cot(|c| / 2). They grow if the damping ratio is below

    |c| / (4 sqrt(a))        about |c| / 4 for small targets

The gradient of the energy kp |log(R0^T R)|^2 / 2 is the same law with the rotation vector of the difference. Both are
simulated in MuJoCo: the first with its own <position> actuators, the second as an applied torque (stiffgen.drive).

A shoulder and a hip follow, ball joints of a body of two limbs (limbs.xml) at targets of three degrees of freedom, and
laws of operational space on a ball wrist (wrist.py).

With --figure FILE the example writes flutter.svg (needs matplotlib: pip install -e '.[examples,mjcf]').
"""

from __future__ import annotations

import argparse
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from examples import wrist
from stiffgen import drive

Array = NDArray[np.float64]

INERTIA = 0.01  # kg m^2
STIFFNESS = 10.0  # N m/rad
STEP = 0.0002  # s
PUSH = 0.027  # rad, across the target
CASES = ((0.3, 0.05), (0.3, 0.086), (0.9, 0.20), (1.8, 0.05), (1.8, 0.20))
"""Target [rad] and damping ratio."""
TARGETS = (0.3, 0.6, 0.9, 1.2, 1.8)
DRIVES, GRADIENT = "three drives", "gradient"
LAWS = (DRIVES, GRADIENT)
MODEL = """<mujoco><option timestep="{step}" integrator="RK4" gravity="0 0 0"/><worldbody><body>
<joint name="ball" type="ball" damping="{damping}"/><inertial pos="0 0 0" mass="1" diaginertia="{inertia}"/>
</body></worldbody><actuator>{drives}</actuator></mujoco>"""
XYZW = [1, 2, 3, 0]  # the order of stiffgen.drive, from MuJoCo's (w, x, y, z)
DRIVE = '<position joint="ball" kp="{}" gear="{} 0 0 0"/>'


def limit(target: float) -> float:
    """Return the damping ratio below which three drives flutter about a target [rad] (docs/flutter.md)."""
    return float(target / (4 * np.sqrt(target / 2 / np.tan(target / 2))))


def simulate(target: float, ratio: float, law: str, seconds: float = 6.0, every: int = 100) -> Array:
    """Return the angle [rad] to a target about z [rad] after a push about x, each ``every`` steps from the first on."""
    model = _ball(ratio, law)
    data = mujoco.MjData(model)
    aim = _quaternion(np.array([0.0, 0.0, 1.0]), target)
    mujoco.mju_mulQuat(data.qpos, aim, _quaternion(np.array([1.0, 0.0, 0.0]), PUSH))
    if law == DRIVES:
        data.ctrl[:] = 0.0, 0.0, target
    angles, K = [], STIFFNESS * np.eye(3)
    for step in range(round(seconds / STEP) + 1):
        if law == GRADIENT or step % every == 0:
            torque = drive.torque(data.qpos[XYZW], aim[XYZW], K, "log")  # of the size stiffness * angle
        if step % every == 0:
            angles.append(np.linalg.norm(torque) / STIFFNESS)
        if law == GRADIENT:
            data.qfrc_applied[:] = torque
        mujoco.mj_step(model, data)
    return np.array(angles)


def _ball(ratio: float, law: str) -> mujoco.MjModel:
    """Return a ball joint with a damping ratio, and with MuJoCo's drives about x, y and z for the law DRIVES."""
    damping = 2 * ratio * np.sqrt(STIFFNESS * INERTIA)
    drives = "".join(DRIVE.format(STIFFNESS, axis) for axis in ("1 0 0", "0 1 0", "0 0 1")) if law == DRIVES else ""
    inertia = " ".join([str(INERTIA)] * 3)
    return mujoco.MjModel.from_xml_string(MODEL.format(step=STEP, damping=damping, inertia=inertia, drives=drives))


def _quaternion(axis: Array, angle: float) -> Array:
    """Return MuJoCo's quaternion (w, x, y, z) of a turn about a unit vector by an angle [rad]."""
    quaternion = np.zeros(4)
    mujoco.mju_axisAngle2Quat(quaternion, axis, angle)
    return quaternion


def rows() -> list[tuple[str, ...]]:
    """Return the table: target, damping ratio, its limit, angle after 6 s of both laws."""
    made = []
    for target, ratio in CASES:
        last = (float(simulate(target, ratio, law)[-1]) for law in LAWS)
        angles = ("below 1e-4 rad" if each < 1e-4 else f"{each:.2g} rad" for each in last)
        made.append((f"{target:g} rad", f"{ratio:g}", f"{limit(target):.3f}", *angles))
    return made


LIMBS = Path(__file__).with_name("limbs.xml")
POSTURES = {
    "shoulder": ((0.2, 0.3, 1.2), 60.0, 0.05),
    "hip": ((0.3, -0.3, 0.9), 300.0, 0.05),
}
"""Target [rad], stiffness [N m/rad], and damping ratio of the slowest axis, by joint of limbs.xml."""


def watch_limb(joint: str, law: str, seconds: float = 12.0, every: int = 40) -> tuple[Array, Array]:
    """Push a limb by PUSH across its target, and watch it each ``every`` steps of 1 ms.

    Returns:
        Angle to the target (k) [rad], and joint, knee or elbow, and end of the limb (k, 3, 3) [m].

    """
    target, stiffness, ratio = POSTURES[joint]
    model = _limbs(joint, law, stiffness)
    data, adr, first = mujoco.MjData(model), model.joint(joint).qposadr[0], model.joint(joint).dofadr[0]
    place, dofs = slice(adr, adr + 4), slice(first, first + 3)
    aim = _quaternion(np.array(target) / np.linalg.norm(target), float(np.linalg.norm(target)))
    across = np.cross(target, [1.0, 1.0, 1.0])  # an axis perpendicular to the target's
    mujoco.mju_mulQuat(data.qpos[place], aim, _quaternion(across / np.linalg.norm(across), PUSH))
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    largest_inertia = np.linalg.eigvalsh(M[dofs, dofs])[-1]  # of the slowest axis, whose ratio is stated
    model.dof_damping[dofs] = 2 * ratio * np.sqrt(stiffness * largest_inertia)
    data.ctrl[:] = target if law == DRIVES else ()
    body, angles, points = model.joint(joint).bodyid[0], list[float](), list[Array]()
    for step in range(round(seconds / model.opt.timestep) + 1):
        # The form "log" has the torque stiffness * angle: its size gives the angle under both laws.
        torque = drive.torque(data.qpos[place][XYZW], aim[XYZW], stiffness * np.eye(3), "log")
        if step % every == 0:
            mujoco.mj_kinematics(model, data)
            angles.append(float(np.linalg.norm(torque) / stiffness))
            points.append(_points(model, data, body))
        if law == GRADIENT:
            data.qfrc_applied[dofs] = torque
        mujoco.mj_step(model, data)
    return np.array(angles), np.array(points)


def _limbs(joint: str, law: str, stiffness: float) -> mujoco.MjModel:
    """Return the limbs, with MuJoCo's drives about the axes of a joint for the law DRIVES."""
    spec = mujoco.MjSpec.from_file(str(LIMBS))
    if law == DRIVES:
        for axis in np.eye(3):
            drive_of_axis = spec.add_actuator(target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT, gear=[*axis, 0, 0, 0])
            drive_of_axis.set_to_position(kp=stiffness)
    return spec.compile()


def _points(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> Array:
    """Return the places (3, 3) [m] of a limb's joint, of its knee or elbow, and of its end.

    The lower part is the body behind the upper one, and its geom is half-way from the knee to the end.
    """
    knee = data.xpos[body + 1].copy()
    return np.array([data.xpos[body], knee, 2 * data.geom_xpos[model.body_geomadr[body + 1]] - knee])


def limb_rows() -> list[tuple[str, ...]]:
    """Return the table of both limbs: joint, target, stiffness, damping ratio, largest angle of the last 2 s."""
    made = []
    for joint, (target, stiffness, ratio) in POSTURES.items():
        angles = (
            f"{angle:.2g} rad" if angle > 1e-3 else "below 1e-3 rad"
            for angle in (watch_limb(joint, law)[0][-50:].max() for law in LAWS)
        )
        made.append((joint, f"{np.linalg.norm(target):.2f} rad", f"{stiffness:g} N m/rad", f"{ratio:g}", *angles))
    return made


def figure() -> str:
    """Return the SVG text: angle over time of both laws; where three drives flutter, by target and damping ratio."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from examples.style import CONVENTIONAL, CORRECTED, INK, STYLE, themed_svg

    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(7.5, 3.6), layout="constrained")
        left, right = drawing.subplots(1, 2)
        for law, colour in zip(LAWS, (CONVENTIONAL, CORRECTED), strict=True):
            angles = simulate(*CASES[0], law)
            left.semilogy(np.linspace(0, 6, len(angles)), np.maximum(angles, 1e-7), color=colour, label=law)
        left.set(xlabel="time since the push [s]", ylabel="angle to the target [rad]", ylim=(1e-6, 4))
        left.set_title("target 0.3 rad, damping ratio 0.05")
        left.legend(loc="center right")
        targets = np.linspace(0.05, 2.0, 60)
        right.plot(targets, [limit(target) for target in targets], color=INK, label="limit by linearisation")
        for share, grows, marker, colour, label in (
            (0.9, True, "o", CONVENTIONAL, "flutters in MuJoCo"),
            (1.1, False, "s", CORRECTED, "comes to rest"),
        ):
            ratios = [share * limit(target) for target in TARGETS]
            grown = [simulate(target, ratio, DRIVES)[-1] > PUSH for target, ratio in zip(TARGETS, ratios, strict=True)]
            if grown != [grows] * len(TARGETS):
                raise ArithmeticError(f"the limit is not where the drives flutter: {grown} at {share} of it")
            right.plot(TARGETS, ratios, marker, color=colour, markersize=5, label=label)
        right.set(xlabel="target [rad]", ylabel="damping ratio", title="three drives", ylim=(0, None))
        right.legend(loc="upper left")
        return themed_svg(drawing)


def main() -> None:
    """Print the table; draw the figure if requested."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figure", type=Path, metavar="FILE", help="also draw an SVG")
    parser.add_argument("--film", type=Path, metavar="FILE", help="also draw the limbs as an SVG that moves")
    options = parser.parse_args()
    print(*(f"{word:>14}" for word in ("target", "damping ratio", "limit", *LAWS)))
    for row in rows():
        print(*(f"{value:>14}" for value in row))
    print()
    for row in limb_rows():
        print(*(f"{value:>14}" for value in row))
    print()
    for row in wrist.rows():
        print(" | ".join(row))
    if options.figure:
        options.figure.write_text(figure())
    if options.film:
        from examples.film import film

        options.film.write_text(film())


if __name__ == "__main__":
    main()
