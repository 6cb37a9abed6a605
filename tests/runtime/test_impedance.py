"""The impedance controller: values against a NumPy reference, every status bit, and hostile input."""

from __future__ import annotations

import ctypes
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import stiffgen
from stiffgen import open_robot
from stiffgen.emit.fields import CONFIG, INPUT, OUTPUT, STATUS
from support.controller_inputs import DESIGNS, QUICK, TASK_DAMPING, WRENCH, K, Q, hostile, walk
from support.controller_reference import Reference
from support.runtime import WARNINGS, compile_c


def compare(robot: ModuleType, inputs: dict[str, np.ndarray], bound: float = 1e-8, **fields: Any) -> Any:
    words = {key: value for key, value in fields.items() if isinstance(value, str) and key != "tank"}
    controller = robot.Impedance(**{"tank": "off", **fields}, record=len(inputs["q"]))
    out = controller.run(**inputs)
    reference = Reference(robot, controller.config, **words)
    samples = controller.trace[0]
    torque = np.array([reference.step(sample).copy() for sample in samples])
    error = np.abs(out.torque - torque).max(axis=1)
    assert error.max() <= bound, (error.argmax(), error.max(), out.torque[error.argmax()], torque[error.argmax()])
    return out


@pytest.mark.parametrize("design", range(len(DESIGNS)))
def test_torque_against_the_reference(robot: ModuleType, design: int) -> None:
    """Smooth motion, then the same with missed and refused samples sprinkled in."""
    random = np.random.default_rng(design)
    inputs = walk(random, robot, 900)
    # The root of an eigenvalue that is zero but for rounding is not zero but for rounding.
    bound = 1e-4 if "stiffness_sign" in DESIGNS[design] else 1e-8
    compare(robot, inputs, bound, **DESIGNS[design])
    broken = {key: value.copy() for key, value in inputs.items()}
    for step in random.integers(0, 900, 40):
        kind = random.integers(0, 5)
        if kind < 2:
            broken["sample_valid"][step : step + 1 + kind * 2] = 0
        else:
            name = ("q", "dq", "q0", "dq0", "wrench", "task_stiffness")[random.integers(0, 6)]
            broken[name][step].flat[random.integers(0, 6)] = (np.nan, np.inf, -1e308, 1e5)[random.integers(0, 4)]
    compare(robot, broken, bound, **DESIGNS[design])


def test_one_step_is_the_papers_controller(robot: ModuleType) -> None:
    """tau = (Kq + k I)(q0 - q) + (J^T B J + d I)(dq0 - dq) with Kq of the kernels, at the first sample."""
    random = np.random.default_rng(0)
    q0, dq, dq0 = Q + random.normal(size=7) * 0.1, random.normal(size=7) * 0.1, random.normal(size=7) * 0.1
    for formula, kernel in (("corrected", "joint_stiffness"), ("conventional", "joint_stiffness_uncorrected")):
        controller = robot.Impedance(
            **QUICK, damping_design="task", task_damping=TASK_DAMPING, stiffness_formula=formula, joint_damping=0.1
        )
        out = controller.step(q=Q, dq=dq, q0=q0, dq0=dq0, wrench=WRENCH, task_stiffness=K)
        J = robot.hybrid.jacobian(Q)
        Kq = getattr(robot.hybrid, kernel)(Q, WRENCH, K) + np.eye(7)
        B = J.T @ TASK_DAMPING @ J + 0.1 * np.eye(7)
        np.testing.assert_allclose(out.torque, Kq @ (q0 - Q) + B @ (dq0 - dq), rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(out.stiffness, Kq, rtol=1e-13, atol=1e-12)
        assert out.antisymmetric_norm == pytest.approx(np.linalg.norm((Kq - Kq.T) / 2), abs=1e-12)
        assert np.array_equal(out.damping, out.damping.T)
    assert out.antisymmetric_norm > 0.5


def test_corrected_stiffness_stays_bitwise_symmetric(robot: ModuleType) -> None:
    for fields in ({}, {"stiffness_rate_limit": 50.0}, {"nullspace": "projected", "tank_initial": 0.1}):
        out = robot.Impedance(**fields).run(**walk(np.random.default_rng(1), robot, 1500))
        assert np.array_equal(out.stiffness, out.stiffness.transpose(0, 2, 1))
        assert np.array_equal(out.damping, out.damping.transpose(0, 2, 1))
        assert out.antisymmetric_norm.max() == 0.0
        assert np.linalg.eigvalsh(out.damping).min() > 0


# ---- status bits: each is set by its cause, and the torque stays finite, limited and without a jump


@pytest.fixture(scope="module")
def settled() -> dict[str, Any]:
    return {"q": Q, "q0": Q + 0.05, "wrench": WRENCH, "task_stiffness": K}


def names(robot: ModuleType, status: int) -> set[str]:
    return {flag.name for flag in robot.Status if flag & int(status)}


def prepared(robot: ModuleType, settled: dict[str, Any], **fields: Any) -> Any:
    controller = robot.Impedance(**fields)
    controller.run(**{**settled, "q": np.tile(Q, (1000, 1))})
    return controller


def bad_inputs() -> list[tuple[str, Any, str]]:
    rows: list[tuple[str, Any, str]] = []
    for name in ("q", "dq", "q0", "dq0", "wrench", "task_stiffness"):
        rows += [(name, value, "NON_FINITE") for value in (np.nan, np.inf, -np.inf)]
        rows += [(name, value, "OUT_OF_RANGE") for value in (1e308, -1e308, 1e5)]
    rows += [("task_stiffness", "asymmetric", "TASK_STIFFNESS"), ("task_stiffness", "negative", "TASK_STIFFNESS")]
    return rows


@pytest.mark.parametrize(("name", "value", "bit"), bad_inputs())
def test_refused_input(robot: ModuleType, settled: dict[str, Any], name: str, value: Any, bit: str) -> None:
    controller = prepared(robot, settled)
    before = controller.step(**settled)
    assert before.status == 0
    bad = np.array(settled.get(name, np.zeros(7)), float)
    if value == "asymmetric":
        bad[0, 1] += 1.0
    elif value == "negative":
        bad[0, 0] = -1.0
    else:
        bad.flat[-1] = value
    broken = {"dq": np.full(7, 0.1), **settled, name: bad}
    out = controller.step(**broken)
    assert {bit, "FALLBACK"} <= names(robot, out.status)
    step = controller.config.torque_rate_limit * 1e-3
    assert np.all(np.abs(out.torque - before.torque) <= step * (1 + 1e-12))
    for _ in range(200):
        out = controller.step(**broken)
    if name != "dq":  # pure damping, with the damping of the last good step
        np.testing.assert_allclose(out.torque, -before.damping @ broken["dq"], rtol=1e-12, atol=1e-12)
    else:
        assert np.abs(out.torque).max() < 1e-3  # the stale velocity has faded
    assert np.all(np.isfinite([*out.torque, *out.velocity, *out.position]))
    back = controller.step(**settled)
    assert names(robot, back.status) == {"RETURNING"} | (names(robot, back.status) & {"RATE_LIMITED"})
    after = controller.run(**{**settled, "q": np.tile(Q, (1000, 1))})
    assert after.status[-1] == 0
    np.testing.assert_allclose(after.torque[-1], before.torque, rtol=1e-9)
    assert np.abs(np.diff(after.torque, axis=0)).max() < np.abs(before.torque).max() * 0.03  # smooth


def test_stale_velocity_fades_and_is_the_last_good_one(robot: ModuleType, settled: dict[str, Any]) -> None:
    controller = prepared(robot, settled, torque_rate_limit=1e9)
    dq = np.linspace(-0.2, 0.2, 7)
    controller.step(**{**settled, "dq": dq})
    out = controller.run(**{**settled, "dq": np.tile(np.full(7, np.nan), (30, 1))})
    fade = np.exp(-np.arange(1, 31) * 1e-3 / 0.02)
    np.testing.assert_allclose(out.velocity, fade[:, None] * dq, rtol=1e-12)
    np.testing.assert_allclose(out.torque, -np.einsum("tij,tj->ti", out.damping, out.velocity), rtol=1e-12, atol=1e-14)


def test_a_robot_that_is_too_fast_is_braked(robot: ModuleType, settled: dict[str, Any]) -> None:
    controller = prepared(robot, settled, torque_rate_limit=1e9)
    limit = controller.config.velocity_limit
    out = controller.step(**{**settled, "dq": 3 * limit})
    assert {"OUT_OF_RANGE", "FALLBACK"} <= names(robot, out.status)
    np.testing.assert_array_equal(out.velocity, limit)
    np.testing.assert_allclose(out.damping_torque, -out.damping @ limit, rtol=1e-12)


def test_missed_samples_hold_then_fall_back_then_return(robot: ModuleType, settled: dict[str, Any]) -> None:
    controller = prepared(robot, settled, missed_limit=4)
    before = controller.step(**settled)
    for k in range(1, 4):
        out = controller.step(sample_valid=0)
        assert names(robot, out.status) == {"MISSED"}
        assert out.missed == k
        assert np.array_equal(out.torque, before.torque)
    out = controller.step(sample_valid=0)
    assert {"MISSED", "WATCHDOG", "FALLBACK"} <= names(robot, out.status)
    outs = [controller.step(sample_valid=0) for _ in range(300)]
    assert np.abs(outs[-1].torque).max() < 1e-6
    out = controller.step(**settled)
    assert "RETURNING" in names(robot, out.status)
    assert np.abs(out.torque).max() < 1e-6
    after = controller.run(**{**settled, "q": np.tile(Q, (600, 1))})
    assert after.status[-1] == 0
    # A single miss costs nothing: the controller goes on.
    controller.step(sample_valid=0)
    assert controller.step(**settled).status == 0


def test_input_of_zeros_is_a_missed_sample(robot: ModuleType, settled: dict[str, Any]) -> None:
    controller = prepared(robot, settled)
    assert "MISSED" in names(robot, controller.step(sample_valid=0).status)


def test_start_is_smooth(robot: ModuleType, settled: dict[str, Any]) -> None:
    out = robot.Impedance().run(**{**settled, "q": np.tile(Q, (700, 1))})
    assert np.abs(out.torque[0]).max() == 0.0
    assert "RETURNING" in names(robot, out.status[0])
    assert out.status[-1] == 0
    assert np.abs(np.diff(out.torque, axis=0)).max() < 0.01 * np.abs(out.torque[-1]).max()


def test_joint_limit_torque_grows_and_is_conservative(robot: ModuleType) -> None:
    controller = robot.Impedance(**QUICK, joint_damping=0.0, damping_ratio=0.0, limit_zone=0.2, limit_stiffness=100.0)
    depths = np.linspace(-0.05, 0.25, 301)
    for side, limit in ((1, robot.UPPER[3]), (-1, robot.LOWER[3])):
        q = np.tile(Q, (301, 1))
        q[:, 3] = limit - side * 0.2 + side * depths
        out = controller.run(q=q, q0=q, task_stiffness=np.zeros((6, 6)))
        np.testing.assert_allclose(out.torque[:, 3], -side * 100 * np.maximum(depths, 0), atol=1e-9)
        inside = np.array(["JOINT_LIMIT" in names(robot, s) for s in out.status])
        assert np.array_equal(inside[np.abs(depths) > 1e-9], (depths > 0)[np.abs(depths) > 1e-9])
        np.testing.assert_allclose(out.limit_energy, 50 * np.maximum(depths, 0) ** 2, atol=1e-9)
        controller.reset()


def test_saturation_and_rate_limit(robot: ModuleType, settled: dict[str, Any]) -> None:
    far = {**settled, "q": np.tile(Q, (4000, 1)), "q0": Q + np.array([0, 0, 0, 0.7, 0, 0, 0])}
    out = robot.Impedance(effort_limit=5.0, torque_rate_limit=20.0, return_time=0.0).run(**far)
    assert np.abs(out.torque).max() == 5.0
    steps = np.abs(np.diff(np.vstack([np.zeros(7), out.torque]), axis=0))
    assert steps.max() == pytest.approx(0.02, rel=1e-9)
    assert {"SATURATED", "RATE_LIMITED"} <= names(robot, out.status[0])
    assert names(robot, out.status[-1]) >= {"SATURATED"} and "RATE_LIMITED" not in names(robot, out.status[-1])
    parts = out.elastic_torque[-1] + out.damping_torque[-1] + out.limit_torque[-1]
    np.testing.assert_array_equal(out.torque[-1], np.clip(parts, -5, 5))


def test_effort_limit_lowered_at_run_time_holds_at_once(robot: ModuleType, settled: dict[str, Any]) -> None:
    controller = prepared(robot, settled)
    controller._config[0]["effort_limit"] = 1.0
    assert np.abs(controller.step(**settled).torque).max() <= 1.0


def test_stiffness_rate_limit_bit_and_rate(robot: ModuleType, settled: dict[str, Any]) -> None:
    controller = prepared(robot, settled, stiffness_rate_limit=2000.0, tank="off")
    out = controller.run(**{**settled, "q": np.tile(Q, (2500, 1)), "task_stiffness": 3 * K})
    assert "STIFFNESS_RATE" in names(robot, out.status[0])
    rates = np.linalg.norm(np.diff(out.stiffness, axis=0), axis=(1, 2)) / 1e-3
    assert rates.max() == pytest.approx(2000.0, rel=1e-9)
    assert out.status[-1] == 0
    np.testing.assert_array_equal(out.stiffness[-1], out.stiffness_target[-1])


def test_tank_bits(robot: ModuleType, settled: dict[str, Any]) -> None:
    fields = {"tank_initial": 0.1, "tank_minimum": 0.1, "tank_refill": 0.0}
    controller = prepared(robot, settled, **fields)
    out = controller.run(**{**settled, "q": np.tile(Q, (50, 1)), "task_stiffness": 3 * K})
    assert "TANK_LIMITED" in names(robot, out.status[-1])
    assert "TANK_DEFICIT" not in names(robot, out.status[-1])
    assert out.tank_energy.min() >= 0.1
    # Saturation keeps the robot from being given what the spring stores: nobody has paid for that energy.
    controller = robot.Impedance(**fields, effort_limit=0.5, return_time=0.0)
    q = Q + 0.2 * np.linspace(0, 1, 500)[:, None]
    out = controller.run(q=q, q0=Q, task_stiffness=K)
    assert "TANK_DEFICIT" in names(robot, out.status[-1])
    assert out.tank_energy.min() >= 0.1


def test_indefinite_stiffness_is_told_and_can_be_lifted(robot: ModuleType) -> None:
    push = np.array([-120.0, 60, -150, 5, 8, -6])
    for sign, expected in (("as_is", True), ("positive_part", False)):
        out = robot.Impedance(**QUICK, stiffness_sign=sign).step(q=Q, q0=Q + 0.05, wrench=push, task_stiffness=K * 0.05)
        assert ("INDEFINITE" in names(robot, out.status)) == expected
        assert (np.linalg.eigvalsh(out.stiffness).min() < -1e-6) == expected
        assert np.linalg.eigvalsh(out.damping).min() > 0


def test_singular_posture_is_told(robot: ModuleType) -> None:
    stretched = np.array([0.0, 0.4, 0.0, 0.0, 0.0, 0.3, 0.0])
    controller = robot.Impedance(**QUICK, nullspace="projected")
    assert "SINGULAR" not in names(robot, controller.step(q=Q, q0=Q, task_stiffness=K).status)
    out = controller.step(q=stretched, q0=stretched, task_stiffness=K)
    assert "SINGULAR" in names(robot, out.status)
    assert out.singularity < 1e-3
    assert np.all(np.isfinite(out.stiffness))


MASSLESS = """<robot name="arm"><link name="a"/><link name="b"/><link name="c">{inertial}</link>
<joint name="one" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" effort="{effort}" velocity="2"/></joint>
<joint name="two" type="{type}"><parent link="b"/><child link="c"/><origin xyz="1 0 0"/><axis xyz="0 1 0"/>
{limit}</joint><link name="d"/><joint name="t" type="fixed"><parent link="c"/><child link="d"/>
<origin xyz="0.5 0 0"/></joint></robot>"""
LIMIT = '<limit lower="-2" upper="2" effort="10" velocity="2"/>'


def small_robot(folder: Path, name: str, **values: str) -> ModuleType:
    text = {"inertial": "", "type": "revolute", "effort": "10", "limit": LIMIT, **values}
    path = folder / f"{name}.urdf"
    path.write_text(MASSLESS.format(**text))
    return open_robot(stiffgen.generate(path, name=name, output=folder)).module


def test_mass_matrix_that_is_not_positive_definite(tmp_path: Path) -> None:
    arm = small_robot(tmp_path, "massless")
    for fields in ({}, {"damping_design": "factorised"}, {"nullspace": "projected"}):
        out = arm.Impedance(**fields, joint_damping=0.5, **QUICK).run(
            q=np.tile([0.1, 0.2], (5, 1)), q0=[0.2, 0.2], dq=[0.1, 0.0], task_stiffness=K
        )
        assert "MASS_MATRIX" in names(arm, out.status[-1])
        np.testing.assert_array_equal(out.damping[-1], 0.5 * np.eye(2))
        if "nullspace" in fields:  # never computed: it is that of the last good step still, and there was none
            np.testing.assert_array_equal(out.stiffness_target, np.zeros((5, 2, 2)))
        assert np.all(np.isfinite(out.torque))
    # The paper's design needs no mass matrix.
    out = arm.Impedance(damping_design="task", task_damping=TASK_DAMPING, **QUICK).step(
        q=[0.1, 0.2], q0=[0.2, 0.2], task_stiffness=K
    )
    J = arm.hybrid.jacobian(np.array([0.1, 0.2]))
    np.testing.assert_allclose(out.damping, J.T @ TASK_DAMPING @ J + 0.1 * np.eye(2), rtol=1e-12, atol=1e-12)


def test_a_robot_without_limits_in_its_urdf_must_be_given_some(tmp_path: Path) -> None:
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    arm = small_robot(tmp_path, "endless", type="continuous", limit="", inertial=inertial)
    with pytest.raises(ValueError, match="velocity_limit"):
        arm.Impedance()
    limits = {"velocity_limit": 3.0, "effort_limit": 10.0, "torque_rate_limit": 100.0, "limit_stiffness": [10.0, 0.0]}
    with pytest.raises(ValueError, match="effort_limit"):
        arm.Impedance(**{**limits, "effort_limit": [10.0, np.inf]})
    out = arm.Impedance(**limits).run(q=np.tile([0.1, 7.0], (9, 1)), q0=[0.1, 7.1], task_stiffness=K)
    assert np.all(np.isfinite(out.torque))
    assert "JOINT_LIMIT" not in names(arm, out.status[-1])
    idle = small_robot(tmp_path, "idle", effort="0", inertial=inertial)  # many URDFs have zeros there
    with pytest.raises(ValueError, match="effort_limit"):
        idle.Impedance()


# ---- configuration


BAD_CONFIG: list[tuple[str, Any]] = [
    ("sample_time", 0.0), ("sample_time", 1.0), ("sample_time", np.nan),
    ("representation", 0), ("representation", 4), ("stiffness_formula", 0), ("stiffness_sign", 3),
    ("stiffness_rate_limit", 0.0), ("stiffness_rate_limit", np.inf), ("nullspace", 0),
    ("nullspace_stiffness", -1.0), ("nullspace_stiffness", 0.0), ("nullspace_stiffness", np.nan),
    ("singularity_threshold", 0.0), ("damping_design", 0), ("damping_ratio", [0.7] * 6 + [-0.1]),
    ("damping_ratio", np.nan), ("task_damping", TASK_DAMPING), ("task_damping", np.nan), ("joint_damping", -1.0),
    ("joint_damping", np.inf), ("wrench_filter", 0), ("wrench_time_constant", 0.0), ("wrench_window", 0),
    ("wrench_window", 33), ("lower_limit", 9.0), ("upper_limit", np.nan), ("position_tolerance", -1.0),
    ("limit_zone", 0.0), ("limit_zone", 2.5), ("limit_stiffness", -1.0), ("velocity_limit", 0.0),
    ("velocity_limit", np.inf), ("force_limit", 0.0), ("moment_limit", np.nan), ("task_stiffness_limit", 0.0),
    ("task_stiffness_limit", 1e10), ("effort_limit", 0.0), ("effort_limit", np.inf), ("torque_rate_limit", 0.0),
    ("missed_limit", 0), ("missed_limit", 1001), ("velocity_decay_time", 0.0), ("return_time", -1.0), ("tank", 0),
    ("tank_initial", 9.0), ("tank_initial", 0.0), ("tank_maximum", np.inf), ("tank_minimum", -1.0),
    ("tank_refill", 1.1), ("tank_refill", np.nan),
]  # fmt: skip


@pytest.mark.parametrize(("name", "value"), BAD_CONFIG)
def test_refused_configuration_names_the_field(robot: ModuleType, name: str, value: Any) -> None:
    with pytest.raises(ValueError) as refusal:
        robot.Impedance({name: value})
    assert name in str(refusal.value).split(":")[0]


def test_configurations_that_would_mislead_are_refused(robot: ModuleType) -> None:
    for fields, word in (
        ({"stiffness_formula": "conventional", "tank": "on"}, "tank"),
        ({"stiffness_formula": "conventional", "tank": "off", "stiffness_sign": "positive_part"}, "stiffness_sign"),
        ({"nullspace": "off"}, "nullspace_stiffness"),
    ):
        with pytest.raises(ValueError, match=word):
            robot.Impedance(**fields)
    with pytest.raises(TypeError, match="damping_ratio"):
        robot.Impedance(damping_ration=0.7)
    with pytest.raises(ValueError, match="modal, factorised, task"):
        robot.Impedance(damping_design="diagonal")
    with pytest.raises(ValueError, match="shape"):
        robot.Impedance().step(q=np.zeros(6), q0=Q, task_stiffness=K)
    with pytest.raises(TypeError, match="task_stiffness"):
        robot.Impedance().run(stiffness=K)


def test_configuration_broken_at_run_time_moves_the_torque_to_zero(robot: ModuleType, settled: dict[str, Any]) -> None:
    controller = prepared(robot, settled, record=500, torque_rate_limit=20.0)
    before = controller.step(**settled)
    last = before.torque
    assert 1.0 < np.abs(last).max() < 21.0
    controller._config[0]["sample_time"] = np.nan
    step = controller.config.torque_rate_limit * 1e-3
    outputs = np.zeros(1, controller._record[1].dtype)
    inputs = np.zeros(1, controller._record[0].dtype)
    module = __import__("sys").modules[type(controller).__module__]
    for count in range(1100):
        code = module._c.run(controller._config, controller._state, inputs, outputs, 1)
        assert "sample_time" in module._c.error_text(code)
        assert {"CONFIG", "FALLBACK"} <= names(robot, outputs["status"][0])
        np.testing.assert_allclose(
            np.abs(outputs["torque"][0]), np.maximum(np.abs(before.torque) - (count + 1) * step, 0.0), atol=1e-9
        )
        last = outputs["torque"][0].copy()
        for term in ("elastic_torque", "damping_torque", "limit_torque", "error", "elastic_energy", "limit_energy"):
            assert np.abs(outputs[term]).max() == 0.0
    assert np.abs(last).max() == 0.0
    assert outputs["released_total"][0] == before.released_total + before.elastic_energy + before.limit_energy
    assert before.elastic_energy > 0.1
    state = np.zeros_like(controller._state)
    code = module._c.run(controller._config, state, inputs, outputs, 1)
    assert "not initialised" in module._c.error_text(code)
    assert np.abs(outputs["torque"]).max() == 0 and "CONFIG" in names(robot, outputs["status"][0])
    with pytest.raises(ValueError, match="buffer"):
        module._c.run(controller._config, controller._state, inputs, outputs, 2)


def test_missing_arguments_are_told(robot: ModuleType, settled: dict[str, Any]) -> None:
    controller = prepared(robot, settled, record=1)
    module = __import__("sys").modules[type(controller).__module__]
    library = ctypes.CDLL(module._c.__file__)
    config, state = controller._config, controller._state
    inputs, outputs = (np.zeros(1, record.dtype) for record in controller._record)

    def call(function: str, *arrays: np.ndarray | None) -> str:
        pointers = [None if a is None else a.ctypes.data_as(ctypes.c_void_p) for a in arrays]
        code = getattr(library, f"iiwa14_impedance_{function}")(*pointers)
        return str(module._c.error_text(code)) if code else ""

    assert call("validate", config) == call("init", config, state) == ""
    assert call("validate", None) == call("init", None, state) == call("init", config, None)
    missing = call("validate", None)
    assert "NULL" in missing
    assert call("init", config, state) == ""
    assert call("step", config, state, inputs, None) == missing
    for arrays in ((None, state, inputs), (config, None, inputs), (config, state, None)):
        outputs["torque"] = 7.0
        assert call("step", *arrays, outputs) == missing
        assert {"CONFIG", "FALLBACK"} <= names(robot, outputs["status"][0])
        assert np.abs(outputs["torque"]).max() == 0.0


def test_fallback_before_any_good_sample_damps_with_the_joint_damping(robot: ModuleType) -> None:
    dq = np.linspace(0.1, 0.4, 7)
    controller = robot.Impedance(joint_damping=0.3, torque_rate_limit=1e9)
    out = controller.step(q=Q, dq=dq, q0=np.full(7, np.nan), task_stiffness=K)
    assert {"NON_FINITE", "FALLBACK"} <= names(robot, out.status)
    np.testing.assert_allclose(out.torque, -0.3 * dq, rtol=1e-15)
    np.testing.assert_array_equal(out.damping, 0.3 * np.eye(7))


def test_energy_of_the_limit_zone_is_dropped_with_the_position(robot: ModuleType) -> None:
    q = Q.copy()
    q[3] = robot.LOWER[3] + 0.04
    controller = robot.Impedance(**QUICK, missed_limit=1)
    before = controller.step(q=q, q0=q, task_stiffness=K)
    assert before.limit_energy > 0.01 and before.limit_torque[3] > 0
    out = controller.step(sample_valid=0)
    assert out.limit_energy == 0.0 and np.abs(out.limit_torque).max() == 0.0
    assert out.released_total == pytest.approx(before.limit_energy + before.elastic_energy, rel=1e-14)
    back = controller.step(q=q, q0=q, task_stiffness=K)
    assert back.engaged_total == pytest.approx(2 * before.limit_energy, rel=1e-12)
    assert back.limit_energy > 0.01
    controller._config[0]["sample_time"] = np.nan
    with pytest.raises(ValueError, match="sample_time"):
        controller.step(q=q, q0=q, task_stiffness=K)
    controller._config[0]["sample_time"] = 1e-3
    after = controller.step(sample_valid=0)
    assert after.released_total - back.released_total == pytest.approx(
        back.limit_energy + back.elastic_energy, rel=1e-12
    )


def test_semidefinite_stiffness_is_not_called_indefinite(robot: ModuleType) -> None:
    """J^T K J of seven joints has rank six: its smallest eigenvalue is a rounding error of either sign."""
    random = np.random.default_rng(4)
    for _ in range(50):
        q = random.uniform(-1, 1, 7) * 1.5
        controller = robot.Impedance(**QUICK, nullspace="off", nullspace_stiffness=0.0)
        out = controller.step(q=q, q0=q, task_stiffness=K)
        assert abs(out.eigenvalues[0]) < 1e-6 * out.eigenvalues[-1]
        assert "INDEFINITE" not in names(robot, out.status)


# ---- filters


def test_moving_average_is_the_mean_of_the_raw_samples(robot: ModuleType) -> None:
    random = np.random.default_rng(3)
    wrench = random.normal(size=(200, 6)) * 5
    for window in (1, 3, 32):
        out = robot.Impedance(wrench_filter="moving_average", wrench_window=window).run(
            q=np.tile(Q, (200, 1)), q0=Q, wrench=wrench, task_stiffness=K
        )
        expected = [wrench[max(0, k - window + 1) : k + 1].mean(axis=0) for k in range(200)]
        np.testing.assert_allclose(out.wrench, expected, rtol=1e-12, atol=1e-13)


def test_first_order_filter_has_its_time_constant(robot: ModuleType) -> None:
    wrench = np.zeros((300, 6))
    wrench[1:] = WRENCH
    out = robot.Impedance(wrench_filter="first_order", wrench_time_constant=0.05).run(
        q=np.tile(Q, (300, 1)), q0=Q, wrench=wrench, task_stiffness=K
    )
    expected = WRENCH * (1 - np.exp(-np.arange(300) * 1e-3 / 0.05))[:, None]
    np.testing.assert_allclose(out.wrench, expected, rtol=1e-12, atol=1e-14)


# ---- hostile input


@pytest.mark.parametrize("design", [0, 3, 4, 5, 6, 7])
def test_hostile_input(robot: ModuleType, design: int) -> None:
    inputs, bad = hostile(np.random.default_rng(100 + design), robot, 6000, 0.01)
    controller = robot.Impedance(**{"tank": "off", **DESIGNS[design]})
    out = controller.run(**inputs)
    for name in out.dtype.names:
        assert np.all(np.isfinite(out[name])), name
    assert np.all(np.abs(out.torque) <= controller.config.effort_limit)
    steps = np.abs(np.diff(np.vstack([np.zeros(7), out.torque]), axis=0))
    assert np.all(steps <= controller.config.torque_rate_limit * 1e-3 * (1 + 1e-12))
    seen = bad[inputs["sample_valid"][bad] == 1]
    mask = robot.Status.NON_FINITE | robot.Status.OUT_OF_RANGE | robot.Status.TASK_STIFFNESS
    assert np.all(out.status[seen] & int(mask))
    assert np.all(out.status[seen] & int(robot.Status.FALLBACK))
    assert np.all(out.status[inputs["sample_valid"] == 0] & int(robot.Status.MISSED))
    recovered = controller.run(**walk(np.random.default_rng(7), robot, 1500))
    assert not np.any(recovered.status[800:] & int(robot.Status.FALLBACK | robot.Status.RETURNING))


# ---- Python and C sides


def test_steps_and_runs_agree_and_are_recorded(robot: ModuleType) -> None:
    inputs = walk(np.random.default_rng(8), robot, 40)
    a, b = robot.Impedance(record=25), robot.Impedance()
    one = [a.step(**{name: value[k] for name, value in inputs.items()}) for k in range(40)]
    many = b.run(**inputs)
    assert np.array_equal(np.array([record.torque for record in one]), many.torque)
    recorded_inputs, recorded = a.trace
    assert len(recorded) == 25
    assert np.array_equal(recorded.torque, many.torque[-25:])
    assert np.array_equal(recorded_inputs.q, inputs["q"][-25:])
    assert len(b.trace[0]) == 0
    a.reset()
    assert np.array_equal(a.run(**inputs).stiffness, many.stiffness)


def test_threads_do_not_disturb_one_another(robot: ModuleType) -> None:
    inputs = walk(np.random.default_rng(9), robot, 2000)
    expected = robot.Impedance().run(**inputs).torque
    with ThreadPoolExecutor(4) as pool:
        results = list(pool.map(lambda _: robot.Impedance().run(**inputs).torque, range(8)))
    assert all(np.array_equal(result, expected) for result in results)


def test_the_tables_of_fields_and_bits(robot: ModuleType) -> None:
    controller = robot.Impedance(record=1)
    assert controller.config.dtype.names == tuple(field.name for field in CONFIG)
    assert controller._record[0].dtype.names == tuple(field.name for field in INPUT)
    assert controller._record[1].dtype.names == tuple(field.name for field in OUTPUT)
    assert [flag.name for flag in robot.Status] == [name.upper() for name, _ in STATUS]
    assert [int(flag) for flag in robot.Status] == [1 << k for k in range(len(STATUS))]
    np.testing.assert_array_equal(controller.config.lower_limit, robot.LOWER)
    np.testing.assert_array_equal(controller.config.effort_limit, robot.EFFORT)


@pytest.mark.parametrize("compiler", ["gcc", "clang", "g++", "clang++"])
def test_compiles_without_warnings(robot_folder: Path, compiler: str, tmp_path: Path) -> None:
    language = ("-x", "c++") if compiler.endswith("++") else ("-std=c99",)
    source = robot_folder / "iiwa14_impedance.c"
    compile_c(tmp_path / "x.o", *language, *WARNINGS, "-O2", "-c", source, compiler=compiler)


def test_objects_call_nothing_but_libm(robot_folder: Path, tmp_path: Path) -> None:
    """Undefined symbols are mathematical functions, memory moves, and the robot's own."""
    allowed = {"cos", "sin", "sincos", "sqrt", "exp", "expm1", "fabs", "memcpy", "memset", "memmove"}
    own, undefined = set(), set()
    for source in ("iiwa14.c", "iiwa14_impedance.c"):
        compile_c(tmp_path / "x.o", "-std=c99", "-O2", "-fno-pie", "-c", robot_folder / source)
        done = subprocess.run(["nm", tmp_path / "x.o"], capture_output=True, text=True, check=True)
        for line in done.stdout.splitlines():
            *_, kind, name = line.split()
            (undefined if kind == "U" else own).add(name)
            assert kind not in "dDbBC", f"{source} has a variable that changes: {name}"
    assert undefined - own - {"_GLOBAL_OFFSET_TABLE_", "__stack_chk_fail"} <= allowed


def test_stack_of_the_call_path(robot_folder: Path, tmp_path: Path) -> None:
    """The sum over ALL functions, more than any path, with the deepest kernel twice, stays below 32 KiB."""
    total, kernels = 0, [0]
    for source in ("iiwa14.c", "iiwa14_impedance.c"):
        stem = tmp_path / Path(source).stem
        compile_c(
            stem.with_suffix(".o"), "-std=c99", "-O2", "-fstack-usage", "-c", robot_folder / source, compiler="gcc"
        )
        for line in stem.with_suffix(".su").read_text().splitlines():
            _, size, kind = line.split("\t")
            assert kind in ("static", "dynamic,bounded")
            if source == "iiwa14.c":
                kernels.append(int(size))
            else:
                total += int(size)
    print(f"stack of the controller {total} B, deepest kernel {max(kernels)} B")
    assert total + 2 * max(kernels) < 32 * 1024


def chain_of(joints: int, folder: Path) -> Path:
    inertial = '<inertial><mass value="1"/><origin xyz="0.05 0 0"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" '
    inertial += 'ixz="0" iyz="0"/></inertial>'
    links = "".join(f'<link name="l{k}">{inertial}</link>' for k in range(joints + 1))
    limit = '<limit lower="-2" upper="2" effort="50" velocity="2"/>'
    moving = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/><origin xyz="0.1 0 0"/>'
        f'<axis xyz="{["0 0 1", "0 1 0", "1 0 0"][k % 3]}"/>{limit}</joint>'
        for k in range(joints)
    )
    path = folder / f"chain{joints}.urdf"
    path.write_text(f'<robot name="chain{joints}">{links}{moving}</robot>')
    return path


def deepest_kernel(source: str, frames: dict[str, int]) -> int:
    """Most stack [B] of a kernel that the controller calls: its frame and the largest of those that it names.

    The batch functions need more, and the controller does not call them.
    """
    most = 0
    for name in (name for name in frames if name.startswith("chain32_") and not name.endswith("_batch")):
        body = source[source.index(f"void {name}(") :].split("\n}\n")[0]
        called = [size for helper, size in frames.items() if helper != name and f"{helper}(" in body]
        most = max(most, frames[name] + max(called, default=0))
    return most


@pytest.mark.slow
def test_controller_of_32_joints_and_none_beyond(tmp_path: Path) -> None:
    folder = stiffgen.generate(chain_of(32, tmp_path), output=tmp_path)
    arm = open_robot(folder).module
    random = np.random.default_rng(0)
    inputs = {
        "q": random.uniform(-1, 1, 32) + 0.1 * np.sin(np.arange(40)[:, None] * 1e-2 + random.uniform(0, 6, 32)),
        "q0": random.uniform(-1, 1, (40, 32)),
        "wrench": WRENCH,
        "task_stiffness": K,
        "dq": random.normal(size=(40, 32)) * 0.1,
    }
    compare(arm, inputs, 1e-7, return_time=0.01)
    total, kernels = 0, 0
    for source in ("chain32.c", "chain32_impedance.c"):
        stem = tmp_path / Path(source).stem
        compile_c(stem.with_suffix(".o"), "-std=c99", "-O2", "-fstack-usage", "-c", folder / source, compiler="gcc")
        usage = (line.split("\t") for line in stem.with_suffix(".su").read_text().splitlines())
        frames = {place.split(":")[-1]: int(size) for place, size, *_ in usage}
        if source == "chain32.c":
            kernels = deepest_kernel((folder / source).read_text(), frames)
        else:
            total += sum(frames.values())
    print(f"stack of the controller {total} B, deepest kernel with what it calls {kernels} B")
    assert total + kernels < 32 * 1024
    beyond = stiffgen.generate(chain_of(33, tmp_path), output=tmp_path, build=False)
    assert not list(beyond.glob("*impedance*"))
    assert "32 coordinates" in (beyond / "README.md").read_text()
