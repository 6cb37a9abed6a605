# SPDX-License-Identifier: MIT
"""Chain -> the text of every file of a robot's folder. Nothing is written here."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import jinja2

from stiffgen._version import __version__
from stiffgen.emit import contexts
from stiffgen.emit.c import Scope, VariantCode, print_kernels
from stiffgen.emit.controller import ControllerPage, controller_files, controller_page
from stiffgen.emit.manifest import MANIFEST, manifest_text
from stiffgen.errors import ChainError
from stiffgen.lower.graph import LIBM, LIBM_OF_TWO, OWN, Operations
from stiffgen.lower.rounding import PRECISIONS, ErrorBounds, Ranges, Stated
from stiffgen.lower.scalar import DOUBLE, Scalar
from stiffgen.lower.variant import BATCH, CUDA, SINGLE, Variant
from stiffgen.names import c_string, comment
from stiffgen.rendering import environment
from stiffgen.robot.chain import Chain
from stiffgen.symbolic.kernels import MAX_BATCH_JOINTS
from stiffgen.symbolic.potentials import SpringOptions

_SOURCES = "@digest of the C sources@"


def render(
    chain: Chain,
    name: str,
    *,
    scalar: Scalar = DOUBLE,
    cuda: bool = False,
    options: SpringOptions | None = None,
    ranges: Ranges | None = None,
) -> dict[str, str]:
    """The files of a robot's folder by name.

    Args:
        chain: the robot.
        name: an identifier (:mod:`stiffgen.names`), the prefix of all C names.
        scalar: type of a number. The controller is made for doubles alone.
        cuda: also NAME.cu and NAME_cuda.h, with the kernels that have a batch.
        options: springs beyond the default one, their axes and centre.
        ranges: of the arguments for which bounds of the rounding errors are stated.

    Returns:
        Text by file name; the same on every machine.

    Raises:
        ChainError: ``cuda`` for a chain too long for batches.

    """
    options, ranges = options or SpringOptions(), ranges or Ranges()
    variants = [replace(variant, scalar=scalar) for variant in (SINGLE, BATCH, CUDA)]
    single, batch = (print_kernels(chain, name, variant, options) for variant in variants[:2])
    threads = contexts.cuda_pages(chain, name, _threads(chain, name, variants[2], options)) if cuda else None
    error_bounds = ErrorBounds(chain, ranges, scalar, single.lowered)
    bounds = {kernel.qualified_name: error_bounds.stated(kernel) for kernel, _ in single.kernels}
    pages = _pages(chain, name, single, batch, threads, bounds, ranges)
    templates = _templates()
    files = {
        f"{name}.h": "header.h.j2",
        f"{name}.c": "source.c.j2",
        f"{name}.hpp": "wrapper.hpp.j2",
        f"{name}_python.c": "python.c.j2",
        "CMakeLists.txt": "CMakeLists.txt.j2",
        "__init__.py": "init.py.j2",
        "__init__.pyi": "init.pyi.j2",
        "pyproject.toml": "pyproject.toml.j2",
        "README.md": "README.md.j2",
    } | controller_files(name, chain, scalar)
    if cuda:
        files |= {f"{name}_cuda.h": "cuda.h.j2", f"{name}.cu": "cuda.cu.j2"}
    if pages.functions:
        files |= {
            f"{name}_calls.h": "calls.h.j2",
            f"{name}_calls.c": "calls.c.j2",
            f"{name}_casadi.c": "casadi.c.j2",
            f"{name}_jax.c": "jax.c.j2",
            "_functions.py": "functions.py.j2",
            "casadi.py": "casadi.py.j2",
            "jax.py": "jax.py.j2",
            "torch.py": "torch.py.j2",
        }
    texts = {
        file: templates.get_template(template).render(vars(pages), banner=_banner(file, pages.banner_line))
        for file, template in files.items()
    }
    texts["py.typed"] = ""
    texts = _with_sources(texts)
    signed = {k.qualified_name: (k.signature(chain), f.operations) for k, f in single.kernels}
    texts[MANIFEST] = manifest_text(chain, name, scalar, signed, texts, options, bounds, ranges)
    return texts


def _with_sources(texts: dict[str, str]) -> dict[str, str]:
    """The digest of the C sources, put where compiled module and Python file have it to find out that they differ."""
    sources = "".join(text for file, text in sorted(texts.items()) if file.endswith((".c", ".h")))
    digest = hashlib.sha256(sources.encode()).hexdigest()[:16]
    return {file: text.replace(_SOURCES, digest) for file, text in texts.items()}


@cache
def _templates() -> jinja2.Environment:
    # C and Python, not HTML: what comes from the robot file goes through these filters
    filters: dict[str, Callable[..., str]] = {
        "c_string": c_string,
        "comment": comment,
        "python": ascii,
        "python_float": lambda x: repr(x) if math.isfinite(x) else f"float('{x}')",
        "short": lambda x: f"{x:.6g}" if math.isfinite(x) else "none",
    }
    templates = environment("stiffgen.emit", filters)
    templates.loader = jinja2.FileSystemLoader(sorted(Path(__file__).parent.glob("**/templates")))
    return templates


def _banner(file: str, line: str) -> str:
    return f"/* {line} */" if file.endswith((".h", ".hpp", ".c", ".cu")) else f"# {line}"


@dataclass(frozen=True)
class _RobotPages:
    """What the templates read, by the name they know it by.

    Attributes:
        banner_line: of every file.
        name, macro: prefixes of C names and macros.
        version, compatible: stiffgen's, and the part of it that has to agree with a user's demand.
        sources: what the digest of the C sources takes the place of.
        scalar: type of a number.
        robot, n, positions: the chain, the number of its velocity coordinates, and that of its joint positions.
        fixed: what stands still, the base or the world.
        tool: what is to be said of the tool, in lines.
        example: of the README.
        controller: see emit/controller.py; None where a robot has none.
        scopes: the chain, or one branch a tip.
        shared, batch_shared: internal functions of the kernels, and of their batches.
        kernels, groups, overview: the public functions; by tip and representation; in lines for a reader.
        packed: the functions that give upper triangles, in Python.
        python_kernels, python_groups: all functions there, and by group.
        public: their names in Python's module.
        argument_lists: the different ones of them: names of the arguments, number of results.
        batches: the public functions with a batch.
        functions: those that have a gradient, for JAX, PyTorch and CasADi; none unless derivatives were asked for.
        called: these and their vector-Jacobian products, as they are printed.
        cuda: if it was asked for.
        variants, calls, sections: of NAME.c: how it is printed, the helpers that it calls, and its parts.
        rounding: the ranges of arguments for which bounds of errors are stated, in lines.
        digits: of rotations in arguments, for these.
        libm, libm_of_two, own: functions that lanes are given.

    """

    banner_line: str
    name: str
    macro: str
    version: str
    compatible: str
    sources: str
    scalar: Scalar
    robot: Chain
    n: int
    positions: int
    fixed: str
    tool: list[str]
    example: contexts.Example
    controller: ControllerPage | None
    scopes: tuple[Scope, ...]
    shared: list[contexts.Definition]
    batch_shared: list[contexts.Definition]
    kernels: list[contexts.KernelPage]
    groups: list[contexts.Group]
    overview: list[str]
    python_kernels: list[contexts.KernelPage]
    python_groups: list[contexts.Group]
    packed: list[contexts.KernelPage]
    public: list[str]
    argument_lists: list[tuple[tuple[str, ...], int]]
    batches: list[contexts.BatchPage]
    functions: list[contexts.DifferentiablePage]
    called: list[contexts.KernelPage]
    cuda: contexts.CudaPages | None
    variants: dict[str, Variant]
    calls: frozenset[str]
    sections: dict[str, contexts.Section]
    rounding: list[str]
    digits: int
    libm: tuple[str, ...] = LIBM
    libm_of_two: tuple[str, ...] = LIBM_OF_TWO
    own: tuple[str, ...] = OWN


def _pages(
    chain: Chain,
    name: str,
    single: VariantCode,
    batch: VariantCode,
    cuda: contexts.CudaPages | None,
    bounds: Mapping[str, Sequence[Stated]],
    ranges: Ranges,
) -> _RobotPages:
    kernels = [
        contexts.kernel_page(chain, name, single.variant.scalar, kernel, function, bounds[kernel.qualified_name])
        for kernel, function in single.kernels
    ]
    groups = contexts.groups_of(kernels)
    packed = contexts.packed_pages(chain, [kernel for kernel, _ in single.kernels], kernels)
    functions = contexts.differentiable_pages(chain, [kernel for kernel, _ in single.kernels])
    differentiable = {name for function in functions for name in (function.name, f"{function.name}_vjp")}
    total = sum((function.operations for _, function in single.kernels), Operations())
    return _RobotPages(
        banner_line=(
            f"Generated by stiffgen {__version__} for robot {comment(chain.robot)} from {comment(chain.source)} "
            f"(SHA-256 {chain.digest[:16]}); {total.total} operations in {len(kernels)} functions. Do not edit."
        ),
        name=name,
        macro=name.upper(),
        version=__version__,
        compatible=".".join(__version__.split(".")[:2]),
        sources=_SOURCES,
        scalar=single.variant.scalar,
        robot=chain,
        n=chain.dof,
        positions=len(chain.coordinates),
        fixed="world" if chain.floating else "base",
        tool=contexts.tool_lines(chain),
        example=contexts.example_of(chain),
        controller=controller_page(name, chain, single.variant.scalar),
        scopes=single.scopes,
        shared=contexts.shared_functions(single),
        batch_shared=contexts.shared_functions(batch),
        kernels=kernels,
        groups=groups,
        overview=contexts.overview(groups),
        python_kernels=[*kernels, *packed],
        python_groups=contexts.groups_of([*kernels, *packed]),
        packed=packed,
        public=list(dict.fromkeys(k.tip or k.group or k.name for k in [*kernels, *packed])),
        argument_lists=list(dict.fromkeys((tuple(k.inputs), len(k.outputs)) for k in kernels)),
        batches=[
            contexts.batch_page(chain, name, batch.variant, kernel, function) for kernel, function in batch.kernels
        ],
        functions=functions,
        called=[page for page in kernels if page.qualified_name in differentiable],
        cuda=cuda,
        variants={"single": single.variant, "batch": batch.variant},
        calls=single.calls | batch.calls,
        sections=contexts.sections_of(single, batch),
        rounding=ranges.lines(PRECISIONS[single.variant.scalar.name]),
        digits=PRECISIONS[single.variant.scalar.name].digits,
    )


def _threads(chain: Chain, name: str, variant: Variant, options: SpringOptions) -> VariantCode:
    code = print_kernels(chain, name, variant, options)
    if not code.kernels:
        raise ChainError(
            f"--cuda: the chain has {len(chain.joints)} moving joints, and CUDA kernels are made for at most "
            f"{MAX_BATCH_JOINTS}; leave out --cuda, or shorten the chain with --tip, --base or --lock"
        )
    return code
