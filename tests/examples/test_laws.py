# SPDX-License-Identifier: MIT
"""Five execution laws against their formulas written anew, and their twins: tangents at the goal, work round orbits."""

from __future__ import annotations

import copy
from itertools import islice
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

import stiffgen
from examples import laws
from support.project import Once

LAWS = list(laws.LAWS)


@pytest.fixture(scope="module")
def panda(once: Once) -> ModuleType:
    folder: Path = once(
        "panda of the laws", lambda output: stiffgen.generate(laws.PANDA, output=output, **laws.OPTIONS)
    )
    return stiffgen.open_robot(folder / "panda").module


def error(goal: laws.State, state: laws.State) -> np.ndarray:
    """Return displacement and rotation vector, by SciPy."""
    turn = Rotation.from_matrix(goal.pose[:3, :3]) * Rotation.from_matrix(state.pose[:3, :3]).inv()
    return np.r_[goal.pose[:3, 3] - state.pose[:3, 3], turn.as_rotvec()]


def polymetis(goal: laws.State, state: laws.State) -> np.ndarray:
    """Write the law joint by joint: adaptive gains sum_k Kx_k J_ki J_kj beside fixed ones."""
    # Polymetis' defaults: Kx [N/m, N m/rad] and Kxd at the tip, k and d at the joints.
    x, xd = [750, 750, 750, 15, 15, 15], [37, 37, 37, 2, 2, 2]
    k, d = [40, 30, 50, 25, 35, 25, 10], [4, 6, 5, 5, 3, 2, 1]
    torque = np.zeros(7)
    for i in range(7):
        torque[i] = k[i] * (goal.q[i] - state.q[i]) - d[i] * state.dq[i]
        for j in range(7):
            torque[i] += sum(x[m] * state.J[m, i] * state.J[m, j] for m in range(6)) * (goal.q[j] - state.q[j])
            torque[i] -= sum(xd[m] * state.J[m, i] * state.J[m, j] for m in range(6)) * state.dq[j]
    return torque


def serl(goal: laws.State, state: laws.State) -> np.ndarray:
    """Write the law with the project's signs: e = current - desired, clipped, and -K e."""
    now, wanted = (Rotation.from_matrix(each.pose[:3, :3]) for each in (state, goal))
    vector = (now.inv() * wanted).as_quat(canonical=True)[:3]
    e = np.r_[state.pose[:3, 3] - goal.pose[:3, 3], -now.apply(vector)]
    # clipped at 1 cm and 0.05 rad, as in SERL's code
    e = np.minimum(np.maximum(e, [-0.01] * 3 + [-0.05] * 3), [0.01] * 3 + [0.05] * 3)
    task = state.J.T @ -(np.r_[[2000] * 3, [150] * 3] * e + np.r_[[89] * 3, [7] * 3] * (state.J @ state.dq))
    qe, dqe = goal.q - state.q, state.dq.copy()
    qe[0] *= 100  # SERL holds the first joint 100 times as stiff
    dqe[0] *= 2 * np.sqrt(100)
    free = np.eye(7) - state.J.T @ np.linalg.inv(state.J @ state.J.T) @ state.J
    return task + free @ (0.2 * qe - 2 * np.sqrt(0.2) * dqe)


def crisp(goal: laws.State, state: laws.State) -> np.ndarray:
    K = np.array([500, 500, 500, 30, 30, 30])
    free = np.linalg.svd(state.J)[2][6:]  # the motion that leaves the tip
    posture = goal.q - state.q - 2 * state.dq
    task = state.J.T @ (K * error(goal, state) - 2 * np.sqrt(K) * (state.J @ state.dq))
    return task + free.T @ (free @ posture)


def operational(goal: laws.State, state: laws.State, kp: np.ndarray, decoupled: bool) -> np.ndarray:
    """Write J^T L (kp e - kd v) + (I - J^T Jbar^T) M (...), with all inverses."""
    inverse = np.linalg.inv(state.M)
    L = np.linalg.inv(state.J @ inverse @ state.J.T)
    free = np.eye(7) - inverse @ state.J.T @ L @ state.J
    wanted = kp * error(goal, state) - 2 * np.sqrt(kp) * (state.J @ state.dq)
    if decoupled:
        L = np.zeros((6, 6))
        for k in (slice(3), slice(3, 6)):
            L[k, k] = np.linalg.inv(state.J[k] @ inverse @ state.J[k].T)
    posture = state.M @ (10 * (goal.q - state.q) - 2 * np.sqrt(10) * state.dq)
    return state.J.T @ (L @ wanted) + free.T @ posture


FORMULAS = {
    "polymetis": polymetis,
    "SERL": serl,
    "CRISP": crisp,
    "robosuite": lambda goal, state: operational(goal, state, np.full(6, 150.0), decoupled=True),
    "Isaac Lab": lambda goal, state: operational(goal, state, np.repeat([150.0, 100.0], 3), decoupled=False),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_the_law_is_its_formula(name: str, panda: ModuleType) -> None:
    """Compare the law with its formula, near the goal and far, alone and in a batch."""
    random = np.random.default_rng(5)
    for size in (1e-3, 0.1, 0.8):
        goal = laws.State.of(panda, laws.HOME + random.uniform(-0.3, 0.3, 7))
        q, dq = goal.q + random.uniform(-size, size, (20, 7)), random.normal(size=(20, 7))
        many = laws.LAWS[name].torque(goal, laws.State.of(panda, q, dq))
        for row in range(20):
            state = laws.State.of(panda, q[row], dq[row])
            expected = FORMULAS[name](goal, state)
            for found in (many[row], laws.LAWS[name].torque(goal, state)):
                assert np.abs(found - expected).max() <= 1e-12 * max(np.abs(expected).max(), 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_the_twin_has_the_tangent_of_the_law_at_rest(name: str, panda: ModuleType) -> None:
    """Equal to 1e-9 for the symmetric part; only two laws have another part."""
    random, law = np.random.default_rng(6), laws.LAWS[name]
    for _ in range(5):
        goal = laws.State.of(panda, laws.HOME + random.uniform(-0.3, 0.3, 7))
        one, other = laws.torques(panda, law, goal)
        assert np.abs(one(goal)).max() < 1e-12 > np.abs(other(goal)).max()
        K, twin = laws.tangent(panda, one, goal.q), laws.tangent(panda, other, goal.q)
        size = np.abs(K).max()
        assert np.abs(twin - (K + K.T) / 2).max() <= 1e-9 * size
        assert (np.abs(K - K.T).max() > 1e-3 * size) == (name in ("SERL", "Isaac Lab"))
        moving = laws.State.of(panda, np.tile(goal.q, (7, 1)), np.eye(7))
        D, damping = -one(moving), law.twin(goal).damping
        assert np.linalg.eigvalsh(damping).min() > -1e-9
        if name not in ("SERL", "Isaac Lab"):  # theirs without the part that puts energy out
            assert np.abs(damping - D).max() <= 1e-9 * np.abs(D).max()


@pytest.mark.slow
def test_no_spring_has_the_tangent_of_gains_of_ratio_three(panda: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """Full decoupling with 150 and 50 1/s^2: even the symmetric part of the tangent at rest is not positive."""
    goal = laws.State.of(panda, laws.HOME)

    def smallest() -> float:
        K = laws.tangent(panda, laws.torques(panda, laws.LAWS["Isaac Lab"], goal)[0], goal.q)
        return float(np.linalg.eigvalsh(K + K.T)[0] / 2)

    assert smallest() > 0
    monkeypatch.setattr(laws, "ISAAC_KP", np.repeat([150.0, 50.0], 3))
    assert smallest() < -3


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_only_the_twin_does_no_work_round_orbits(name: str, panda: ModuleType) -> None:
    """Move round 40 closed orbits: the law does work, its twin with an energy does none up to rounding."""
    works, twins = laws.orbit_work(panda, laws.LAWS[name], 0.2, 40)
    assert twins.max() < 1e-10
    assert np.median(works) > 1e-3
    if name == "polymetis":  # measured elsewhere over 300 orbits: 0.72 J
        assert np.median(works) == pytest.approx(0.72, rel=0.2)


def stiffness_of(controller: Any, springs: dict[str, Any], q: np.ndarray) -> np.ndarray:
    """Return the stiffness (7, 7) that the controller has at rest at q: its torques 1e-6 rad beside it."""
    still = {"dq": np.zeros(7), "q0": q, **springs}
    for counter in range(3):
        controller.step(q=q, counter=counter, **still)

    def torque(away: np.ndarray) -> np.ndarray:
        return np.asarray(copy.deepcopy(controller).step(q=q + away, counter=3, **still).torque)

    return np.array([(torque(-e) - torque(e)) / 2e-6 for e in 1e-6 * np.eye(7)]).T


@pytest.mark.slow
@pytest.mark.parametrize(("preset", "name"), laws.PRESETS.items())
def test_a_preset_has_the_stiffness_of_its_law(preset: str, name: str, panda: ModuleType) -> None:
    """Equal at rest, but for the projector of two laws: the controller's posture spring acts in every direction."""
    random, law = np.random.default_rng(8), laws.LAWS[name]
    for _ in range(3):
        goal = laws.State.of(panda, laws.HOME + random.uniform(-0.3, 0.3, 7))
        controller, springs = laws.controller(panda, preset)
        ours = stiffness_of(controller, springs, goal.q)
        K, twin = (laws.tangent(panda, each, goal.q) for each in laws.torques(panda, law, goal))
        posture = springs["posture_stiffness"] * np.eye(7)
        size = np.abs(K).max()
        for other in ((K + K.T) / 2, twin):
            assert np.abs(ours - posture + law.twin(goal).posture - other).max() <= 1e-7 * size
        free = np.linalg.svd(goal.J)[2][6]
        assert free @ ours @ free == pytest.approx(free @ K @ free, rel=1e-6)
        if preset == "droid":
            assert np.abs(ours - K).max() <= 1e-7 * size


@pytest.mark.slow
def test_the_preset_of_droids_own_files_is_softer(panda: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """DROID's installation copies files over polymetis' own: 400 N/m where polymetis has 750."""
    monkeypatch.setattr(laws, "KX", np.diag([400.0, 400.0, 400.0, 15.0, 15.0, 15.0]))
    goal = laws.State.of(panda, laws.HOME)
    ours = stiffness_of(*laws.controller(panda, "droid_400"), goal.q)
    law = laws.tangent(panda, laws.torques(panda, laws.LAWS["polymetis"], goal)[0], goal.q)
    assert np.abs(ours - law).max() <= 1e-7 * np.abs(law).max()


@pytest.mark.slow
@pytest.mark.parametrize(("preset", "name"), laws.PRESETS.items())
def test_the_ratio_of_a_preset_is_that_of_its_law(preset: str, name: str, panda: ModuleType) -> None:
    """Median over modes and postures, with Franka's rotors."""
    random, ratios = np.random.default_rng(9), []
    for _ in range(10):
        goal = laws.State.of(panda, laws.HOME + random.uniform(-0.3, 0.3, 7))
        twin = laws.LAWS[name].twin(goal)
        K = laws.tangent(panda, laws.torques(panda, laws.LAWS[name], goal)[1], goal.q)
        values, modes = eigh((K + K.T) / 2, goal.M + np.diag(laws.ROTORS))
        ratios.append(np.diag(modes.T @ twin.damping @ modes) / (2 * np.sqrt(values)))
    assert stiffgen.law_preset(preset)[0]["damping_ratio"] == pytest.approx(np.median(ratios), rel=0.1)


@pytest.mark.slow
def test_the_bound_of_serls_preset_is_its_clip(panda: ModuleType) -> None:
    controller, springs = laws.controller(panda, "serl")
    K, clip = laws.SERL_K.diagonal(), laws.SERL_CLIP
    assert controller.config.spring_limit == pytest.approx((K[0] * clip[0], K[3] * clip[3]))
    assert springs["rotation_stiffness"] == pytest.approx(laws.SERL_K[3:, 3:] / 2)


def test_names_without_a_preset_are_refused(robot: ModuleType) -> None:
    """Ask for presets that do not exist: refused with those that do, or with why there is none."""
    with pytest.raises(stiffgen.StiffgenError, match=r'no preset "droit"; there are: crisp, droid, droid_400, serl'):
        stiffgen.law_preset("droit")
    for name in ("robosuite", "isaac_lab", "newton"):
        with pytest.raises(
            stiffgen.StiffgenError, match=rf'preset "{name}": its stiffness is a gain times the inertia'
        ):
            stiffgen.law_preset(name)
    with pytest.raises(TypeError, match="spring_limit"):  # of folders with --spring bounded alone
        laws.controller(robot, "serl")


def test_quaternions_of_rotations_at_every_angle() -> None:
    """Compare quaternions with SciPy's, half turns included."""
    random = np.random.default_rng(7)
    axes = random.normal(size=(40, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    for angle in (0.0, 1e-9, 1e-3, 1.0, 2.5, np.pi - 1e-6):
        R = Rotation.from_rotvec(angle * axes).as_matrix()
        assert laws.rotation_vector(R) == pytest.approx(angle * axes, abs=1e-9)
        assert np.concatenate(laws.quaternion(R)[::-1], -1) == pytest.approx(
            Rotation.from_matrix(R).as_quat(canonical=True), abs=1e-15
        )


first_or_all = pytest.mark.parametrize("count", [1, pytest.param(None, marks=pytest.mark.wide)])
"""Parameters of a test of the first law or preset alone, or of all."""


@pytest.mark.slow
@first_or_all
def test_the_table_is_that_of_the_page(panda: ModuleType, count: int | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Recompute the page's table; its replay near the goal differs by millimetres."""
    monkeypatch.setattr(laws, "LAWS", dict(islice(laws.LAWS.items(), count)))
    page = (laws.PANDA.parents[2] / "docs" / "policies.md").read_text()
    for row in laws.rows(panda):
        assert f"\n| {' | '.join(row)} |" in page, row


@pytest.mark.slow
@first_or_all
def test_presets_serve_goals_as_the_page_says(
    panda: ModuleType, count: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Serve goals by the presets: millimetres from the law's motion, with the controller's own damping."""
    monkeypatch.setattr(laws, "PRESETS", dict(islice(laws.PRESETS.items(), count)))
    page = (laws.PANDA.parents[2] / "docs" / "policies.md").read_text()
    for row in laws.served_rows(panda):
        assert f"| {' | '.join(row)} |" in page, row
