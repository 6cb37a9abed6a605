# SPDX-License-Identifier: MIT
"""Two arms hold one box: springs between the hands and absolute springs of both, in MuJoCo.

    python -m examples.two_arms                prints the box's errors, the internal force, and the work of a lap
    python -m examples.two_arms --figure FILE  draws them
    python -m examples.two_arms --arm panda    with two Pandas in place of two iiwa 14; or ur5

Two arms on a stand press a box of 2 kg between their hands, lift it, and turn it by 90 degrees, until one hand is on
top of the box and the other below. A person pushes the box with 30 N. The frame of the object is 5 mm and 3 degrees
off in one hand. The hands only touch the box: nothing but friction holds it.
"""

from __future__ import annotations

import argparse
import re
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

import stiffgen

Array = NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Arm:
    """Kind of the two arms, and where they hold the box: so that joints are far from their limits all along.

    Attributes:
        urdf: file of one arm.
        tip: link whose z axis points into the box.
        gap: place [m] of a base along y.
        tilt: tilt outwards [rad] of a base.
        start: joint positions [rad] of both from which the first posture is searched.
        place: place [m] of the box.
        yaw: the hands' turn about the axis between them [rad].

    """

    urdf: Path
    tip: str
    gap: float
    tilt: float
    start: tuple[float, ...]
    place: tuple[float, float, float]
    yaw: float


IIWA = Arm(
    ROOT / "urdf" / "iiwa14.urdf", "link_ee", 0.15, 0.5236,
    (0.53, 1.32, -0.94, -1.32, -0.18, 0.85, -1.01, 0.04, 1.08, -0.11, -1.32, -1.88, -1.27, -2.66),
    (0.641, 0.0, 0.224), 1.885,
)  # fmt: skip
PANDA = Arm(
    ROOT / "tests" / "data" / "panda.urdf", "panda_hand_tcp", 0.112, 0.143,
    (0.95, -0.09, -0.37, -2.45, -1.05, 1.27, 0.88, -0.73, -0.08, 0.15, -2.45, 1.05, 1.29, 0.70),
    (0.374, 0.0, 0.332), -0.843,
)  # fmt: skip
UR5 = Arm(
    ROOT / "tests" / "data" / "ur5.urdf", "tool0", 0.374, 0.885,
    (-1.17, 1.15, -2.30, -1.07, -1.82, -2.44, -1.97, 2.44, 1.85, 1.07, -1.82, 2.44), (0.260, 0.0, 0.333), 0.390,
)  # fmt: skip
ARMS = {"iiwa14": IIWA, "panda": PANDA, "ur5": UR5}
SIDES = {"left": 1.0, "right": -1.0}
"""Names of the arms, and their sides along y."""

WIDTH, MASS, PAD = 0.3, 2.0, 0.02
"""Box: width [m] between the hands, mass [kg]; thickness [m] of the rubber pads on the flanges."""
FRICTION, ROTOR, STEP = 1.0, 0.3, 1e-3
"""Friction of the pads, inertia of the rotors [kg m^2], sample time [s]."""
SQUEEZE, PUSH = 20.0, 30.0
"""Internal force, and force of the person along x [N]."""
OFF, TURNED = 0.005, np.radians(3.0)
"""Error of the object's frame in the right hand [m, rad]."""
BETWEEN, ABSOLUTE = (400.0, 20.0), (800.0, 40.0)
"""Stiffness between the hands, and of both in the base [N/m, N m/rad]."""
LIFT, TURN, PUSHED, END = (1.0, 2.5), (2.5, 7.0), (8.0, 8.6), 10.0
"""Beginning and end of the parts of the session [s]."""
SQUEEZED, CARRIED, RAMP = (0.0, 0.3), (0.3, 0.9), 0.1
"""[s] In which the hands begin to squeeze and take over the weight, and in which the push grows and falls."""
GRAVITY = 9.81
"""Acceleration of free fall [m/s^2]."""


def described(arm: Arm = IIWA) -> str:
    """Return the URDF of the stand with both arms; fingers stay where they are."""
    inner = re.sub(
        r"<robot[^>]*>|</robot>|<\?xml.*?\?>|<!--.*?-->|<mimic[^>]*>", "", arm.urdf.read_text(), flags=re.DOTALL
    )
    inner = inner.replace('type="prismatic"', 'type="fixed"')
    children = re.findall(r'<child\s+link="([^"]*)"', inner)
    (root,) = (link for link in re.findall(r'<link\s+name="([^"]*)"', inner) if link not in children)
    arms = []
    for side, sign in SIDES.items():
        named = re.sub(r'\b(name|link|joint)="([^"]*)"', rf'\1="{side}_\2"', inner)  # every name with its side
        joint = f'<joint name="{side}_stand" type="fixed"><parent link="stand"/><child link="{side}_{root}"/>'
        origin = f'<origin xyz="0 {sign * arm.gap} 0" rpy="{-sign * arm.tilt} 0 0"/>'
        arms.append(f"{named}{joint}{origin}</joint>")
    return f'<robot name="two_arms"><link name="stand"/>{"".join(arms)}</robot>'


def generated(folder: Path, arm: Arm = IIWA) -> tuple[Any, Path]:
    """Return the module of both arms, generated in a folder, and the URDF."""
    file = folder / "two_arms.urdf"
    file.write_text(described(arm))
    tips = [f"{side}_{arm.tip}" for side in SIDES]
    made = stiffgen.generate(file, output=folder, tip=tips, pairs=[":".join(tips)], batches=False)
    return stiffgen.open_robot(made).module, file


def scene(file: Path, arm: Arm = IIWA) -> mujoco.MjModel:
    """Return the arms with pads on their flanges, and the box, which floats until it is held."""
    spec = mujoco.MjSpec.from_file(str(file))
    spec.option.timestep, spec.option.integrator = STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone, spec.option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 10.0
    spec.compiler.fusestatic = False
    for joint in spec.joints:
        joint.armature = ROTOR
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0  # only pads and box touch
    soft = {"solref": [0.01, 1.0], "friction": [FRICTION, 0.02, 1e-4], "condim": 4}
    for side in SIDES:
        spec.body(f"{side}_{arm.tip}").add_geom(
            name=f"{side}_pad", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.04, 0.04, PAD / 2], pos=[0, 0, PAD / 2],
            mass=0.0, contype=1, conaffinity=1, rgba=[0.2, 0.2, 0.2, 1], **soft,
        )  # fmt: skip
    box = spec.worldbody.add_body(name="box", pos=arm.place)
    box.add_freejoint()
    box.add_geom(
        name="box", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, WIDTH / 2, 0.1], mass=MASS, rgba=[0.8, 0.6, 0.3, 1],
        **soft,
    )  # fmt: skip
    return spec.compile()


def turned(axis: int, angle: float) -> Array:
    """Return a pose at the origin, turned about a coordinate axis."""
    c, s, (j, k) = np.cos(angle), np.sin(angle), ((axis + 1) % 3, (axis + 2) % 3)
    pose = np.eye(4)
    pose[j, j] = pose[k, k] = c
    pose[k, j], pose[j, k] = s, -s
    return pose


def placed(x: float, y: float, z: float) -> Array:
    """Return a pose without rotation."""
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def grasps(arm: Arm = IIWA) -> Array:
    """Return the poses of both hands in the object (2, 4, 4): their z axes point into the box."""
    away = WIDTH / 2 + PAD
    return np.array(
        [placed(0, sign * away, 0) @ turned(0, sign * np.pi / 2) @ turned(2, sign * arm.yaw) for sign in SIDES.values()]
    )


def smooth(time: float, span: tuple[float, float]) -> float:
    """Return the share of a motion of minimum jerk."""
    s = min(max((time - span[0]) / (span[1] - span[0]), 0.0), 1.0)
    return s**3 * (10 - 15 * s + 6 * s**2)


def wanted(time: float, arm: Arm = IIWA) -> Array:
    """Return the pose of the object: lifted by 0.1 m, then turned by 90 degrees about x."""
    lifted = np.array(arm.place) + np.array([0.0, 0.0, 0.1 * smooth(time, LIFT)])
    return placed(*lifted) @ turned(0, np.pi / 2 * smooth(time, TURN))


@dataclass
class BoxSession:
    """Records of a session, one row per sample.

    Attributes:
        time: [s].
        error: distance [m] and angle [rad] of the box from its wanted pose.
        internal: force [N] that the hands press together with, by least squares from both contacts.
        contacts: number of hands that touch the box.
        faults: number of samples in a fault.

    """

    time: Array
    error: Array
    internal: Array
    contacts: Array
    faults: int


def contact_wrenches(model: mujoco.MjModel, data: mujoco.MjData, origins: Array) -> tuple[Array, Array]:
    """Return the wrenches of the box on both hands (2, 6) at their origins, base axes, and which of them touch it."""
    local = np.zeros((data.ncon, 6))  # on each contact's second geom, in the contact's axes
    for k in range(data.ncon):
        mujoco.mj_contactForce(model, data, k, local[k])
    axes = data.contact.frame.reshape(-1, 3, 3)  # rows: the contact's axes in base axes
    force, moment = (np.einsum("kji,kj->ki", axes, part) for part in (local[:, :3], local[:, 3:]))
    wrenches, touches = np.zeros((2, 6)), np.zeros(2, bool)
    for hand, side in enumerate(SIDES):
        is_pad = data.contact.geom == model.geom(f"{side}_pad").id  # (contacts, 2): first and second geom
        sign = is_pad[:, 1:].astype(float) - is_pad[:, :1]  # 0 for a contact of other geoms
        about_hand = moment + np.cross(data.contact.pos - origins[hand], force)
        wrenches[hand] = *(sign * force).sum(axis=0), *(sign * about_hand).sum(axis=0)
        touches[hand] = is_pad.any()
    return wrenches, touches


def springs() -> dict[str, Array]:
    """Return the stiffnesses: none at single tips, the pair's, the absolute one's."""
    values = np.array([(0.0, 0.0), (0.0, 0.0), BETWEEN, ABSOLUTE])
    names = ("translation_stiffness", "rotation_stiffness")
    return {name: values[:, k, None, None] * np.eye(3) for k, name in enumerate(names)}


def run(module: Any, file: Path, arm: Arm = IIWA, end: float = END) -> BoxSession:
    """Hold, lift, turn and push the box for `end` seconds in simulation, and return the session's rows."""
    model = scene(file, arm)
    data, held = mujoco.MjData(model), grasps(arm)
    joints = [model.joint(name) for name in module.JOINTS]
    at, rate = (np.array([getattr(j, which)[0] for j in joints]) for which in ("qposadr", "dofadr"))
    # The controller's grasps: the right hand is believed to be OFF [m] and TURNED [rad] from where it is.
    believed = held @ np.array([np.eye(4), placed(OFF, 0, 0) @ turned(1, TURNED)])
    q = np.asarray(module.find_posture(wanted(0.0, arm) @ held, arm.start))
    data.qpos[at] = q
    data.qpos[-7:-4] = arm.place
    data.qpos[-4:] = 1.0, 0.0, 0.0, 0.0
    mujoco.mj_forward(model, data)
    follow = module.Follow(q, sample_time=STEP)
    stated = {"sample_time": STEP, "delay_samples": 0, "motor_inertia": ROTOR, "heaviest_wrench": [80.0, 20.0]}
    arms, stiff, rows, faults = module.Impedance(**stated, errors="raise"), springs(), [], 0
    for k in range(round(end / STEP)):
        time, q, dq = k * STEP, data.qpos[at], data.qvel[rate]
        q0, _ = follow.step(pose=wanted(time, arm) @ believed)
        out = arms.step(
            counter=k, q=q, dq=dq, q0=q0, shaped=True, posture_stiffness=2.0, wrench_command=_commanded_wrench(time),
            torque_offset=data.qfrc_bias[rate], **stiff,
        )  # fmt: skip
        data.qfrc_applied[rate] = out.torque
        _push_box(model, data, time)
        mujoco.mj_step(model, data)
        faults += bool(out.fault)
        rows.append((time, *_observed(model, data, arm, time)))
    table = np.array(rows)
    return BoxSession(time=table[:, 0], error=table[:, 1:3], internal=table[:, 3], contacts=table[:, 4], faults=faults)


def _carried_weight(time: float) -> float:
    """Return the weight [N] of the box that the hands carry: none at first, then all."""
    return MASS * GRAVITY * smooth(time, CARRIED)


def _commanded_wrench(time: float) -> Array:
    """Return the commanded wrenches (3, 6) [N, N m]: left hand, right hand (base axes), and the pair's own.

    The pair's acts on the right hand, along the z axis of the left one, and squeezes the box.
    """
    wrench = np.zeros((3, 6))
    wrench[2, 2] = -SQUEEZE * smooth(time, SQUEEZED)
    wrench[:2, 2] = _carried_weight(time) / 2
    return wrench


def _push_box(model: mujoco.MjModel, data: mujoco.MjData, time: float) -> None:
    """Apply the forces of others on the box: a person's push along x, and a table under it."""
    force = data.xfrc_applied[model.body("box").id]
    force[:] = 0.0
    has_begun, has_ended = smooth(time, (PUSHED[0], PUSHED[0] + RAMP)), smooth(time, (PUSHED[1] - RAMP, PUSHED[1]))
    force[0] = PUSH * (has_begun - has_ended)
    force[2] = MASS * GRAVITY - _carried_weight(time)  # what the hands do not yet carry


def _observed(model: mujoco.MjModel, data: mujoco.MjData, arm: Arm, time: float) -> tuple[Any, ...]:
    """Return distance [m] and angle [rad] of the box from its wanted pose, internal force [N], and hands in touch."""
    origins = np.array([data.body(f"{side}_{arm.tip}").xpos for side in SIDES])
    wrenches, touches = contact_wrenches(model, data, origins)
    frames = np.tile(np.eye(4), (2, 1, 1))
    frames[:, :3, 3] = origins
    # The squeeze: the part of both wrenches that cancels in the sum.
    internal = stiffgen.internal_wrench(*wrenches, *frames).internal
    R, goal = data.body("box").xmat.reshape(3, 3), wanted(time, arm)
    angle = np.arccos(np.clip((np.trace(R.T @ goal[:3, :3]) - 1) / 2, -1, 1))
    away = np.linalg.norm(data.body("box").xpos - goal[:3, 3])
    return away, angle, np.linalg.norm(internal[:3]), touches.sum()


def usual_torque(module: Any, q: Array, rest: Array, K: Array, arm: Arm = IIWA) -> Array:
    """Return the torque (n) [N m] of the usual law: K (6, 6) times displacement and rotation vector of B in A."""
    hands = [getattr(module, f"{side}_{arm.tip}") for side in SIDES]
    a, b = (hand.forward_kinematics(q) for hand in hands)
    Ja, Jb = (hand.hybrid.jacobian(q) for hand in hands)
    seen = np.linalg.inv(rest) @ np.linalg.inv(a) @ b  # pose of B seen from where it rests
    axes = a[:3, :3] @ rest[:3, :3]  # of the frame where B rests, in base axes
    force = axes @ K[:3, :3] @ seen[:3, 3]
    moment = axes @ K[3:, 3:] @ _rotation_vector(seen[:3, :3])
    lever = b[:3, 3] - a[:3, 3]
    on_b = -np.concatenate([force, moment])
    on_a = np.concatenate([force, moment + np.cross(lever, force)])  # the reaction, about A's origin
    return np.asarray(Jb.T @ on_b + Ja.T @ on_a)


def _rotation_vector(R: Array) -> Array:
    """Return the rotation vector [rad] of a rotation by less than half a turn."""
    w = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2  # sine times the unit axis
    sine, cosine = np.linalg.norm(w), (np.trace(R) - 1) / 2
    return np.asarray(w * (np.arctan2(sine, cosine) / sine if sine > 0 else 1.0))


def work_of_lap(module: Any, arm: Arm = IIWA, size: float = 0.4, nodes: int = 400) -> tuple[float, float]:
    """Return the work [J] of the usual law and of the pair's spring round one closed lap of all joints."""
    random = np.random.default_rng(2)
    middle = np.asarray(module.find_posture(wanted(0.0, arm) @ grasps(arm), arm.start))
    waves = random.normal(size=(2, len(middle))) * size / 2
    t = 2 * np.pi * np.arange(nodes)[:, None] / nodes
    q = middle + np.cos(t) * waves[0] + np.sin(t) * waves[1]  # (nodes, n) [rad], an ellipse in joint space
    rate = np.cos(t) * waves[1] - np.sin(t) * waves[0]  # dq/dt
    K = np.diag([400.0, 300.0, 500.0, 30.0, 20.0, 10.0])
    rest = np.linalg.inv(grasps(arm)[0]) @ grasps(arm)[1]

    def work(torque_at: Callable[[Array], Array]) -> float:
        """Return the integral of torque times rate over t: the trapezoidal rule of a periodic function."""
        powers = (float(torque_at(at) @ along) for at, along in zip(q, rate, strict=True))
        return sum(powers) * 2 * np.pi / nodes

    usual = work(lambda at: usual_torque(module, at, rest, K, arm))
    exact = work(lambda at: module.pair.torque(at, rest, K[:3, :3], K[3:, 3:]))
    return usual, exact


def told(session: BoxSession, work: tuple[float, float]) -> str:
    """Return the results of a session in lines; `work` [J] is that of both laws round a lap."""
    time, internal = session.time, session.internal
    held = (time > 0.9) & (time < PUSHED[0])  # from the moment on at which the hands carry the whole weight
    rest = (time > PUSHED[0] - 0.3) & (time < PUSHED[0])  # lifted and turned
    away, angle = 1e3 * session.error[:, 0], np.degrees(session.error[:, 1])
    last = time > END - 0.2
    return "\n".join(
        [
            f"both hands touch the box: {100 * (session.contacts[time > 0.2] == 2).mean():.1f} % of the time; "
            f"samples in a fault: {session.faults}",
            f"internal force before the push: {internal[held].min():.1f} to {internal[held].max():.1f} N, "
            f"{100 * (np.abs(internal[held] / SQUEEZE - 1) <= 0.15).mean():.1f} % of the time within 15 %",
            f"box at rest: {away[rest].mean():.1f} mm, {angle[rest].mean():.1f} deg off",
            f"pushed by {PUSH:.0f} N: {away[time >= PUSHED[0]].max():.1f} mm, later {away[last].mean():.1f} mm",
            f"work of a lap: K times rotation vector {abs(work[0]):.2g} J, spring of the pair {abs(work[1]):.0e} J",
        ]
    )


def figure(session: BoxSession) -> str:
    """Return the SVG text: internal force, and distance of the box from its wanted place."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from examples.style import CORRECTED, INK, POTENTIAL, STYLE, themed_svg

    with mpl.rc_context({**STYLE, "path.simplify": False}):  # contacts differ in their last digits: as many points
        drawing = Figure(figsize=(7.5, 3.2), layout="constrained")
        left, right = drawing.subplots(1, 2)
        every = slice(None, None, 20)
        left.plot(session.time[every], session.internal[every], color=POTENTIAL)
        left.axhline(SQUEEZE, color=INK, linewidth=0.8, linestyle="--")
        left.set(
            xlabel="time [s]", ylabel="internal force [N]", ylim=(0, 2 * SQUEEZE), title="squeeze, commanded: 20 N"
        )
        right.plot(session.time[every], 1e3 * session.error[every, 0], color=CORRECTED)
        right.set(xlabel="time [s]", ylabel="distance [mm]", title="box from its wanted place")
        for axes in (left, right):
            for name, span in (("lift", LIFT), ("turn", TURN), ("push", PUSHED)):
                axes.axvspan(*span, alpha=0.08, color=INK, linewidth=0)
                axes.text(sum(span) / 2, 0.02, name, transform=axes.get_xaxis_transform(), ha="center")
        return themed_svg(drawing)


def main() -> None:
    """Print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figure", type=Path, metavar="FILE", help="also draw an SVG")
    parser.add_argument("--arm", choices=ARMS, default="iiwa14", help="kind of both arms")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        arm = ARMS[options.arm]
        module, file = generated(Path(folder), arm)
        session = run(module, file, arm)
        print(told(session, work_of_lap(module, arm)))
    if options.figure:
        options.figure.write_text(figure(session))


if __name__ == "__main__":
    main()
