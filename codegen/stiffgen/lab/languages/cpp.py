# SPDX-License-Identifier: MIT
"""Compare NAME.hpp with the C functions that it calls, in bits: both overloads, batches, constants, controller."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from stiffgen.core.errors import NoCompilerError
from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.kernel import Batch, Kernel
from stiffgen.core.verify.folder.forked import confined
from stiffgen.core.verify.result import Check, faultless
from stiffgen.lab.languages.compiling import build_beside, cpp_command
from stiffgen.lab.languages.material import COUNT, Material

_HEAD = """#include "{name}.hpp"
#include <cstddef>
#include <cstring>

namespace cpp = ::{name};

extern "C" const char *compare_constants(void)
{{
    if (cpp::DOF != {dof} || cpp::POSITIONS != {positions}) {{ return "DOF, POSITIONS"; }}
    if (&cpp::JOINTS[0] != &::{name}_joints[0]) {{ return "JOINTS"; }}
    if (&cpp::LOWER[0] != &::{name}_lower[0] || &cpp::UPPER[0] != &::{name}_upper[0]) {{ return "LOWER, UPPER"; }}
    if (&cpp::VELOCITY[0] != &::{name}_velocity[0] || &cpp::EFFORT[0] != &::{name}_effort[0]) {{
        return "VELOCITY, EFFORT";
    }}
    return cpp::self_check() == 0 ? "" : "self_check";
}}
"""
_CONTROLLER = """
extern "C" const char *compare_controller(const double *q, const double *torque)
{{
    using C = cpp::Impedance;
    static ::{name}_impedance_state refused;
    C::Config config = C::default_config(), plain;
    ::{name}_impedance_default_config(&plain);
    if (std::memcmp(config.torque_rate_limit, plain.torque_rate_limit, sizeof plain.torque_rate_limit) != 0 ||
        config.ramp_time != plain.ramp_time) {{ return "default_config"; }}
    if (C(config).error() != ::{name}_impedance_init(&config, &refused, nullptr)) {{ return "Impedance, error"; }}
    plain.sample_time = 1e-3;
    plain.delay_samples = 1;
    for (double &inertia : plain.motor_inertia) {{ inertia = 0.1; }}
    for (double &wrench : plain.heaviest_wrench) {{ wrench = 10.0; }}
    for (int code = -200; code < 50; ++code) {{
        if (std::strcmp(C::error_text(code), ::{name}_impedance_error_text(code)) != 0) {{ return "error_text"; }}
    }}
    for (int held = 0; held < 2; ++held) {{
        ::{name}_impedance_state state{{}};
        const int error = ::{name}_impedance_init(&plain, &state, held ? torque : nullptr);
        C own = held ? C(plain, cpp::Input<{motors}>::at(torque)) : C(plain);
        if (own.error() != error) {{ return "Impedance, error"; }}
        for (unsigned k = 0; k < 60; ++k) {{
            C::Sample sample{{}};
            C::Report expected{{}}, found{{}};
            sample.counter = k;
            sample.clock = {macro}_CLOCK_COUNTER;
            sample.sample_valid = k < 20 || k > 29;
            cpp::assign<cpp::POSITIONS>(sample.q, cpp::Input<cpp::POSITIONS>::at(q));
            if (k == 45 && own.reset() != ::{name}_impedance_reset(&state)) {{ return "reset"; }}
            const int code = ::{name}_impedance_step(&state, &sample, &expected);
            if (own.step(sample, found) != code) {{ return "step, code"; }}
            if (std::memcmp(&found, &expected, sizeof found) != 0) {{ return "step, report"; }}
        }}
    }}
    return "";
}}
"""


def check_cpp(material: Material) -> list[Check]:
    """Compare every function of NAME.hpp with its C function, and its controller with the C one.

    Returns:
        A row, and one for the sections for Eigen, which are not run; none for a folder without the header.

    """
    robot = material.robot
    file = f"{robot.name}.hpp"
    if not material.has(file):
        return []
    try:
        compiler = cpp_command()
    except NoCompilerError as error:
        return [material.without_tool(file, str(error))]
    driver, kernels = material.build / "cpp.cpp", [material.library]
    driver.write_text(_driver(material), encoding="utf-8")
    if robot.has_controller:
        controller = robot.folder.resolve() / f"{robot.name}_impedance.c"
        kernels.append(build_beside(kernels, [controller], material.build / "controller", robot.folder))
    library = build_beside(kernels, [driver], material.build / "cpp", robot.folder, compiler, ("-std=c++17",))
    faults = confined(lambda: _faults(ctypes.CDLL(str(library)), ctypes.CDLL(str(material.library)), material))
    eigen = material.without_tool(file, "sections for Eigen are not run")
    return [faultless(file, "C functions, in bits", faults), replace(eigen, kernel=f"{file}, Eigen")]


def _driver(material: Material) -> str:
    """Return the C++ program text with one C function per kernel, which calls both overloads, and one per batch."""
    robot, chain = material.robot, material.robot.chain
    sizes = {"dof": chain.dof, "positions": len(chain.coordinates)}
    parts = [_HEAD.format(name=robot.name, **sizes)]
    number = robot.scalar.name
    for kernel in robot.table:
        parts.append(_overloads(kernel, chain, number))
        parts += [_batch(kernel, batch, number) for batch in kernel.batches]
    if robot.has_controller:
        motors = "cpp::MOTORS" if chain.loops else "cpp::DOF"
        parts.append(_CONTROLLER.format(name=robot.name, macro=robot.name.upper(), motors=motors))
    return "".join(parts)


def _public(kernel: Kernel) -> str:
    """Return the C++ name of a kernel's function."""
    return "::".join(("cpp", *kernel.path, kernel.name))


def _overloads(kernel: Kernel, chain: Chain, number: str) -> str:
    """Return the C function that calls both overloads of a kernel."""

    def handed(argument: Argument, kind: str, memory: str, k: int) -> str:
        shape = argument.array(chain).shape
        if not shape:
            return f"*{memory}[{k}]"
        return f"cpp::{kind}<{', '.join(map(str, shape))}>::at({memory}[{k}])"

    given = [handed(argument, "Input", "in", k) for k, argument in enumerate(kernel.arguments)]
    written = [handed(result, "Output", "written", k) for k, result in enumerate(kernel.results)]
    lines = [
        f'\nextern "C" void cpp_{kernel.qualified_name}(const {number} *const *in, {number} *const *written, '
        f"{number} *const *returned)",
        "{",
        f"    {_public(kernel)}({', '.join([*given, *written])});",
        f"    const auto value = {_public(kernel)}({', '.join(given)});",
    ]
    for k, result in enumerate(kernel.results):
        part = "value" if len(kernel.results) == 1 else f"value.{result.name}"
        shape = result.array(chain).shape
        place = f"{part}.data()" if shape else f"&{part}"
        lines.append(f"    std::memcpy(returned[{k}], {place}, {math.prod(shape)} * sizeof({number}));")
    return "\n".join([*lines, "}", ""])


def _batch(kernel: Kernel, batch: Batch, number: str) -> str:
    """Return the C function that calls a batch, its steps in an array."""
    handed = [f"in[{k}], steps[{k}]" for k in range(len(kernel.arguments))]
    handed += [f"out[{k}]" for k in range(len(kernel.results))]
    return (
        f'\nextern "C" void cpp_{kernel.qualified_name}{batch.suffix}(const {number} *const *in, '
        f"const std::ptrdiff_t *steps, {number} *const *out)\n"
        f"{{\n    {_public(kernel)}{batch.suffix}({COUNT}, {', '.join(handed)});\n}}\n"
    )


def _faults(cpp: ctypes.CDLL, c: ctypes.CDLL, material: Material) -> list[str]:
    """Return the functions whose results differ from those of C."""
    robot = material.robot
    faults = [_text(cpp.compare_constants)]
    if robot.has_controller:
        middle = [(max(each.lower, -1.0) + min(each.upper, 1.0)) / 2 for each in robot.chain.coordinates]
        least_effort = np.min([min(each.effort, 10.0) for each in robot.chain.coordinates])
        torque = np.full(robot.chain.dof, 0.5) * least_effort
        faults.append(_text(cpp.compare_controller, np.array(middle), torque))
    for kernel in robot.table:
        stacks = [
            np.ascontiguousarray(stack.reshape(COUNT, -1), dtype=robot.scalar.dtype)
            for stack in material.states(kernel)
        ]
        for state in range(COUNT):
            faults += _single_faults(kernel, [stack[state] for stack in stacks], cpp, c, material)
        faults += _batch_faults(kernel, stacks, cpp, c, material)
    return list(dict.fromkeys(filter(None, faults)))


def _single_faults(
    kernel: Kernel, given: list[FloatArray], cpp: ctypes.CDLL, c: ctypes.CDLL, material: Material
) -> list[str]:
    """Return which of a kernel's two overloads differ from C at one state: results written, or returned."""
    robot, name = material.robot, kernel.qualified_name
    sizes = [result.array(robot.chain).size for result in kernel.results]
    expected, written, returned = (_zeros(sizes, material) for _ in range(3))
    c[f"{robot.name}_{name}"](*map(_address, given + expected))
    cpp[f"cpp_{name}"](_pointers(given), _pointers(written), _pointers(returned))
    overloads = {f"{name}, written": written, f"{name}, returned": returned}
    return [overload for overload, found in overloads.items() if not _same(found, expected)]


def _zeros(sizes: Sequence[int], material: Material) -> list[FloatArray]:
    """Return arrays of zeros of the robot's scalar type."""
    return [np.zeros(size, material.robot.scalar.dtype) for size in sizes]


def _batch_faults(
    kernel: Kernel, stacks: Sequence[FloatArray], cpp: ctypes.CDLL, c: ctypes.CDLL, material: Material
) -> list[str]:
    """Return the batches whose results differ, with every argument in a row, and with the first one shared."""
    robot, faults = material.robot, []
    rows = [stack.shape[1] for stack in stacks]  # entries from one state's argument to the next
    for batch in kernel.batches:
        public = f"{kernel.qualified_name}{batch.suffix}"
        sizes = [COUNT * result.array(robot.chain).size for result in batch.results]
        for steps in (rows, [0, *rows[1:]]):
            expected, found = _zeros(sizes, material), _zeros(sizes, material)
            given: list[Any] = []
            for stack, step in zip(stacks, steps, strict=True):
                given += [_address(stack), ctypes.c_ssize_t(step)]
            c[f"{robot.name}_{public}"](ctypes.c_size_t(COUNT), *given, *map(_address, expected))
            cpp[f"cpp_{public}"](_pointers(stacks), (ctypes.c_ssize_t * len(steps))(*steps), _pointers(found))
            if not _same(found, expected):
                faults.append(public)
    return faults


def _address(array: FloatArray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def _pointers(arrays: Sequence[FloatArray]) -> ctypes.Array[ctypes.c_void_p]:
    return (ctypes.c_void_p * max(len(arrays), 1))(*(array.ctypes.data for array in arrays))


def _same(found: Sequence[FloatArray], expected: Sequence[FloatArray]) -> bool:
    """Return whether arrays are equal in bits."""
    return all(one.tobytes() == other.tobytes() for one, other in zip(found, expected, strict=True))


def _text(function: Any, *arrays: FloatArray) -> str:
    """Return the text of a comparison in C++: the name of what differs, or nothing."""
    function.restype = ctypes.c_char_p
    text = function(*map(_address, arrays))
    return bytes(text).decode() if text else ""
