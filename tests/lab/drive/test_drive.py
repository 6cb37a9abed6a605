# SPDX-License-Identifier: MIT
"""The drive of a ball joint against the springs, differences of its energy, modes, work round orbits, and its C."""

from __future__ import annotations

import ctypes
import subprocess
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
import scipy.linalg

from stiffgen import drive
from stiffgen.families.springs import parts as spring_parts
from support.c_program import STRICT, language_flags

FORMS = ("trace", "log")
ANGLES = (0.0, 1e-9, 1e-3, 0.0199, 0.0201, 0.5, 1.5, 2.5, 3.1)


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the product of quaternions (x, y, z, w)."""
    vector = a[..., 3:] * b[..., :3] + b[..., 3:] * a[..., :3] + np.cross(a[..., :3], b[..., :3])
    return np.concatenate([vector, a[..., 3:] * b[..., 3:] - (a[..., :3] * b[..., :3]).sum(-1, keepdims=True)], axis=-1)


def quaternion(vector: np.ndarray) -> np.ndarray:
    """Return the quaternion of a rotation vector."""
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.concatenate([0.5 * np.sinc(angle / 2 / np.pi) * vector, np.cos(angle / 2)], axis=-1)


def matrix(a: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of a unit quaternion."""
    x, y, z, w = a
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def positive(random: np.random.Generator, scale: float) -> np.ndarray:
    """Draw a symmetric positive definite matrix."""
    A = random.normal(size=(3, 3))
    return scale * (A @ A.T + 0.3 * np.eye(3))


def cases() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draw bodies and targets (27, 4) with the angles of ANGLES between them, and stiffnesses (27, 3, 3)."""
    random = np.random.default_rng(51)
    angles = np.repeat(ANGLES, 3)
    axes = random.normal(size=(len(angles), 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    target = random.normal(size=(len(angles), 4))
    target /= np.linalg.norm(target, axis=1, keepdims=True)
    stiffness = np.array([positive(random, 10.0) for _ in angles])
    # half of the bodies with the other sign of the quaternion, all with a length that does not count
    sign = np.where(np.arange(len(angles)) % 2, -1.3, 0.7)[:, None]
    return sign * product(target, quaternion(angles[:, None] * axes)), target, stiffness


def spring(form: str):
    """Return energy, torque and stiffness in the body's axes, by the symbolic parts of stiffgen's springs."""
    R, H, K = ca.SX.sym("R", 3, 3), ca.SX.sym("H", 4, 4), ca.SX.sym("K", 3, 3)
    if form == "trace":
        terms = spring_parts.trace_form(R, H, K, "equilibrium")
    else:
        terms = spring_parts.by_quaternion(R, H, K, "equilibrium", spring_parts.rotation_vector_factor, "")
    return ca.Function("spring", [R, H, K], [terms.V, -R.T @ terms.F[3:], R.T @ terms.K[3:, 3:] @ R])


@pytest.mark.parametrize("form", FORMS)
def test_the_drive_is_the_spring_of_its_form(form: str) -> None:
    """Compare the ball-joint drive with the generated spring of its form, also at large deflections."""
    bodies, targets, stiffnesses = cases()
    found = [function(bodies, targets, stiffnesses, form) for function in (drive.energy, drive.torque, drive.stiffness)]
    reference = spring(form)
    for row, (body, target, K) in enumerate(zip(bodies, targets, stiffnesses, strict=True)):
        pose = np.eye(4)
        pose[:3, :3] = matrix(target)
        expected = [np.array(each) for each in reference(matrix(body / np.linalg.norm(body)), pose, K)]
        for mine, theirs in zip(found, expected, strict=True):
            error = np.abs(mine[row] - theirs.reshape(mine[row].shape)).max()
            assert error <= 1e-13 * np.abs(K).max(), ANGLES[row // 3]
    assert np.array_equal(found[2], np.swapaxes(found[2], 1, 2))


@pytest.mark.parametrize("form", FORMS)
def test_torque_and_stiffness_differentiate_the_energy(form: str) -> None:
    """Compare torque and stiffness with differences of the energy along turns about fixed axes (step 1e-5 rad)."""
    bodies, targets, stiffnesses = cases()
    far = np.repeat(ANGLES, 3) < 3.0  # a difference must not cross the half turn
    step = 1e-5

    def turned(axis: np.ndarray, size: float) -> np.ndarray:
        return product(bodies, np.broadcast_to(quaternion(size * axis), bodies.shape))

    for i, axis in enumerate(np.eye(3)):
        up, down = (drive.energy(turned(axis, size), targets, stiffnesses, form) for size in (step, -step))
        slope = (up - down) / (2 * step)
        assert np.abs(slope + drive.torque(bodies, targets, stiffnesses, form)[:, i])[far].max() < 1e-7
        # along a turn about a fixed axis the torque about that axis is the slope of the energy
        for other in np.eye(3):
            along = axis + other
            up, down = (drive.torque(turned(along, size), targets, stiffnesses, form) @ along for size in (step, -step))
            bend = -(up - down) / (2 * step)
            expected = drive.stiffness(bodies, targets, stiffnesses, form) @ along @ along
            assert np.abs(bend - expected)[far].max() < 1e-6


def test_the_log_form_is_three_position_drives_about_one_axis() -> None:
    axis = np.array([2.0, -1.0, 2.0]) / 3
    for target in (-1.0, 0.4, 1.9):
        for angle in np.linspace(target - 3, target + 3, 13):
            torque = drive.torque(quaternion(angle * axis), quaternion(target * axis), 7.0 * np.eye(3), "log")
            assert torque == pytest.approx(7.0 * (target - angle) * axis, abs=1e-12)


@pytest.mark.parametrize("form", FORMS)
def test_no_work_round_closed_orbits(form: str) -> None:
    """Average torque times rate round closed orbits: zero; three drives put out 10 mJ and more."""
    random = np.random.default_rng(3)
    times = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    for _ in range(20):
        a, b, centre, aim = random.normal(size=(4, 3)) * 0.4
        K = positive(random, 10.0)
        vector = centre + np.outer(np.cos(times), a) + np.outer(np.sin(times), b)
        rate = np.outer(-np.sin(times), a) + np.outer(np.cos(times), b)
        angle = np.linalg.norm(vector, axis=1, keepdims=True)
        turn = np.cross(vector, rate)  # right Jacobian of SO(3) times the rate
        body = (
            rate - (1 - np.cos(angle)) / angle**2 * turn + (angle - np.sin(angle)) / angle**3 * np.cross(vector, turn)
        )
        power = (drive.torque(quaternion(vector), quaternion(aim), K, form) * body).sum(1)
        assert abs(power.mean() * 2 * np.pi) < 1e-12
        stock = ((aim - vector) @ K * body).sum(1).mean() * 2 * np.pi
        assert abs(stock) > 1e-3


@pytest.mark.parametrize("ratio", [1.0, 0.3])
def test_every_mode_has_the_damping_ratio(ratio: float) -> None:
    """Roots of inertia s^2 + damping s + |stiffness|, at deflections with stiffnesses of both signs."""
    random = np.random.default_rng(8)
    seen = set()
    for body, target, K in zip(*cases(), strict=True):
        inertia, stiffness = positive(random, 0.01), drive.stiffness(body, target, K)
        D = drive.damping(stiffness, inertia, ratio)
        values, modes = scipy.linalg.eigh(stiffness, inertia)
        seen |= set(np.sign(values))
        assert modes.T @ D @ modes == pytest.approx(np.diag(2 * ratio * np.sqrt(np.abs(values))), abs=1e-9)
    assert seen == {1.0, -1.0}


WRAPPER = """
#include "drive.h"
void all(int count, const double *body, const double *target, const double *K, const double *inertia, int form,
         double *energy, double *torque, double *stiffness, double *damping)
{
    for (int c = 0; c < count; ++c) {
        energy[c] = drive_energy(body + 4 * c, target + 4 * c, K + 9 * c, form);
        drive_torque(body + 4 * c, target + 4 * c, K + 9 * c, form, torque + 3 * c);
        drive_stiffness(body + 4 * c, target + 4 * c, K + 9 * c, form, stiffness + 9 * c);
        drive_damping(stiffness + 9 * c, inertia, 0.7, damping + 9 * c);
    }
}
"""


@pytest.fixture
def library(tmp_path: Path) -> ctypes.CDLL:
    source, made = tmp_path / "all.c", tmp_path / "all.so"
    source.write_text(WRAPPER)
    command = ["cc", *language_flags("c99"), *STRICT, "-O2", "-shared", "-fPIC", f"-I{drive.HEADER.parent}"]
    subprocess.run([*command, str(source), "-o", str(made), "-lm"], check=True)
    return ctypes.CDLL(str(made))


@pytest.mark.parametrize("form", FORMS)
def test_the_header_computes_the_same(form: str, library: ctypes.CDLL) -> None:
    """Compare the C header with Python: energy, torque, stiffness and damping; NaN stays NaN."""
    bodies, targets, stiffnesses = cases()
    inertia = positive(np.random.default_rng(2), 0.01)
    bodies, targets = np.vstack([bodies, bodies[:2], bodies[:1]]), np.vstack([targets, targets[:2], targets[:1]])
    stiffnesses = np.concatenate([stiffnesses, stiffnesses[:3]])
    bodies[-3, 2], targets[-2, 0], stiffnesses[-1, 0, 1] = np.nan, np.nan, np.nan
    count, pointer = len(bodies), ctypes.POINTER(ctypes.c_double)
    results = [np.empty((count, *shape)) for shape in ((), (3,), (3, 3), (3, 3))]
    arrays = [np.ascontiguousarray(each) for each in (bodies, targets, stiffnesses, inertia)]
    library.all(
        count,
        *(each.ctypes.data_as(pointer) for each in arrays),
        FORMS.index(form),
        *(each.ctypes.data_as(pointer) for each in results),
    )
    assert all(np.isnan(each[-3:]).any(axis=tuple(range(1, each.ndim))).all() for each in results)
    K = drive.stiffness(bodies, targets, stiffnesses, form)[:-3]
    expected = (
        drive.energy(bodies, targets, stiffnesses, form)[:-3],
        drive.torque(bodies, targets, stiffnesses, form)[:-3],
        K,
        drive.damping(K, inertia, 0.7),
    )
    for mine, theirs in zip(results, expected, strict=True):
        assert np.abs(mine[:-3] - theirs).max() <= 1e-12 * np.abs(theirs).max()


@pytest.mark.parametrize("language", ["c99", "c11", "c++17"])
def test_the_header_compiles_without_a_warning(language: str, tmp_path: Path) -> None:
    source = tmp_path / "all.c"
    source.write_text(WRAPPER)
    command = ["cc", *language_flags(language), *STRICT, "-O2", "-c", f"-I{drive.HEADER.parent}", str(source)]
    subprocess.run([*command, "-o", str(tmp_path / "all.o")], check=True)


def test_another_word_and_other_shapes_are_refused() -> None:
    one = np.array([0.0, 0.0, 0.0, 1.0])
    with pytest.raises(ValueError, match='"trace" or "log", not \'cosine\''):
        drive.energy(one, one, np.eye(3), "cosine")
    with pytest.raises(ValueError, match=r"\(3, 3\), not have the shapes \(4,\), \(4,\), \(3,\)"):
        drive.torque(one, one, np.ones(3))


JAX = """
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_enable_x64", True)
from stiffgen import drive
def product(a, b):
    return jnp.append(a[3] * b[:3] + b[3] * a[:3] + jnp.cross(a[:3], b[:3]), a[3] * b[3] - a[:3] @ b[:3])
random = np.random.default_rng(4)
bodies, targets = random.normal(size=(2, 50, 4))
bodies[:10] = targets[:10] + 1e-4 * random.normal(size=(10, 4))
bodies[10] = targets[10]
K = np.diag([5.0, 9.0, 20.0])
for form in ("trace", "log"):
    def energy(y, body, target):  # exp(y) to second order
        turned = product(body, jnp.append(y / 2, 1 - y @ y / 8))
        return drive.energy(turned, target, K, form)
    slope = jax.jit(jax.vmap(jax.grad(energy), (None, 0, 0)))(jnp.zeros(3), bodies, targets)
    bend = jax.jit(jax.vmap(jax.hessian(energy), (None, 0, 0)))(jnp.zeros(3), bodies, targets)
    torque, stiffness = drive.torque(bodies, targets, K, form), drive.stiffness(bodies, targets, K, form)
    assert isinstance(torque, np.ndarray) and isinstance(slope, jax.Array)
    assert np.abs(slope + torque).max() < 1e-12, np.abs(slope + torque).max()
    assert np.abs(bend - stiffness).max() < 1e-10, np.abs(bend - stiffness).max()
    damping = jax.jit(drive.damping)(bend, jnp.eye(3))
    assert np.abs(damping - drive.damping(stiffness, np.eye(3))).max() < 1e-9
"""


@pytest.mark.wide(instead="tests/families/jax/test_jax.py::test_wrapper_for_jax")
def test_jax_differentiates_the_energy_to_torque_and_stiffness() -> None:
    """In a process of its own: JAX has threads, and other tests fork."""
    pytest.importorskip("jax")
    subprocess.run([sys.executable, "-c", JAX], check=True)
