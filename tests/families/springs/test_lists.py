# SPDX-License-Identifier: MIT
"""Every backend has every function of the kernel table: compare lists of the printed files, without a compiler."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import pytest

from stiffgen import StiffnessModel
from stiffgen.core.emit.registry import BACKENDS
from stiffgen.core.emit.render import render
from stiffgen.core.options import GenerationOptions
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.kernels import chain_kernels
from support.small_robots import LINKAGES, TREES

SPRINGS = KernelOptions(derivatives=True)
ROBOTS = {
    "closed loops": LINKAGES["two slides"],
    "two tips": TREES["two tips on one joint"],
    "floating base": TREES["one joint on a floating base"],
}


@pytest.fixture(
    scope="module",
    params=[
        pytest.param("closed loops", marks=pytest.mark.slow),
        pytest.param("two tips", marks=pytest.mark.wide),
        pytest.param("floating base", marks=pytest.mark.wide),
    ],
)
def printed(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """Return chain, kernel table and printed files of a robot."""
    chain = ROBOTS[request.param].load(tmp_path_factory.mktemp("lists"))
    options = GenerationOptions(derivatives=True, cuda=True, controller=False)
    return SimpleNamespace(chain=chain, table=chain_kernels(chain, SPRINGS), files=render(chain, "r", options))


def in_wrappers(files: dict[str, str]) -> list[str]:
    """Return the names in python/_functions.py; casadi.py, jax.py and torch.py make a function of each."""
    for framework in ("casadi", "jax", "torch"):
        assert "globals().update(namespaces(" in files[f"python/{framework}.py"]
    paths = re.findall(r'^    Function\(\n        "([\w.]+)",', files["python/_functions.py"], re.MULTILINE)
    return [path.replace(".", "_") for path in paths]


def in_model(owner: object, before: tuple[str, ...] = ()) -> list[str]:
    """Return the qualified names of the functions of a model and its namespaces."""
    found: list[str] = []
    for name, value in vars(owner).items():
        if isinstance(value, ca.Function):
            found.append("_".join((*before, name)))
        elif isinstance(value, SimpleNamespace):
            found += in_model(value, (*before, name))
    return found


def in_stubs(text: str) -> int:
    """Return the number of functions in the stubs, packed forms left out."""
    own = re.sub(r"^class __packed:\n(?:    .*\n)+", "", text, flags=re.MULTILINE)
    return len(re.findall(r"^(?:    )?\w+: (?:Final\[)?_Of_", own, re.MULTILINE))


def test_every_backend_has_every_function(printed: SimpleNamespace) -> None:
    """Products are called by the wrappers for gradients; a thread of CUDA replaces functions without a batch."""
    files, table = printed.files, printed.table
    every = sorted(kernel.qualified_name for kernel in table)
    wrapped = sorted(kernel.qualified_name for kernel in table if not kernel.product_of)
    batched = sorted(kernel.qualified_name for kernel in table if kernel.batch)

    def names(pattern: str, file: str) -> list[str]:
        return sorted(set(re.findall(pattern, files[file], re.MULTILINE)))

    single = [name for name in names(r"^void r_(\w+)\(", "r.h") if not name.endswith("_batch")]
    found = {
        "C": (single, every),
        "C, batches": ([n[:-6] for n in names(r"^void r_(\w+_batch)\(", "r.h") if "_packed" not in n], batched),
        "C++": ([n for n in names(r"::r_(\w+)\(", "r.hpp") if n in every], every),
        "NumPy": (names(r"^static void evaluate_(\w+)\(const double", "python/r_python.c"), every),
        "CUDA": ([n for n in names(r"^int r_(\w+)_cuda\(", "r_cuda.h") if not n.endswith("_each")], batched),
        "CasADi": (names(r"^VALUES\(r_casadi_(\w+),", "python/r_casadi.c"), wrapped),
        "JAX": ([n for n in names(r"^HANDLER\((\w+),", "python/r_jax.c") if not n.endswith("_vjp")], wrapped),
        "wrappers": (sorted(in_wrappers(files)), wrapped),
        "StiffnessModel": (sorted(in_model(StiffnessModel(printed.chain, derivatives=True))), every),
    }
    missing = {name: sorted(set(expected) - set(has)) for name, (has, expected) in found.items()}
    assert {name: each for name, each in missing.items() if each} == {}
    assert {name: sorted(set(has) - set(expected)) for name, (has, expected) in found.items() if has != expected} == {}
    assert in_stubs(files["__init__.pyi"]) == len(every)


def test_no_backend_is_left_out_of_the_comparison() -> None:
    compared = {"c", "cpp", "python", "cuda", "casadi", "jax", "torch"}
    assert {Path(backend.folder).name for backend in BACKENDS} == {*compared, "package", "control"}
