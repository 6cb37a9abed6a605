# SPDX-License-Identifier: MIT
"""Compare two builds of the controller's companions: policy port and Follow in streams, makers, gains, postures."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from stiffgen.control.companions import COMPANIONS, companions_of
from stiffgen.control.sessions.library import fill, struct_of
from stiffgen.control.sessions.makers import SAME_MAKERS
from stiffgen.control.structs import present
from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray

STREAMS, STEPS = 25, 50
"""Number of streams of proposals, and of steps of each."""
_BAD = (math.nan, math.inf, -math.inf, -1.0, 20.0)
_SHARES = (math.nan, -1.0, 0.0, 0.05, 0.2, 1.0, 1.5, 20.0)
"""Values of settings, and of defaults relative to a default: good, at their bounds and bad."""
_STATE_SIZE = 1 << 14
"""Bytes of memory for a state: more than the largest robot needs."""
Random = np.random.Generator


class Companions:
    """Compiled companions of a controller, with their structs and states."""

    def __init__(self, file: Path, name: str, chain: Chain) -> None:
        self._library, self._name = ctypes.CDLL(str(file)), name
        self.structs: dict[str, Any] = {}
        for companion in companions_of(chain):
            for struct, _, fields in companion.structs:
                self.structs[struct] = struct_of(chain, struct, present(fields, chain))()
            self.structs[f"{companion.name}_state"] = (ctypes.c_char * _STATE_SIZE)()

    def call(self, function: str, *arguments: Any, result: Any = ctypes.c_int) -> Any:
        """Call a function; structs are passed by name or address, numbers by value, None as a null pointer."""
        known = [self.structs[each] if isinstance(each, str) else each for each in arguments]
        passed = [
            each if each is None or isinstance(each, (ctypes.c_double, ctypes.c_int)) else ctypes.byref(each)
            for each in known
        ]
        called = self._library[f"{self._name}_{function}"]
        called.restype = result
        return called(*passed)

    def bits(self, *structs: str) -> list[bytes]:
        """Return the bytes of structs."""
        return [bytes(self.structs[struct]) for struct in structs]


Pair = tuple[Companions, Companions]
"""Companions of the reference and of the folder."""


def compare_companions(reference: Path, library: Path, name: str, chain: Chain) -> list[str]:
    """Return the names of companions whose results differ, in bits, between two compiled folders."""
    both, random = (Companions(reference, name, chain), Companions(library, name, chain)), np.random.default_rng(7)
    present = [companion.name for companion in companions_of(chain)]
    faults = [f"{each}: texts differ" for each in present if not _same_texts(both, each)]
    for _ in range(STREAMS):
        stream = _Stream(random, chain)
        if not stream.start(both):
            faults.append("policy or follow: start differs")
        elif not all(stream.step(both) for _ in range(STEPS)):
            faults.append("policy or follow: a step differs")
    comparisons: dict[str, Callable[[Pair, Random, Chain], bool]] = {
        "gains": _same_gains,
        "find_posture": _same_postures,
        **SAME_MAKERS,
    }
    faults += [f"{each}: results differ" for each in present if not comparisons.get(each, _true)(both, random, chain)]
    return list(dict.fromkeys(faults))


def _true(both: Pair, random: Random, chain: Chain) -> bool:
    return True


def _same_texts(both: Pair, companion: str) -> bool:
    """Return whether the texts of errors are the same, and of refusals where there are any."""
    functions = [f"{companion}_error_text"] if COMPANIONS[companion].errors and companion != "gains" else []
    functions += ["policy_refused_text"] if companion == "policy" else []
    codes = [ctypes.c_int(code) for code in range(-60, 20)]
    return all(
        len({each.call(function, code, result=ctypes.c_char_p) for each in both}) == 1
        for function in functions
        for code in codes
    )


def _array(values: Any) -> Any:
    numbers = np.ravel(values).tolist()
    return (ctypes.c_double * len(numbers))(*numbers)


def _spoil(random: Random, share: float, array: Any) -> None:
    """Make an entry bad with some probability."""
    if random.random() < share:
        array[int(random.integers(len(array)))] = float(random.choice(_BAD))


def _same_gains(both: Pair, random: Random, chain: Chain) -> bool:
    """Compare splits of torques, and bounds on late work, with good and bad numbers."""
    n = len(chain.motor_coordinates)
    for _ in range(60):
        given: dict[str, Any] = {
            **{name: _array(random.normal(size=n)) for name in ("q", "dq", "q_des", "dq_des", "torque")},
            **{name: _array(random.normal(size=(n, n))) for name in ("joint_stiffness", "damping")},
            **{name: _array(random.uniform(0.0, 2.0, n)) for name in ("kp_limit", "kd_limit")},
        }
        names = list(given)
        _spoil(random, 0.3, given[names[int(random.integers(len(names)))]])
        if random.random() < 0.1:
            given[names[int(random.integers(len(names)))]] = None
        hold = float(random.choice([0.01, 0.0, math.nan], p=[0.8, 0.1, 0.1]))  # [s]
        results = [_gains_of(each, n, given, hold) for each in both]
        if results[0] != results[1]:
            return False
    return True


def _gains_of(companions: Companions, n: int, given: dict[str, Any], hold: float) -> tuple[object, ...]:
    """Return error, tau_ff, kp and kd (n) of a split, and the late work of these gains; ``given`` are its arguments."""
    tau_ff, kp, kd = (_array(np.zeros(n)) for _ in range(3))
    code = companions.call("joint_gains", *given.values(), tau_ff, kp, kd)
    # q, q_des, dq_des and the velocity limit of the late work: any vectors serve
    vectors = [given["q"], given["dq"], given["q_des"], tau_ff, kp, kd, given["kp_limit"]]
    work = companions.call("late_work", *vectors, ctypes.c_double(hold), result=ctypes.c_double)
    return code, bytes(tau_ff), bytes(kp), bytes(kd), repr(work)


def _same_postures(both: Pair, random: Random, chain: Chain) -> bool:
    """Compare searches for postures of poses: some in reach, some beyond, some with bad numbers."""
    n, tips = len(chain.motor_coordinates), len(chain.tips)
    for _ in range(20):
        pose, tool = (_array(random_poses(random, tips, size)) for size in (0.5, 0.1))
        start, low = random.normal(size=n), -random.uniform(0.5, 3.0, n)
        lower = upper = None
        if random.random() < 0.5:  # bounds, some in the wrong order
            lower, upper = _array(low), _array(low + random.uniform(-0.1, 5.0, n))
        begin = _array(start)
        _spoil(random, 0.2, pose)
        _spoil(random, 0.1, begin)
        results = []
        for each in both:
            found = _array(np.zeros(n))
            code = each.call("find_posture", pose, tool, begin, lower, upper, found)
            results.append((code, bytes(found)))
        if results[0] != results[1]:
            return False
    return True


class _Stream:
    """Proposals with random times, some of them late, early, out of order or not finite, and Follow behind the port."""

    def __init__(self, random: Random, chain: Chain) -> None:
        self.random, self.tips, self.n = random, len(chain.tips), len(chain.motor_coordinates)
        self.follows = not chain.loops
        self.now = float(random.choice([0.0, 10.0, -3.0]))
        self.lies = float(random.choice([0.0, 0.2]))  # share of proposals with a bad number, and of other faults

    def start(self, both: Pair) -> bool:
        """Start ports and followers, sometimes with bad numbers; return whether they are the same."""
        random = self.random
        poses, q = _array(random_poses(random, self.tips, 0.3)), _array(random.normal(size=self.n))
        _spoil(random, 0.1, poses)
        _spoil(random, 0.1, q)
        now = ctypes.c_double(float(random.choice(_BAD)) if random.random() < 0.1 else self.now)
        for each in both:
            each.call("policy_default_config", "policy_config")
            if self.follows:
                each.call("follow_default_config", "follow_config")
                each.structs["follow_config"].sample_time = 1e-3
        self._change_settings(both, "policy_config")
        if self.follows:
            self._change_settings(both, "follow_config")
        results: list[object] = []
        for each in both:
            code = each.call("policy_start", "policy_state", "policy_config", poses, now)
            follow = each.call("follow_init", "follow_config", "follow_state", q) if self.follows else 0
            results.append((code, follow, self._bits(each)))
        return results[0] == results[1]

    def _bits(self, each: Companions) -> list[bytes]:
        parts = [part for part in each.structs if part.startswith(("policy", "follow"))]
        return each.bits(*parts)

    def _change_settings(self, both: Pair, struct: str) -> None:
        """Multiply some fields of a configuration, or one entry of an array, and give both builds the same struct."""
        config = both[0].structs[struct]
        for name, kind in config._fields_:
            if self.random.random() < 0.2:
                share = float(self.random.choice(_SHARES))
                if kind is ctypes.c_double:
                    setattr(config, name, share * getattr(config, name))
                else:
                    array = getattr(config, name)
                    array[int(self.random.integers(len(array)))] *= share
        _copy_struct(both, struct)

    def step(self, both: Pair) -> bool:
        """Propose and command at the next time, and follow; return whether all structs are the same."""
        random = self.random
        # [s] mostly a cycle; sometimes a pause, or backwards
        self.now += float(random.choice([1e-3, 0.02, 0.1, 0.4, 3.0, -0.01], p=[0.5, 0.2, 0.1, 0.1, 0.05, 0.05]))
        now = ctypes.c_double(self.now if random.random() > 0.3 * self.lies else float(random.choice(_BAD)))
        has_proposal = random.random() < 0.5
        if has_proposal:
            self._propose(both[0].structs["policy_proposal"])
            _copy_struct(both, "policy_proposal")
            if self.follows and self.tips > 1:
                self._hold(both)
        results: list[object] = []
        for each in both:
            codes = [each.call("policy_propose", "policy_state", "policy_proposal", now) if has_proposal else 0]
            codes.append(each.call("policy_command", "policy_state", now, "policy_output"))
            if self.follows:
                fill(each.structs["follow_input"].pose, each.structs["policy_output"].pose)
                codes.append(each.call("follow_step", "follow_state", "follow_input", "follow_output"))
            results.append((codes, self._bits(each)))
        return results[0] == results[1]

    def _hold(self, both: Pair) -> None:
        """Let the tips hold an object, sometimes with a bad number, or none."""
        random = self.random
        pose, grasp = _array(random_poses(random, 1, 0.4)), _array(random_poses(random, self.tips, 0.2))
        _spoil(random, self.lies, pose)
        _spoil(random, self.lies, grasp)
        held = pose if random.random() < 0.7 else np.zeros(16)
        for each in both:
            fill(each.structs["follow_input"].object_pose, held)
            fill(each.structs["follow_input"].grasp, grasp)

    def _propose(self, proposal: Any) -> None:
        """Write a proposal."""
        random = self.random
        fill(proposal.valid, random.choice([0, 1, 1, 1, 2], 4))
        fill(proposal.time, self.now - random.choice([0.0, 0.02, 0.3, 2.0, -0.003, -0.007, -0.1], 4))
        fill(proposal.pose, random_poses(random, self.tips, 0.4))
        fill(proposal.translation_stiffness, self._stiffness(400.0))
        fill(proposal.rotation_stiffness, self._stiffness(20.0))
        fill(proposal.wrench_command, random.uniform(-60.0, 60.0, (self.tips, 6)))
        proposal.gripper = float(random.normal())
        arrays = ("time", "pose", "translation_stiffness", "rotation_stiffness", "wrench_command")
        _spoil(random, self.lies, getattr(proposal, str(random.choice(arrays))))

    def _stiffness(self, size: float) -> FloatArray:
        """Return stiffnesses (tips, 3, 3), some of them singular, asymmetric or too large."""
        random, matrices = self.random, np.zeros((self.tips, 3, 3))
        for matrix in matrices:
            rank = int(random.integers(1, 4))
            root = random.normal(size=(3, rank)) * 10.0 ** random.uniform(-1.0, 0.6)  # with large entries at times
            matrix[:] = size * root @ root.T
            matrix *= random.choice([np.ones((3, 3)), np.diag([1.0, 2.0, 0.0])])  # every other one diagonal, with a 0
            if random.random() < 0.5 * self.lies:
                row, column = random.integers(3, size=2)
                matrix[row, column] += random.choice([1e-9, 1e-3, -1e-3, 1.0]) * abs(matrix).max()
        return matrices


def _copy_struct(both: Pair, name: str) -> None:
    """Copy a struct of the reference's companions into that of the folder's."""
    source, target = (each.structs[name] for each in both)
    ctypes.memmove(ctypes.byref(target), ctypes.byref(source), ctypes.sizeof(source))


def random_poses(random: Random, tips: int, size: float) -> FloatArray:
    """Return poses with any turn, some of half a turn or roughly a rotation; ``size`` [m] of their distance."""
    poses = np.zeros((tips, 4, 4))
    for pose in poses:
        orthogonal, _ = np.linalg.qr(random.normal(size=(3, 3)))
        turn = orthogonal * np.linalg.det(orthogonal)  # of determinant 1: a reflection changes its sign
        pose[:3, :3] = turn if random.random() < 0.8 else np.diag([1.0, -1.0, -1.0])
        pose[:3, :3] *= random.choice([1.0, 1.0 + 1e-4, 1.0 + 1e-3, 0.99], p=[0.7, 0.1, 0.1, 0.1])
        pose[:3, 3], pose[3, 3] = size * random.normal(size=3), 1.0
    return poses
