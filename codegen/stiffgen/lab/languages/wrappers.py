# SPDX-License-Identifier: MIT
"""Compare NAME.casadi, NAME.torch and NAME.jax with the NumPy functions: values, and derivatives in both modes.

Each framework runs in a process of its own (:mod:`stiffgen.lab.languages.frameworks`), on a copy of the folder
whose library for the framework is compiled from the folder's sources: a library beside them may be older.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from stiffgen.core.family import part
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.arguments import BASE_POSE, Argument
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.core.verify.result import Check, as_results, faultless
from stiffgen.lab.languages import frameworks
from stiffgen.lab.languages.compiling import build_beside
from stiffgen.lab.languages.material import COUNT, Material

_PACKAGES = {"casadi": ("casadi", "casadi"), "torch": ("torch", "PyTorch"), "jax": ("jax", "JAX")}
"""Package and title of each framework, by the name of the folder's module."""
_SECONDS = 900
_BOUND = 1e-11
"""Largest difference relative to the largest entry or, of derivatives, to the sum of all terms."""


@dataclass(frozen=True)
class _Case:
    """Function of the wrappers: values of the arguments, directions and cotangents, and what NumPy's functions give.

    Attributes:
        kernel: its record.
        given: a stack for every argument.
        directions: a stack of changes for every argument; empty for a function that has no derivatives.
        cotangents: a stack for every result; empty for a function that has no derivatives.
        values: its results.
        change: derivative of the sum of cotangents times results along the directions, one per state.
        terms: sum of the magnitudes of the derivative's terms, one per state.

    """

    kernel: Kernel
    given: list[FloatArray]
    directions: list[FloatArray]
    cotangents: list[FloatArray]
    values: list[FloatArray]
    change: FloatArray
    terms: FloatArray


def check_wrappers(material: Material) -> list[Check]:
    """Compare the wrappers of a folder with its NumPy functions; no row for a folder without derivatives."""
    robot = material.robot
    if not material.has(f"python/{robot.name}_casadi.c"):
        return []
    checks, cases = [], list(_cases(material))
    copy = _copied(material)
    for framework, (package, title) in _PACKAGES.items():
        file = f"python/{framework}.py"
        if find_spec(package) is None:
            checks.append(material.without_tool(file, f"{title} is not installed (pip install {package})"))
            continue
        checks.append(faultless(file, "NumPy functions: values, derivatives", _faults(framework, copy, cases)))
    return checks


def _copied(material: Material) -> Path:
    """Copy the folder, its compiled module included, and compile the libraries of the frameworks from its sources."""
    robot = material.robot
    source, copy = robot.folder.resolve(), material.build / robot.name
    compiled = [str(file.relative_to(source)) for file in source.glob(f"python/{robot.name}_python*")]
    for file in {"manifest.json", *robot.manifest["files"], *compiled}:
        (copy / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source / file, copy / file)
    _build_library(material, copy, "casadi", [])
    jax = part("jax.build")
    if jax and (headers := jax.headers()):
        _build_library(material, copy, "jax", headers)
    return copy


def _build_library(material: Material, copy: Path, framework: str, headers: Sequence[Any]) -> None:
    """Compile the library of a framework beside the Python modules of a copied folder."""
    stem = copy / "python" / f"{material.robot.name}_{framework}"
    sources = [copy / "python" / f"{material.robot.name}_{each}.c" for each in (framework, "calls")]
    flags = ("-std=gnu99", *(f"-I{each}" for each in headers))
    build_beside([material.library], sources, stem, copy, flags=flags)


def _cases(material: Material) -> Iterator[_Case]:
    """Yield the functions that the wrappers have: those with a product, and gradients."""
    random = np.random.default_rng(1)
    products = {(kernel.path, kernel.product_of): kernel for kernel in material.robot.table if kernel.product_of}
    for kernel in material.robot.table:
        product = products.get((kernel.path, kernel.name))
        if product is None and not kernel.is_gradient:
            continue
        given = material.states(kernel)
        values = [np.asarray(each) for each in as_results(material.single[kernel.qualified_name](*given))]
        if product is None:
            nothing = np.zeros(COUNT)
            yield _Case(kernel, given, directions=[], cotangents=[], values=values, change=nothing, terms=nothing)
            continue
        cotangents = [random.normal(size=each.shape) for each in values]
        bars = [np.asarray(each) for each in as_results(material.single[product.qualified_name](*given, *cotangents))]
        rates = [random.normal(size=np.shape(bar)) for bar in bars]
        # change of cotangent . value along the rates (COUNT), and the size of its terms
        terms = [(bar * rate).reshape(COUNT, -1) for bar, rate in zip(bars, rates, strict=True)]
        yield _Case(
            kernel,
            given,
            directions=[_along(*each) for each in zip(kernel.arguments, given, rates, strict=True)],
            cotangents=cotangents,
            values=values,
            change=np.sum([each.sum(1) for each in terms], 0),
            terms=np.sum([np.abs(each).sum(1) for each in terms], 0),
        )


def _along(argument: Argument, value: FloatArray, rate: FloatArray) -> FloatArray:
    """Return the rates of an argument's entries; those of the base's pose from a twist (v, w) in the base's own axes.

    A pose H then changes by H [[w, v], [0, 0]], with the cross-product matrix of w.
    """
    if argument != BASE_POSE:
        return rate
    motion = np.zeros((COUNT, 4, 4))
    motion[:, :3, 3], w = rate[:, :3], rate[:, 3:]
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):  # w_k turns axis i towards axis j
        motion[:, j, i], motion[:, i, j] = w[:, k], -w[:, k]
    along: FloatArray = value @ motion
    return along


def _faults(framework: str, copy: Path, cases: list[_Case]) -> list[str]:
    """Run the functions of a framework in a process; return those whose values or derivatives differ."""
    asked, answered = copy / f"asked_{framework}.npz", copy / f"answered_{framework}.npz"
    arrays: dict[str, Any] = {}
    for k, case in enumerate(cases):
        for what, stacks in (("given", case.given), ("direction", case.directions), ("cotangent", case.cotangents)):
            arrays |= {f"{k} {what} {i}": stack for i, stack in enumerate(stacks)}
    paths = [".".join((*case.kernel.path, case.kernel.name)) for case in cases]
    np.savez(asked, paths=np.array(json.dumps(paths)), **arrays)
    command = [sys.executable, "-m", frameworks.__name__, framework, str(copy), str(asked), str(answered)]
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False, timeout=_SECONDS
        )
    except subprocess.TimeoutExpired:
        return [f"no result within {_SECONDS} s"]
    if done.returncode != 0:
        lines = [line for line in done.stderr.splitlines() if re.match(r"[\w.]*(Error|Exception)\b", line)]
        return [lines[-1] if lines else f"its process ends with status {done.returncode}: {done.stderr[-200:]}"]
    with np.load(answered) as found:
        return [fault for k, case in enumerate(cases) for fault in _differences(k, case, paths[k], found)]


def _differences(k: int, case: _Case, path: str, found: Mapping[str, FloatArray]) -> Iterator[str]:
    """Yield what differs of function number ``k``: a result, or its derivative in one of the modes.

    Compilers may contract products and sums in one of the two libraries: bits need not be equal.
    """
    for i, value in enumerate(case.values):
        flat, reference = found[f"{k} value {i}"].reshape(COUNT, -1), value.reshape(COUNT, -1)
        largest = np.abs(reference[np.isfinite(reference)]).max(initial=0.0)
        if not np.allclose(flat, reference, rtol=0.0, atol=_BOUND * largest, equal_nan=True):
            yield f"{path}, {case.kernel.results[i].name}"
    if not case.cotangents:
        return
    is_number = np.isfinite(case.change)  # loops that do not close give NaN
    bound = _BOUND * np.maximum(case.terms, 1e-300)
    for mode in ("reverse", "forward"):
        error = np.abs(found[f"{k} {mode}"] - case.change)
        if not (error[is_number] <= bound[is_number]).all():
            yield f"{path}, {mode} derivative"
