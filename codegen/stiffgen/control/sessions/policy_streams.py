# SPDX-License-Identifier: MIT
"""Compare the policy ports of two controllers in streams of proposals, good and bad; results must be equal in bits."""

from __future__ import annotations

import ctypes
import math

import numpy as np

from stiffgen.control.sessions.library import ControllerLibrary, fill
from stiffgen.core.robot.geometry import FloatArray

_SETTINGS = ("hold_time", "fade_time", "stale_share", "longest_interval", "clock_tolerance", "smoothing")
_BAD = (math.nan, math.inf, -math.inf, -1.0, 20.0)
_VALUES = (math.nan, -1.0, 0.0, 0.05, 0.2, 1.0, 1.5, 5.0, 10.0, 20.0)
"""Values of settings: good, at their bounds and bad."""
Random = np.random.Generator


def compare_policy(reference: ControllerLibrary, library: ControllerLibrary, tips: int) -> list[str]:
    """Return the names of functions of the policy port whose results differ."""
    both, random = (reference, library), np.random.default_rng(7)
    faults = set()
    for each in both:
        each.call("default_config", each.config)
    for function, count in (("policy_start", 2), ("policy_propose", 3), ("policy_command", 2)):
        for missing in range(count):
            codes = [each.call(function, *_arguments(each, function, tips, missing)) for each in both]
            if codes[0] != codes[1]:
                faults.add(f"{function} differs with a null pointer")
    for _ in range(80):
        stream = _Stream(random, tips)
        if not stream.start(both):
            faults.add("policy_start differs")
        elif not all(stream.step(both) for _ in range(60)):
            faults.add("policy_propose or policy_command differs")
    return sorted(faults)


def _arguments(library: ControllerLibrary, function: str, tips: int, missing: int) -> list[object]:
    """Return the arguments of a function of the port, one of which is a null pointer."""
    now, poses = ctypes.c_double(0.0), (ctypes.c_double * (16 * tips))()
    arguments: dict[str, list[object]] = {
        "policy_start": [library.policy, poses, now],
        "policy_propose": [library.config, library.policy, library.proposal, now],
        "policy_command": [library.policy, library.input, now],
    }
    given = arguments[function]  # those that may be missing come first
    given[missing] = None
    return [given[0], given[2], given[1]] if function == "policy_command" else given


class _Stream:
    """Stream of proposals with random times, some of them late, early, out of order or not finite."""

    def __init__(self, random: Random, tips: int) -> None:
        self.random, self.tips = random, tips
        self.now = float(random.choice([0.0, 10.0, -3.0]))
        self.lies = float(random.choice([0.0, 0.2]))  # share of proposals with a bad number, and of other faults

    def start(self, both: tuple[ControllerLibrary, ControllerLibrary]) -> bool:
        """Start both ports, sometimes with a bad pose or time; change settings. Return whether they are the same."""
        poses = (ctypes.c_double * (16 * self.tips))(*self._poses().ravel().tolist())
        if self.random.random() < 0.1:
            poses[int(self.random.integers(16 * self.tips))] = float(self.random.choice(_BAD))
        bad = self.random.random() < 0.1
        now = ctypes.c_double(float(self.random.choice([math.nan, math.inf, -math.inf])) if bad else self.now)
        codes = [each.call("policy_start", each.policy, poses, now) for each in both]
        same = codes[0] == codes[1] and bytes(both[0].policy) == bytes(both[1].policy)
        for name in _SETTINGS:
            if self.random.random() < 0.5:
                value = float(self.random.choice(_VALUES))
                for each in both:
                    setattr(each.policy, name, value)
        return same

    def step(self, both: tuple[ControllerLibrary, ControllerLibrary]) -> bool:
        """Propose and command at the next time; return whether both ports and both inputs are the same."""
        random = self.random
        self.now += float(random.choice([1e-3, 0.02, 0.1, 0.4, 3.0, -0.01], p=[0.5, 0.2, 0.1, 0.1, 0.05, 0.05]))
        now = ctypes.c_double(self.now if random.random() > 0.3 * self.lies else float(random.choice(_BAD)))
        proposed = random.random() < 0.5
        if proposed:
            self._propose(both[0])
            source, target = (ctypes.byref(each.proposal) for each in both)
            ctypes.memmove(target, source, ctypes.sizeof(both[0].proposal))
        results = []
        for each in both:
            # any pattern that shows which bytes policy_command leaves alone
            ctypes.memset(ctypes.byref(each.input), 1, ctypes.sizeof(each.input))
            code = each.call("policy_propose", each.config, each.policy, each.proposal, now) if proposed else 0
            codes = code, each.call("policy_command", each.policy, now, each.input)
            results.append((codes, bytes(each.policy), bytes(each.input)))
        return results[0] == results[1]

    def _propose(self, library: ControllerLibrary) -> None:
        """Write a proposal."""
        random, proposal = self.random, library.proposal
        fill(proposal.valid, random.choice([0, 1, 1, 1, 2], 4))
        fill(proposal.time, self.now - random.choice([0.0, 0.0, 0.02, 0.3, 2.0, -0.003, -0.1], 4))
        fill(proposal.equilibrium, self._poses())
        fill(proposal.stiffness, self._stiffness())
        size = np.repeat(np.array(library.config.heaviest_wrench), 3) * random.choice([0.0, 0.3, 1.0])
        fill(proposal.wrench_command, random.uniform(-1.0, 1.0, (self.tips, 6)) * size)
        proposal.gripper = float(random.normal())
        if random.random() < self.lies:
            array = getattr(proposal, str(random.choice(["time", "equilibrium", "stiffness", "wrench_command"])))
            array[int(random.integers(len(array)))] = float(random.choice(_BAD))

    def _poses(self) -> FloatArray:
        """Return poses with any turn, now and then half a turn about an axis."""
        random, poses = self.random, np.zeros((self.tips, 4, 4))
        for pose in poses:
            turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
            pose[:3, :3] = turn * np.linalg.det(turn) if random.random() < 0.8 else np.diag([1.0, -1.0, -1.0])
            pose[:3, 3], pose[3, 3] = random.normal(size=3), 1.0
        return poses

    def _stiffness(self) -> FloatArray:
        """Return stiffnesses, some of them singular, asymmetric, too large, or with a coupling."""
        random, matrices = self.random, np.zeros((self.tips, 6, 6))
        for matrix in matrices:
            for part, size in ((slice(0, 3), 400.0), (slice(3, 6), 20.0)):
                root = random.normal(size=(3, int(random.integers(1, 4)))) * 10.0 ** random.uniform(-1.0, 0.6)
                # of rank 1 to 3, with large entries at times; every other one diagonal, with a 0
                matrix[part, part] = size * root @ root.T * random.choice([np.ones((3, 3)), np.diag([1.0, 2.0, 0.0])])
            if random.random() < 0.5 * self.lies:
                row, column = random.integers(6, size=2)
                matrix[row, column] += random.choice([1e-9, 1e-3, -1e-3, 1.0]) * abs(matrix).max()
        return matrices
