"""Energy account and tank of the controller, against integrals taken outside it."""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from support.controller_inputs import DESIGNS, K, Q, hostile, walk
from support.project import ROOT

PASSIVE = {"tank_initial": 0.0, "tank_minimum": 0.0, "tank_maximum": 10.0}
"""A tank that starts empty: whatever goes out must have come in."""
QUASI_STATIC = {
    "damping_design": "task",
    "joint_damping": 0.4,
    "return_time": 0.0,
    "torque_rate_limit": 1e9,
    "stiffness_rate_limit": 1e9,
    "wrench_filter": "off",
    "limit_zone": 1e-3,
    "effort_limit": 1e4,
}


def port_work(out: Any) -> np.ndarray:
    """Work put out to robot and reference from step to step, from torques and positions alone."""
    motion, shift = np.diff(out.position, axis=0), np.diff(out.reference, axis=0)
    at_reference = out.torque - out.limit_torque  # the limit avoidance acts between the robot and the world
    return np.einsum("ti,ti->t", out.torque[:-1], motion) - np.einsum("ti,ti->t", at_reference[:-1], shift)


def balance(out: Any) -> np.ndarray:
    """What the account leaves unexplained [J]: zero, step by step."""
    stored = out.elastic_energy + out.limit_energy
    put_in = out.variation_total + out.sampling_total + out.antisymmetric_total + out.limiting_total
    moved = out.engaged_total - out.released_total
    return np.asarray(out.port_total + stored - put_in + out.dissipated_total - moved)


@pytest.mark.parametrize("design", range(len(DESIGNS)))
def test_account_telescopes(robot: ModuleType, design: int) -> None:
    """Stored + put out = put in - dissipated to rounding, over motion with stiffness, wrench and reference changing."""
    fields = {"wrench_filter": "off", **DESIGNS[design]}
    inputs = walk(np.random.default_rng(design), robot, 2500)
    inputs["sample_valid"][100:2400:37] = 0
    out = robot.Impedance(**{"tank": "off", **fields}).run(**inputs)
    scale = np.abs(port_work(out)).sum()
    assert scale > 0.1
    assert np.abs(balance(out)).max() <= 1e-12 * scale
    np.testing.assert_allclose(out.port_total[1:], np.cumsum(port_work(out)), atol=1e-12 * scale)


def test_account_through_fallbacks(robot: ModuleType) -> None:
    """What falling back drops and returning sets up is told; steps without a position are counted."""
    inputs = walk(np.random.default_rng(20), robot, 3000)
    inputs["wrench"][400:2900:311] = np.nan
    out = robot.Impedance(return_time=0.1, limit_zone=0.9, limit_stiffness=20.0).run(**inputs)
    assert np.abs(balance(out)).max() <= 1e-12 * np.abs(port_work(out)).sum()
    assert out.released_total[-1] > 0.1
    inputs["q"][1000:1005] = np.nan
    lost = robot.Impedance(return_time=0.1, limit_zone=0.9, limit_stiffness=20.0).run(**inputs)
    assert lost.unaccounted[-1] == 5
    assert np.abs(balance(lost)).max() <= 1e-12 * np.abs(port_work(out)).sum()
    assert robot.Impedance(return_time=0.0).step(q=Q, q0=Q + 0.1, task_stiffness=K).engaged_total > 0.1


def test_terms_against_their_integrals(robot: ModuleType) -> None:
    inputs = walk(np.random.default_rng(0), robot, 2000)
    controller = robot.Impedance(
        stiffness_formula="conventional", tank="off", return_time=0.0, limit_zone=0.9, torque_rate_limit=1e3
    )
    out = controller.run(**inputs)
    S = (out.stiffness + out.stiffness.transpose(0, 2, 1)) / 2
    A = out.stiffness - S
    e, de = out.error, np.diff(out.error, axis=0)

    def form(x: np.ndarray, matrix: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.einsum("ti,tij,tj->t", x, matrix, y)

    np.testing.assert_allclose(out.elastic_energy, form(e, S, e) / 2, rtol=1e-12, atol=1e-14)
    variation = np.cumsum(form(e[1:], np.diff(S, axis=0), e[1:]) / 2)
    np.testing.assert_allclose(out.variation_total[1:], variation, atol=1e-11)
    np.testing.assert_allclose(out.antisymmetric_total[1:], -np.cumsum(form(de, A[:-1], e[:-1])), atol=1e-11)
    dissipated = np.einsum("ti,ti->t", out.damping_torque[:-1], de)
    np.testing.assert_allclose(out.dissipated_total[1:], np.cumsum(dissipated), atol=1e-11)
    np.testing.assert_allclose(out.dissipated_power[1:], dissipated / 1e-3, atol=1e-8)
    np.testing.assert_allclose(out.antisymmetric_power[1:] * 1e-3, np.diff(out.antisymmetric_total), atol=1e-12)
    np.testing.assert_allclose(out.variation_power[1:] * 1e-3, np.diff(out.variation_total), atol=1e-12)
    potential = (
        0.5
        * controller.config.limit_stiffness
        * (np.maximum(robot.LOWER + 0.9 - out.position, 0) ** 2 + np.maximum(out.position - robot.UPPER + 0.9, 0) ** 2)
    )
    np.testing.assert_allclose(out.limit_energy, potential.sum(axis=1), atol=1e-12)
    cut = out.torque - out.elastic_torque - out.damping_torque - out.limit_torque
    limiting = -np.einsum("ti,ti->t", cut[:-1], de)
    np.testing.assert_allclose(out.limiting_total[1:], np.cumsum(limiting), atol=1e-11)
    assert np.abs(limiting).sum() > 1e-3
    held = np.cumsum(form(de, S[:-1], de) / 2)
    limit_held = np.cumsum(np.einsum("ti,ti->t", out.limit_torque[:-1], np.diff(out.position, axis=0)))
    limit_held += out.limit_energy[1:] - out.limit_energy[0]
    np.testing.assert_allclose(out.sampling_total[1:], held + limit_held, atol=1e-11)


def tank_bound(out: Any, initial: float) -> np.ndarray:
    """Work put out so far over what was there to put out; positive entries break passivity."""
    stored = out.elastic_energy + out.limit_energy + out.tank_energy - out.tank_deficit
    given = initial + out.engaged_total - out.released_total
    return np.asarray(out.port_total - (given - stored))


@pytest.mark.parametrize("design", [0, 1, 4, 5, 6, 7, 8, 10, 11])
def test_tank_bounds_what_goes_out(robot: ModuleType, design: int) -> None:
    """Work put out <= stored at the start - stored now, at every step, hostile samples or not."""
    inputs = hostile(np.random.default_rng(design), robot, 4000, 0.002)[0]
    fields = {**DESIGNS[design], "tank_initial": 0.5, "tank_minimum": 0.2, "tank_maximum": 0.8}
    out = robot.Impedance(**fields).run(**inputs)
    known = out.unaccounted == 0
    assert known.sum() > 100
    scale = np.abs(port_work(out)).sum()
    assert tank_bound(out, 0.5)[known].max() <= 1e-12 * scale
    assert out.tank_energy.min() >= 0.2
    assert out.tank_energy.max() <= 0.8
    assert out.tank_deficit.min() >= 0


def cycle(random: np.random.Generator, steps: int, laps: int) -> tuple[np.ndarray, ...]:
    """A random closed orbit of posture and wrench that starts and ends where the spring is at rest."""
    phase = 2 * np.pi * np.arange(steps * laps + 1)[:, None] / steps
    q, dq, wrench = np.tile(Q, (len(phase), 1)), np.zeros((len(phase), 7)), np.zeros((len(phase), 6))
    speed = 2 * np.pi / (steps * 1e-3)
    for k in (1, 2):
        a, b = random.normal(size=(2, 7)) * 0.12 / k
        q += a * np.sin(k * phase) + b * (1 - np.cos(k * phase))
        dq += k * speed * (a * np.cos(k * phase) + b * np.sin(k * phase))
        c, d = random.normal(size=(2, 6)) * np.array([10, 10, 10, 3, 3, 3]) / k
        wrench += c * np.sin(k * phase) + d * np.cos(k * phase)
    wrench += random.normal(size=6) * np.array([15, 15, 15, 6, 6, 6])
    return q, dq, wrench


STEPS, LAPS = 8000, 2
CONTROLLERS: dict[str, dict[str, Any]] = {
    "corrected with tank": PASSIVE,
    "corrected": {"tank": "off"},
    "conventional": {"tank": "off", "stiffness_formula": "conventional"},
}


def test_closed_cycles(robot: ModuleType, record_property: Any) -> None:
    """Posture and wrench round closed orbits, either way: with the tank never more out than in; conventional more.

    Symmetry alone does not do it: the stiffness varies with posture and wrench, and without a tank that returns energy
    too.
    """
    returned: dict[str, list[float]] = {name: [] for name in CONTROLLERS}
    for seed in range(6):
        q, dq, wrench = cycle(np.random.default_rng(seed), STEPS, LAPS)
        for name, fields in CONTROLLERS.items():
            best = -np.inf
            for direction in (1, -1):
                inputs = {"q": q[::direction], "dq": direction * dq[::direction], "wrench": wrench[::direction]}
                out = robot.Impedance(**QUASI_STATIC, **fields).run(**inputs, q0=Q, task_stiffness=K)
                assert not np.any(out.status & int(robot.Status.SATURATED | robot.Status.RATE_LIMITED))
                work = np.cumsum(np.einsum("ti,ti->t", out.torque[:-1], np.diff(inputs["q"], axis=0)))
                best = max(best, *work[[STEPS - 1, -1]])
                if name == "corrected with tank":
                    assert np.all(work + out.elastic_energy[1:] <= 1e-9)
                    assert out.tank_deficit.max() == 0.0
                    assert out.tank_energy.min() >= 0.0
            returned[name].append(float(best))
    for name, values in returned.items():
        record_property(f"most work returned in a cycle, {name} [J]", values)
        print(f"{name:20s}", " ".join(f"{value:8.3f}" for value in values), "J")
    assert max(returned["corrected with tank"]) <= 0.0
    assert np.median(returned["conventional"]) > 0.5


def orbit_work(robot: ModuleType, radius: float, **fields: Any) -> tuple[float, float, float]:
    """(work at the robot, dissipated, put in by holding) once round a circle in joints 2 and 4 at a held wrench."""
    steps = 4000
    phase = 2 * np.pi * np.arange(steps + 1)[:, None] / steps
    speed = 2 * np.pi / (steps * 1e-3)
    u, v = np.eye(7)[1], np.eye(7)[3]
    q = Q + radius * (np.sin(phase) * u + (1 - np.cos(phase)) * v)
    dq = radius * speed * (np.cos(phase) * u + np.sin(phase) * v)
    wrench = np.array([0, 0, 0, 8.0, 8.0, 8.0])
    out = robot.Impedance(**QUASI_STATIC, tank="off", **fields).run(q=q, dq=dq, q0=Q, wrench=wrench, task_stiffness=K)
    return float(port_work(out).sum()), float(out.dissipated_total[-1]), float(out.sampling_total[-1])


def test_conventional_stiffness_returns_the_area_integral_of_its_antisymmetric_part(robot: ModuleType) -> None:
    """W = 2 pi r^2 u^T A v to first order in r, against the orbit's loss; the corrected one only the loss."""
    wrench = np.array([0, 0, 0, 8.0, 8.0, 8.0])
    Kq = robot.hybrid.joint_stiffness_uncorrected(Q, wrench, K)
    predicted = np.pi * (Kq[1, 3] - Kq[3, 1])
    assert abs(predicted) > 5
    radius = 1e-3
    for formula, expected in (("conventional", predicted), ("corrected", 0.0)):
        work, dissipated, held = orbit_work(robot, radius, stiffness_formula=formula)
        assert (work + dissipated - held) / radius**2 == pytest.approx(expected, abs=0.05 * abs(predicted))


def test_without_a_tank_stiffness_variation_can_return_energy(robot: ModuleType) -> None:
    """The symmetric stiffness alone is not passive: stiff while the spring is wound out, soft while it is wound in."""
    n = 2000
    swing = 0.1 * np.sin(np.pi * np.arange(n + 1) / n)[:, None] * np.ones(7)
    stiffness = np.where(np.arange(n + 1) < n // 2, 0.5, 1.5)[:, None, None] * K
    speed = 0.1 * np.pi / n / 1e-3 * np.cos(np.pi * np.arange(n + 1) / n)[:, None] * np.ones(7)
    inputs = {"q": Q + swing, "dq": speed, "q0": Q, "task_stiffness": stiffness}
    free = robot.Impedance(**QUASI_STATIC, tank="off").run(**inputs)
    kept = robot.Impedance(**QUASI_STATIC, **PASSIVE).run(**inputs)
    assert port_work(free).sum() > 0.5
    assert free.variation_total[-1] == pytest.approx(port_work(free).sum(), rel=0.15)
    assert port_work(kept).sum() <= 0.0
    assert np.any(kept.status & int(robot.Status.TANK_LIMITED))


def test_tank_gives_what_it_holds_and_no_more(robot: ModuleType) -> None:
    inputs = {"q": np.tile(Q + 0.1, (600, 1)), "q0": Q, "task_stiffness": np.linspace(1, 4, 600)[:, None, None] * K}
    for content in (0.0, 0.3, 5.0):
        fields = {**PASSIVE, "tank_initial": content, "tank_refill": 0.0}
        out = robot.Impedance(**QUASI_STATIC, **fields).run(**inputs)
        wanted = 0.5 * 0.01 * (out.stiffness_target[-1].sum() - out.stiffness_target[0].sum())
        assert out.variation_total[-1] == pytest.approx(min(content, wanted), rel=1e-6, abs=1e-9)
        assert out.tank_energy[-1] == pytest.approx(max(content - wanted, 0.0), abs=1e-6)
        assert bool(out.status[-1] & int(robot.Status.TANK_LIMITED)) == (wanted > content)


def test_free_motion_settles(robot: ModuleType) -> None:
    """M ddq = tau from a displaced start, with the mass matrix of the moment and no velocity products."""
    controller = robot.Impedance()
    q, dq = Q + 0.1 * np.array([1, -1, 1, -1, 1, -1, 1]), np.zeros(7)
    for _ in range(3000):
        out = controller.step(q=q, dq=dq, q0=Q, wrench=np.zeros(6), task_stiffness=K)
        dq = dq + 1e-3 * np.linalg.solve(out.mass_matrix, out.torque)
        q = q + 1e-3 * dq
    assert np.abs(q - Q).max() < 1e-3
    assert not out.status


def test_energy_cycle_example(robot: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """The printed table: corrected zero, conventional equal to the area integral."""
    script = ROOT / "examples" / "energy_cycle.py"
    package = ModuleType("generated")
    package.iiwa14 = robot
    monkeypatch.setitem(sys.modules, "generated", package)
    spec = importlib.util.spec_from_file_location("energy_cycle", script)
    assert spec is not None and spec.loader is not None
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    trajectory = np.loadtxt(example.TRAJECTORY, delimiter=",")
    q = trajectory[:, trajectory.shape[1] // 2]
    for plane in example.PLANES:
        for radius in (0.01, 0.1):
            scale = abs(example.held(q, plane, radius, "corrected")).max()
            assert abs(example.held(q, plane, radius, "corrected")[-1]) <= 1e-12 * scale
            gained = example.held(q, plane, radius, "conventional")[-1]
            integral = example.area_integral(q, plane, radius, "conventional")
            assert gained == pytest.approx(integral, rel=1e-7)
    small, large = (example.following(q, example.PLANES[0], r, "corrected")[-1] for r in (0.005, 0.01))
    assert np.log2(large / small) == pytest.approx(3.0, abs=0.1)
