# SPDX-License-Identifier: MIT
"""Compare NAME_sensor.h with NumPy: wrench from torques by singular values, filters by their transfer functions."""

from __future__ import annotations

import ctypes
import json
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.verify.folder.forked import confined
from stiffgen.core.verify.result import Check, faultless
from stiffgen.lab.languages.compiling import build_beside
from stiffgen.lab.languages.material import Material

_DRIVER = """#include "{name}_sensor.h"

double sensor_wrench(const double *J, const double *torque, const double *deviation, double damping, double *wrench,
    double *unexplained)
{{
    return {name}_external_wrench(J, torque, deviation, damping, wrench, unexplained);
}}

int sensor_filter(int kind, double frequency, double width, double time, double *design, double *readings, size_t count)
{{
    {name}_filter filter;
    memset(&filter, 0, sizeof filter);
    const int is_made = kind == 1 ? {name}_low_pass_1(&filter, frequency, time)
        : kind == 2 ? {name}_low_pass_2(&filter, frequency, time) : {name}_notch(&filter, frequency, width, time);
    memcpy(design, filter.b, sizeof filter.b);
    memcpy(design + 3, filter.a, sizeof filter.a);
    design[5] = filter.delay;
    for (size_t k = 0; k < count; ++k) {{
        {name}_filter_step(&filter, readings + 6 * k);
    }}
    return is_made;
}}

int sensor_read(const char *text, double *bias, double *payload)
{{
    return {name}_read_calibration(text, bias, payload);
}}

int sensor_is_known(const char *text)
{{
#if {macro}_HAS_SENSOR
    return {name}_is_of_sensor(text);
#else
    return text == NULL;
#endif
}}
"""
_BOUND = 1e-9
"""Largest relative difference: the conditions of the drawn matrices are below 1e3."""
_TIME, _FREQUENCY, _WIDTH = 0.001, 30.0, 12.0
"""Sample time [s], corner or middle of the filters [Hz], and width of the notch [Hz]."""
_LOW_PASS_1, _LOW_PASS_2, _NOTCH = 1, 2, 3
"""Numbers of the filters in the driver."""
_HALF_POWER = math.sqrt(0.5)
_BIAS, _PAYLOAD = (0.5, -1.25, 3.0, 0.02, -0.04, 0.125), (1.5, 0.01, -0.03, 0.0625)
_CALIBRATION = f'{{"generator": "x", "bias": {list(_BIAS)}, "noise": [9, 9], "payload": {list(_PAYLOAD)}}}'


def check_sensor_header(material: Material) -> list[Check]:
    """Compare the functions of NAME_sensor.h with the same in NumPy; no row for a folder without the header."""
    robot = material.robot
    file = f"{robot.name}_sensor.h"
    if not material.has(file):
        return []
    driver = material.build / "sensor.c"
    driver.write_text(_DRIVER.format(name=robot.name, macro=robot.name.upper()), encoding="utf-8")
    library = build_beside([material.library], [driver], material.build / "sensor", robot.folder)
    faults = confined(lambda: list(dict.fromkeys(_faults(ctypes.CDLL(str(library)), robot.chain))))
    return [faultless(file, "singular values, transfer functions", faults)]


def _faults(library: ctypes.CDLL, chain: Chain) -> Iterator[str]:
    """Yield the functions whose results differ."""
    random = np.random.default_rng(0)
    library.sensor_wrench.restype = ctypes.c_double
    for damping in (0.0, 0.3):
        for weighted in (False, True):
            yield from _wrench_faults(library, random, chain.dof, damping, weighted=weighted)
    for kind, name in ((_LOW_PASS_1, "low_pass_1"), (_LOW_PASS_2, "low_pass_2"), (_NOTCH, "notch")):
        yield from (f"{name}: {fault}" for fault in _filter_faults(library, random, kind))
    yield from _calibration_faults(library, json.dumps(chain.sensor.text) if chain.sensor else None)


def _calibration_faults(library: ctypes.CDLL, sensor: str | None) -> Iterator[str]:
    """Yield the functions that read a calibration's file wrongly; ``sensor`` is the robot's own one as JSON."""
    read = np.zeros(10)
    bias, payload = ctypes.c_void_p(read.ctypes.data), ctypes.c_void_p(read[6:].ctypes.data)
    is_read = library.sensor_read(_CALIBRATION.encode(), bias, payload)
    if not is_read or tuple(read) != _BIAS + _PAYLOAD:
        yield "read_calibration"
    if library.sensor_read(_CALIBRATION.replace("payload", "load").encode(), bias, payload):
        yield "read_calibration reads a file without payload"
    own, other = (f'{{"sensor": {each}}}'.encode() for each in (sensor or "", '"another link"'))
    if [library.sensor_is_known(own), library.sensor_is_known(other)] != [sensor is not None, False]:
        yield "is_of_sensor"


def _wrench_faults(
    library: ctypes.CDLL, random: np.random.Generator, dof: int, damping: float, *, weighted: bool
) -> Iterator[str]:
    """Yield the differences of a wrench from the damped least squares by singular values.

    J^T F = torque in the least-squares sense: with J^T = U diag(s) V^T that is F = V diag(s / (s^2 + damping^2)) U^T
    torque, rows and torques divided by their deviations.
    """
    jacobian, torque, deviation = random.normal(size=(6, dof)), random.normal(size=dof), random.uniform(0.5, 2.0, dof)
    scale = deviation if weighted else np.ones(dof)
    wrench, unexplained = np.zeros(6), np.zeros(dof)
    condition = library.sensor_wrench(
        _address(jacobian),
        _address(torque),
        _address(deviation) if weighted else None,
        ctypes.c_double(damping),
        _address(wrench),
        _address(unexplained),
    )
    U, s, Vt = np.linalg.svd(jacobian.T / scale[:, None], full_matrices=False)
    is_determined = dof >= 6
    if is_determined or damping:
        expected = Vt.T @ (s / (s**2 + damping**2) * (U.T @ (torque / scale)))
        if not _close(wrench, expected):
            yield "external_wrench"
        if not _close(unexplained, torque - jacobian.T @ expected):
            yield "external_wrench, unexplained"
    elif not np.isnan(wrench).all():
        yield "external_wrench of fewer than six joints without damping"
    is_right = math.isclose(condition, s[0] / s[-1], rel_tol=_BOUND) if is_determined else math.isinf(condition)
    if not is_right:
        yield "external_wrench, condition"


def _address(array: FloatArray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def _filter_faults(library: ctypes.CDLL, random: np.random.Generator, kind: int) -> Iterator[str]:
    """Yield the differences of a filter from its transfer function and its difference equation."""
    readings = random.normal(size=(40, 6))  # samples, channels; one is missing
    readings[25, 2] = np.nan
    design, filtered = np.zeros(6), readings.copy()
    is_made = _call_filter(library, kind, _FREQUENCY, design, filtered)
    if not is_made:
        yield "refused"
        return
    if _call_filter(library, kind, 0.5 / _TIME, np.zeros(6), np.zeros((1, 6))):
        yield "half the sampling rate is accepted"
    b, a, delay = design[:3], np.array([1.0, *design[3:5]]), float(design[5])  # numerator, denominator, samples
    gains = [abs(_response(b, a, frequency)) for frequency in (0.0, _FREQUENCY)]
    wanted = [1.0, 0.0 if kind == _NOTCH else _HALF_POWER]
    # The first-order filter is exact in time; its gain at the corner is not.
    if not np.allclose(gains, wanted, rtol=0.05 if kind == _LOW_PASS_1 else _BOUND, atol=_BOUND):
        yield "gain"
    if kind == _NOTCH and not _has_width(b, a):
        yield "width"
    slow = 1e-5 / _TIME  # [Hz]: there the phase is the delay
    lag = -np.angle(_response(b, a, slow)) / (math.tau * slow * _TIME)
    if not math.isclose(delay, lag, rel_tol=1e-5, abs_tol=1e-5):
        yield "delay"
    if not np.allclose(filtered, _filtered(b, a, readings), rtol=_BOUND, atol=_BOUND, equal_nan=True):
        yield "filter_step"


def _call_filter(library: ctypes.CDLL, kind: int, frequency: float, design: FloatArray, readings: FloatArray) -> int:
    """Make a filter, write its coefficients, and filter readings in place; return whether it is made."""
    numbers = (ctypes.c_double(each) for each in (frequency, _WIDTH, _TIME))
    arrays = (ctypes.c_void_p(each.ctypes.data) for each in (design, readings))
    return int(library.sensor_filter(kind, *numbers, *arrays, ctypes.c_size_t(len(readings))))


def _response(b: FloatArray, a: FloatArray, frequency: float) -> Any:
    """Return the response of a filter at a frequency [Hz]: b(z) / a(z) in powers of 1/z, z on the unit circle."""
    powers = np.exp(-1j * math.tau * frequency * _TIME * np.arange(3))
    return (b @ powers) / (a @ powers)


def _has_width(b: FloatArray, a: FloatArray) -> bool:
    """Return whether the frequencies at which a notch passes 1/sqrt(2) lie ``_WIDTH`` apart (warped alike)."""
    frequencies = np.linspace(_FREQUENCY - _WIDTH, _FREQUENCY + _WIDTH, 4001)
    stopped = frequencies[np.array([abs(_response(b, a, each)) for each in frequencies]) < _HALF_POWER]
    return len(stopped) > 0 and math.isclose(stopped[-1] - stopped[0], _WIDTH, rel_tol=0.01)


def _filtered(b: FloatArray, a: FloatArray, readings: FloatArray) -> FloatArray:
    """Filter rows (N, 6) by the difference equation; at rest at first and after a row that is not finite."""
    result = np.full_like(readings, np.nan)
    x, y = np.zeros((3, 6)), np.zeros((3, 6))
    is_started = False
    for k, row in enumerate(readings):
        if not np.isfinite(row).all():
            is_started = False
            continue
        if not is_started:
            gain = b.sum() / a.sum()  # of a constant: the filter starts as if the first row had lasted for ever
            x, y = np.tile(row, (3, 1)), np.tile(gain * row, (3, 1))
            is_started = True
        # shift in the newest; rows 0, 1, 2: now, and one and two samples ago
        x, y = np.vstack([row, x[:2]]), np.vstack([np.zeros(6), y[:2]])
        y[0] = b @ x - a[1:] @ y[1:]
        result[k] = y[0]
    return result


def _close(found: FloatArray, expected: FloatArray) -> bool:
    return bool(np.allclose(found, expected, rtol=_BOUND, atol=_BOUND * np.abs(expected).max()))
