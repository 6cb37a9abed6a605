# SPDX-License-Identifier: MIT
"""Reader of MJCF files: MuJoCo compiles the model in a process of its own, and its bodies become a description.

A body with several joints becomes several links: joint k turns link "BODY/JOINT" about its anchor, and the last one
carries the body. The world is the root link, sites are links without mass, a joint's reference position is part of its
frame. MuJoCo rounds nothing: positions and quaternions are those of the compiled model.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from stiffgen.core.errors import DescriptionError, counted, listed, printable
from stiffgen.core.robot.checker import MAX_JOINTS
from stiffgen.core.robot.description import (
    LARGEST,
    Description,
    Inertial,
    JointElement,
    LoopElement,
    LoopEndElement,
    Mimic,
    Problem,
    Quaternion,
    Vector,
    stated,
)
from stiffgen.core.robot.geometry import unit
from stiffgen.files.confined import answer_of
from stiffgen.files.templates import portable_inputs

_UNBOUNDED = (-math.inf, math.inf, math.inf, math.inf)
"""Limits of a joint without any: lower, upper, velocity, effort."""
_UPRIGHT: Quaternion = (1.0, 0.0, 0.0, 0.0)
_ORIGIN: Vector = (0.0, 0.0, 0.0)
_NOTABLE = 1e-9  # [N m or N]
_TYPES = {"free": "floating", "ball": "ball", "slide": "prismatic", "hinge": "revolute"}
_MASSLESS = Inertial(0.0, _ORIGIN, _UPRIGHT, (0.0,) * 6)


def read_mjcf(path: Path, data: bytes) -> Description:
    """Read an MJCF file.

    Raises:
        DescriptionError: MuJoCo refuses the file, or a number is not finite.
        MissingExtraError: MuJoCo is not installed.

    """
    file = str(path.resolve())
    answer = answer_of("compilation.py", path.name, {"file": file}, "mujoco", "mjcf", "an MJCF file")
    if "encoding" in answer:
        raise DescriptionError(path.name, [printable(answer["encoding"], 400)])
    if "refusal" in answer:
        refusal = printable(answer["refusal"], 400)
        raise DescriptionError(path.name, [refusal if "; " in refusal else f"{refusal}; correct it"])
    if "error" in answer:
        raise DescriptionError(path.name, [f"MuJoCo refuses it: {printable(answer['error'], 400)}; correct it"])
    model = answer["model"]
    if len(model["joints"]) > MAX_JOINTS or len(model["bodies"]) + len(model["sites"]) > MAX_JOINTS:
        raise DescriptionError(path.name, [f"has more than {MAX_JOINTS} bodies, joints or sites; cut it to one robot"])
    if not all(map(_is_usable, _numbers(model))):
        raise DescriptionError(
            path.name,
            [f"a number of the compiled model is not finite or beyond {LARGEST:g}; give metres and kilograms"],
        )
    tree = _ModelTree(model)
    return Description(
        file=path.name,
        digest=hashlib.sha256(data).hexdigest(),
        robot=model["name"],
        inertials=tree.inertials,
        joints=tree.joints,
        problems=(*_missing_meshes(tree, answer["stand_ins"]), *tree.problems),
        remarks=tuple(_remarks(model)),
        is_mjcf=True,
        forces_at_rest={
            name: force for name, force in zip(tree.names, model["at_rest"], strict=True) if force > _NOTABLE
        },
        loops=tuple(map(tree.loop, model["loops"])),
        inputs=portable_inputs(file, answer["files"]),
    )


def _numbers(value: Any) -> Iterator[float]:
    """Yield all numbers of a model."""
    if isinstance(value, float):
        yield value
    elif isinstance(value, (list, dict)):
        for each in value.values() if isinstance(value, dict) else value:
            yield from _numbers(each)


def _is_usable(value: float) -> bool:
    return abs(value) <= LARGEST


class _ModelTree:
    """Links and joints of a compiled model."""

    def __init__(self, model: dict[str, Any]) -> None:
        self.model = model
        self.inertials: dict[str, Inertial | None] = {}
        self.joints: dict[str, JointElement] = {}
        self.problems: list[Problem] = []
        self.bodies = _unique(model["bodies"], "body", set())
        self.names = _unique(model["joints"], "joint", set())
        self._couplings = self._solved_couplings()  # before the bodies, whose joints read both
        self._motors = {next(iter(each)) for each in map(self._leaders, model["actuation"]["driven"]) if len(each) == 1}
        for index in range(len(self.bodies)):
            self._add_body(index)
        for site, name in zip(model["sites"], _unique(model["sites"], "site", set(self.inertials)), strict=True):
            pose = _vector(site["pos"]), _quaternion(site["quat"])
            self._add_link(name, _MASSLESS, self.bodies[site["body"]], *pose)

    def _add_body(self, index: int) -> None:
        """Add a body as a chain of links, one per joint, since a joint of a URDF has a link of its own.

        A body's joints share its axes. Each has its origin in the point that it turns about (anchor), which the next
        joint's frame starts from. The last link is the body if its joint is at the body's origin; else a fixed joint
        leads from there to the body. All other links are massless.
        """
        body, name = self.model["bodies"][index], self.bodies[index]
        if index == 0:  # the world
            self.inertials[name] = None
            return
        inertial = _inertial(body)
        moving = [k for k, joint in enumerate(self.model["joints"]) if joint["body"] == index]
        link, origin = self.bodies[body["parent"]], _ORIGIN  # reached so far; where it is, in the body's frame
        place, orientation = _vector(body["pos"]), _quaternion(body["quat"])  # of the body, in the frame of the link
        for k in moving:
            anchor = self._anchor(k)
            element = self._element(k, link, name, _moved(place, orientation, origin, anchor), orientation)
            is_body = k == moving[-1] and not any(anchor)
            link = name if is_body else f"{name}/{self.names[k]}"
            self._add(element, link, inertial if is_body else _MASSLESS)
            origin, place, orientation = anchor, _ORIGIN, _UPRIGHT
        if link != name:
            self._add_link(name, inertial, link, _moved(place, orientation, origin, _ORIGIN), orientation)

    def _anchor(self, k: int) -> Vector:
        """Return the point of the body that joint number ``k`` turns about, in the body's frame."""
        joint = self.model["joints"][k]
        return _ORIGIN if joint["type"] in ("free", "slide") else _vector(joint["pos"])

    def _add_link(self, name: str, inertial: Inertial, parent: str, xyz: Vector, orientation: Quaternion) -> None:
        """Add a link that is fixed to its parent."""
        joint = f"{name} fixed"
        while joint in self.names or joint in self.joints:
            joint += "_"
        self._add(
            JointElement(joint, "fixed", parent, "", xyz, orientation, _ORIGIN, *_UNBOUNDED, None), name, inertial
        )

    def _add(self, element: JointElement, link: str, inertial: Inertial) -> None:
        """Add a joint and its child link, whose name is lengthened until it is free."""
        while link in self.inertials:
            link += "_"
        self.inertials[link] = inertial
        self.joints[element.name] = JointElement(**vars(element) | {"child": link})

    def _element(self, k: int, link: str, body: str, place: Vector, orientation: Quaternion) -> JointElement:
        """Return joint number ``k`` below a link; its reference position becomes part of its frame."""
        joint = self.model["joints"][k]
        kind = _TYPES[joint["type"]]
        if joint["type"] not in ("hinge", "slide"):
            at_rest = self.names[k], kind, link, body, place, orientation, _ORIGIN, *_UNBOUNDED
            return JointElement(*at_rest, None, has_motor=k in self._motors)
        axis, value, mimic = unit(joint["axis"]), joint["reference"], self._couplings.get(k)
        if isinstance(mimic, float):  # held at a position by a constraint
            kind, value, mimic = "fixed", value - mimic, None
        # MuJoCo's frame is that of the reference position: back by it to the frame at 0
        if joint["type"] == "hinge" and value:
            orientation = _product(orientation, _turn(axis, -value))
        elif value:
            place = _sum(place, _turned(orientation, (-value * axis[0], -value * axis[1], -value * axis[2])))
        if kind == "revolute" and not joint["range"]:
            kind = "continuous"
        lower, upper = joint["range"] or (-math.inf, math.inf)
        return JointElement(
            name=self.names[k],
            type=kind,
            parent=link,
            child=body,
            xyz=place,
            orientation=orientation,
            axis=axis if kind != "fixed" else _ORIGIN,
            lower=lower,
            upper=upper,
            velocity=math.inf,
            effort=_effort(*self.model["actuation"]["forces"][k]),
            mimic=mimic,
            motor_inertia=joint["armature"] + self.model["actuation"]["armatures"][k],
            has_motor=k in self._motors,
            reference=joint["reference"],
        )

    def loop(self, constraint: dict[str, Any]) -> LoopElement:
        """Return the constraint that closes a loop."""
        first, second = (
            LoopEndElement(self.bodies[end["body"]], _vector(end["pos"]), _quaternion(end["quat"]))
            for end in constraint["ends"]
        )
        return LoopElement(constraint["text"], first, second, constraint["weld"])

    def _leaders(self, actuator: dict[str, Any]) -> set[int]:
        """Return the coordinates among the joints that an actuator drives, and that lead them."""
        leaders = set()
        for joint in actuator["joints"]:
            leader = joint
            while isinstance(relation := self._couplings.get(leader), Mimic):
                leader = self.names.index(relation.joint)
            leaders.add(leader)
        return leaders

    def _solved_couplings(self) -> dict[int, Mimic | float]:
        """Return the mimic relation, or the constant position, of each joint that a linear constraint determines.

        A constraint 0 = a q_follower + b q_master + c determines the first joint that none before it has determined:
        q_follower = -b/a q_master - c/a.
        """
        found: dict[int, Mimic | float] = {}
        for coupling in self.model["couplings"]:
            terms, constant = self._linear(coupling)
            if not coupling["active"] or terms is None:
                continue
            follower = next((k for k in terms if k not in found), None)
            if follower is None or len(terms) > 2:
                too_many = "couples more than two joints"
                fault = too_many if len(terms) > 2 else "determines no joint that another constraint leaves free"
                self._refuse(terms, coupling, fault)
                continue
            scale = -1 / terms.pop(follower)
            if not terms:
                found[follower] = scale * constant
                continue
            ((master, rate),) = terms.items()  # the other joint
            if self._leads(found, master, follower):
                self._refuse([follower, master], coupling, "couples joints in a circle")
                continue
            found[follower] = Mimic(self.names[master], scale * rate, scale * constant)
        return found

    def _linear(self, coupling: dict[str, Any]) -> tuple[dict[int, float] | None, float]:
        """Return rates and constant of 0 = sum of rates * positions + constant; None without a linear relation.

        With x the first joints' offset from their references and y that of the second ones, MuJoCo's constraint is
        x = a0 + a1 y + a2 y^2 + ...; it is linear if it has no higher powers, or no second joints.
        """
        a = coupling["polynomial"]
        parts = [(k, rate, 1.0) for k, rate in coupling["first"]]
        parts += [(k, rate, -a[1]) for k, rate in coupling["second"]]
        if any(k < 0 or self.model["joints"][k]["type"] not in ("hinge", "slide") for k, _, _ in parts):
            return None, 0.0
        if any(a[2:]) and coupling["second"]:
            self._refuse([k for k, _, _ in parts], coupling, "is not linear")
            return None, 0.0
        terms: dict[int, float] = {}
        constant = -a[0]
        for k, rate, factor in parts:
            terms[k] = terms.get(k, 0.0) + rate * factor
            constant -= rate * factor * self.model["joints"][k]["reference"]
        first = [k for k, _ in coupling["first"]]  # these come first: one of them becomes the follower
        terms = {k: terms[k] for k in dict.fromkeys((*first, *terms)) if terms[k]}
        return terms or None, constant

    def _leads(self, found: dict[int, Mimic | float], start: int, end: int) -> bool:
        """Return whether the masters of a joint lead to another joint."""
        while start != end:
            relation = found.get(start)
            if not isinstance(relation, Mimic):
                return False
            start = self.names.index(relation.joint)
        return True

    def _refuse(self, joints: Sequence[int] | dict[int, float], coupling: dict[str, Any], fault: str) -> None:
        """Note a problem of each joint, for chains with one of them."""
        names = [self.names[k] for k in joints]
        for name in names:
            self.problems.append(
                Problem(
                    f"joint {name}",
                    f"joint '{printable(name)}': the constraint '{printable(coupling['name'])}' of {listed(names)} "
                    f"{fault}, which no <mimic> expresses; choose a chain without these joints",
                    "motion",
                )
            )


def _unique(elements: list[dict[str, Any]], kind: str, taken: set[str]) -> list[str]:
    """Return a name for each element: its own, or its kind and number; numbered on where a name is taken.

    The names are added to ``taken``.
    """
    names: list[str] = []
    for index, element in enumerate(elements):
        own = element["name"].strip() or f"{kind}{index}"
        first = f"{own}_{kind}" if own in taken else own
        name, number = first, 2
        while name in taken:
            name, number = f"{first}_{number}", number + 1
        taken.add(name)
        names.append(name)
    return names


def _missing_meshes(tree: _ModelTree, stand_ins: list[list[str]]) -> Iterator[Problem]:
    for body, mesh in stand_ins:
        yield Problem(
            f"link {body}",
            f"link '{printable(body)}': its inertia comes from the mesh '{printable(mesh)}', which is missing or "
            "cannot be read; add the mesh or an <inertial>, or leave all masses out (--no-masses)",
        )


_BIASES = "actuator_biasprm"
"""Array with the parameters of the actuators' own laws."""
_MEANINGS = {
    "dof_damping": "damping",
    "dof_frictionloss": "dry friction",
    "jnt_stiffness": "a spring",
    "jnt_actgravcomp": "gravity compensation by their actuators (actuatorgravcomp)",
    "body_gravcomp": "gravity compensation (gravcomp)",
    "tendon_stiffness": "a spring",
    "tendon_damping": "damping",
    "tendon_armature": "armature",
    "tendon_frictionloss": "dry friction",
    "tendon_range": "a range",
    _BIASES: "a control law of their own",
}
"""Words for arrays of a model; another array is named as MuJoCo names it."""


def _remarks(model: dict[str, Any]) -> Iterator[str]:
    """Yield what the compiled model has and the functions leave out."""
    for array, (kinds, names) in _left_out(model).items():
        having = counted(len(names), f"{_SINGULAR.get(kinds, kinds.removesuffix('s'))} has", f"{kinds} have")
        meaning = _MEANINGS.get(array, array)
        yield f"{having} {meaning}, which the functions do not contain: {listed(names, 8)}"
    if model["options"]:
        yield f"options of MuJoCo that the functions do not contain: {'; '.join(model['options'])}"
    inactive = [each["name"] for each in model["couplings"] if not each["active"]]
    yield from _remarks_on_actuators(model)
    if inactive:
        being = counted(len(inactive), "constraint is", "constraints are")
        yield f"{being} inactive and ignored: {listed(inactive, 8)}"


def _left_out(model: dict[str, Any]) -> dict[str, tuple[str, list[str]]]:
    """Return kind and names of the elements by the array in which they have what the functions leave out.

    Actuators with a law of their own come first, together with those whose bias is not the default.
    """
    found = {each["array"]: (each["kind"], each["names"]) for each in model["omissions"]}
    laws = model["actuation"]["laws"]
    if not laws:
        return found
    _, biased = found.pop(_BIASES, ("", []))
    return {_BIASES: ("actuators", list(dict.fromkeys([*biased, *laws]))), **found}


_SINGULAR = {"bodies": "body"}
"""Kinds of elements whose singular does not only lack the s."""


def _remarks_on_actuators(model: dict[str, Any]) -> Iterator[str]:
    """Yield the actuators of which no effort limit follows."""
    driven = model["actuation"]["driven"]
    others = [each["name"] for each in driven if not each["joints"]]
    if others:
        acting = counted(
            len(others), "actuator acts on no single joint, and bounds", "actuators act on no single joints, and bound"
        )
        yield f"{acting} no effort: {listed(others, 8)}"
    shared = [each["name"] for each in driven if len(each["joints"]) > 1]
    if shared:
        pulling = counted(len(shared), "actuator pulls", "actuators pull")
        yield f"{pulling} several joints, whose torques depend on each other: {listed(shared, 8)}"
    one_way = [
        joint["name"]
        for joint, (low, high) in zip(model["joints"], model["actuation"]["forces"], strict=True)
        if low is not None and high is not None and not low < 0 < high
    ]
    if one_way:
        pushed = counted(len(one_way), "joint", "joints")
        yield f"{pushed} without force in one direction or both, and without effort limit: {listed(one_way, 8)}"
    if disabled := model["actuation"]["disabled"]:
        without = counted(len(disabled), "actuator has", "actuators have")
        yield f"{without} no force, since the model disables the group: {listed(disabled, 8)}"


def _inertial(body: dict[str, Any]) -> Inertial:
    """Return mass and inertia of a body of the compiled model, whose tensor is diagonal in axes of its own."""
    xx, yy, zz = body["inertia"]
    tensor = (xx, 0.0, 0.0, yy, 0.0, zz)
    return Inertial(body["mass"], _vector(body["com"]), _quaternion(body["axes"]), tensor)


def _effort(low: float | None, high: float | None) -> float:
    """Return the largest force that a joint has in both directions; infinite without a bound, or without such a force.

    No controller can use an effort limit of 0: the user has to state one.
    """
    downwards = math.inf if low is None else -low
    upwards = math.inf if high is None else high
    return stated(max(0.0, min(downwards, upwards)))


def _vector(values: Sequence[float]) -> Vector:
    x, y, z = values
    return x, y, z


def _quaternion(values: Sequence[float]) -> Quaternion:
    w, x, y, z = values
    return w, x, y, z


def _sum(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _difference(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the Hamilton product of two quaternions (w, x, y, z)."""
    (aw, ax, ay, az), (bw, bx, by, bz) = a, b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def _turned(orientation: Quaternion, vector: Vector) -> Vector:
    """Return a vector turned by a unit quaternion: the vector part of q (0, v) q*."""
    w, x, y, z = orientation
    _, i, j, k = _product(_product(orientation, (0.0, *vector)), (w, -x, -y, -z))
    return i, j, k


def _turn(axis: Vector, angle: float) -> Quaternion:
    """Return the unit quaternion of a rotation about a unit vector by an angle [rad]."""
    sine = math.sin(angle / 2)
    return math.cos(angle / 2), axis[0] * sine, axis[1] * sine, axis[2] * sine


def _moved(place: Vector, orientation: Quaternion, origin: Vector, point: Vector) -> Vector:
    """Return the place of a point of a body, in the frame in which another point of the body, ``origin``, has a place.

    ``orientation`` is the body's in that frame; both points are in the body's frame.
    """
    step = _difference(point, origin)
    return _sum(place, _turned(orientation, step)) if any(step) else place
