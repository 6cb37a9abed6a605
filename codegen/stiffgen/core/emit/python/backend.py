# SPDX-License-Identifier: MIT
"""Describe the NumPy extension module NAME_python.c and the package around it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from stiffgen.core.emit.backend import Backend, Request
from stiffgen.core.emit.pages import KernelGroup, KernelPage, groups_of
from stiffgen.core.emit.texts import arguments_elsewhere, documented_arguments, wrapped
from stiffgen.core.library import Library
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.kernel import Kernel, absent_functions
from stiffgen.core.symbolic.measured import ASYMMETRY, REMEDY
from stiffgen.core.symbolic.program import Array

MODULE = Library(
    Path(__file__).parent / "library",
    "ufuncs.h",
    ("operands.c", "inputs.c", "loop.c", "explain.c", "call.c", "load.c"),
)
"""C of every NAME_python.c; the tables of the template say what differs."""
_WIDTH = 88
"""Longest line of a docstring, in characters."""


def _packed_pages(chain: Chain, pages: list[KernelPage]) -> list[KernelPage]:
    """Return the functions of the namespace ``packed``: those with a packed batch."""
    packed = []
    for page in pages:
        if page.kernel.packed:
            kernel = replace(page.kernel, results=page.kernel.packed.results)
            results = tuple(result.array(chain) for result in kernel.results)
            packed.append(replace(page, signature=kernel.signature(chain), results=results, packed=True))
    return packed


def _docstring(chain: Chain, kernel: Kernel) -> list[str]:
    """Return the lines of a function's docstring in NumPy's layout, with shapes and units."""
    lines = [kernel.summary, "", *wrapped(kernel.equation, _WIDTH), ""]
    if kernel.note:
        lines += [*wrapped(kernel.note, _WIDTH), ""]
    lines += ["Parameters", "----------", *arguments_elsewhere(kernel, _WIDTH)]
    for argument in documented_arguments(kernel):
        lines += _entry(chain, argument)
    lines += ["", "Returns", "-------"]
    for result in kernel.results:
        lines += _entry(chain, result)
    return lines


def _entry(chain: Chain, argument: Argument) -> list[str]:
    """Return the lines of an argument or result in a docstring."""
    shape = ", ".join(("...", *map(str, argument.array(chain).shape)))
    meaning = wrapped(argument.meaning, _WIDTH - 4)
    return [f"{argument.name} : ({shape}) [{argument.unit}]", *(f"    {line}" for line in meaning)]


def _page_docstring(chain: Chain, page: KernelPage) -> list[str]:
    """Return the docstring of a page's function, whose results may be packed."""
    packed = page.kernel.packed if page.packed else None
    return _docstring(chain, replace(page.kernel, results=packed.results) if packed else page.kernel)


def _initialiser(array: Array) -> str:
    """Return a C initialiser of an array's shape."""
    return "{" + ", ".join(map(str, array.shape or (1,))) + "}"


def _protocol(page: KernelPage) -> str:
    """Return the name of the stub class of functions with these arguments and this number of results."""
    count = len(page.results)
    return "_".join(["_Of", *page.inputs, *([str(count)] if count > 1 else [])])


def _checks(page: KernelPage) -> str:
    """Return a letter for each argument: q for joint positions, t for a stiffness that should be symmetric, else -."""
    of_stiffness = "-" if page.kernel.product_of else "t"  # a vector-Jacobian product checks none
    letters = {each.name: of_stiffness for each in page.kernel.arguments if each.symmetric_part}
    letters |= {each.name: "q" for each in page.kernel.arguments if each.is_q}
    return "".join(letters.get(each.name, "-") for each in page.kernel.arguments)


def _turn_limits(chain: Chain) -> list[str]:
    """Return the largest plausible magnitude of each joint position: 2 pi where the joint's limits are below."""
    is_short = (c.type != "prismatic" and max(-c.lower, c.upper) <= math.tau for c in chain.coordinates)
    return [repr(math.tau) if short else "INFINITY" for short in is_short]


def overview(groups: list[KernelGroup]) -> list[str]:
    """Return call, shape and meaning of every function; groups with the same functions are listed once."""
    places_of: dict[tuple[str, ...], list[str]] = {}  # names of the groups that have these lines
    for group in groups:
        place = ".".join(filter(None, (group.tip, group.group)))
        places_of.setdefault(_calls(group.kernels), []).append(place)
    lines: list[str] = []
    for calls, places in places_of.items():
        if places == [""]:  # of the module itself
            lines += calls
        else:
            lines += [", ".join(place or "here" for place in places), *(f"    {line}" for line in calls)]
    return lines


def _calls(kernels: list[KernelPage]) -> tuple[str, ...]:
    """Return two lines per function; the group's name tells the representation."""
    lines: list[str] = []
    for page in kernels:
        shapes = page.signature.partition("->")[2].replace(",", ", ")
        lines.append(f"{page.name}({', '.join(page.inputs)}) -> {shapes}")
        summary = page.kernel.summary.replace(f"in {page.group} representation", "in the representation named above")
        lines.append(f"    {summary}")
    return tuple(lines)


def packed_functions(request: Request) -> dict[str, Any]:
    """Return the variable ``packed``: functions whose symmetric results are upper triangles."""
    return {"packed": _packed_pages(request.chain, request.kernels)}


def _variables(request: Request) -> dict[str, Any]:
    """Return what the templates of the Python module read."""
    packed = _packed_pages(request.chain, request.kernels)
    pages = [*request.kernels, *packed]
    return {
        "packed": packed,
        "absent": {
            name: [f"{line} " for line in wrapped(reason, 96)]
            for name, reason in absent_functions([page.kernel for page in request.kernels]).items()
        },
        "module_interface": MODULE.interface(request.name),
        "module": MODULE.functions(request.name),
        "overview": overview(request.groups),
        "python_kernels": pages,
        "python_groups": groups_of(pages),
        "public": list(dict.fromkeys(page.tip or page.group or page.name for page in pages)),
        "protocols": {page.qualified_name: _protocol(page) for page in pages},
        "argument_lists": list(dict.fromkeys((tuple(page.inputs), len(page.results)) for page in pages)),
        "docstrings": {page.qualified_name: _page_docstring(request.chain, page) for page in pages},
        "checks": {page.qualified_name: _checks(page) for page in pages},
        "turn_limits": _turn_limits(request.chain),
        "asymmetry": ASYMMETRY,
        "remedy": REMEDY,
        "extents": {
            page.qualified_name: [_initialiser(array) for array in (*page.arguments, *page.results)] for page in pages
        },
    }


def _files(request: Request) -> dict[str, str]:
    """Return the files of the Python module; without wrappers, modules that say how to get them."""
    if not request.options.python:
        return {}
    files = {
        "__init__.py": "init.py.j2",
        "__init__.pyi": "init.pyi.j2",
        "py.typed": "py.typed.j2",
        "pyproject.toml": "pyproject.toml.j2",
        f"python/{request.name}_python.c": "python.c.j2",
    }
    if request.has_wrappers:
        files["python/_functions.py"] = "functions.py.j2"
    else:
        files |= {f"python/{name}.py": "absent.py.j2" for name in ("jax", "torch", "casadi")}
    return files


BACKEND = Backend(Path(__file__).parent, _files, _variables)
