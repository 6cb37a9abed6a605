# SPDX-License-Identifier: MIT
"""Protocol between the renderer and the backends: what a backend is asked, and what it answers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from stiffgen._version import __version__
from stiffgen.core.emit.c import VariantCode, print_kernels
from stiffgen.core.emit.pages import (
    KernelGroup,
    KernelPage,
    WrappedPage,
    groups_of,
    kernel_page,
    tool_lines,
    wrapped_pages,
)
from stiffgen.core.family import part
from stiffgen.core.lower.graph import LIBM, LIBM_OF_TWO, OWN, Operations
from stiffgen.core.lower.ranges import Ranges, Stated
from stiffgen.core.lower.scalar import DOUBLE, Scalar
from stiffgen.core.lower.variant import BATCH, SINGLE, Variant
from stiffgen.core.names import comment
from stiffgen.core.options import GenerationOptions
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.rooms import optional

_CONTROLLER = optional("control.page")
"""Tables of the controller, which may have been taken out."""
SOURCES = "@digest of the C sources@"
"""Text in a template's result that the renderer replaces by the digest of all C sources."""


OF_ITS_USER = "Belongs to its user: to be used, changed and licensed in any way, without warranty."
"""Sentence of GENERATED_CODE.md in the first line of every generated file."""


@dataclass(frozen=True)
class Request:
    """A robot to print, and what several backends read of it.

    Attributes:
        chain: the robot.
        name: its identifier (:mod:`stiffgen.core.names`), the prefix of all C names.
        options: choices of the user.

    """

    chain: Chain
    name: str
    options: GenerationOptions = field(default_factory=GenerationOptions)

    @property
    def scalar(self) -> Scalar:
        """Type of a number."""
        return self.options.number

    @property
    def has_controller(self) -> bool:
        """Whether the folder has an impedance controller."""
        return (
            _CONTROLLER is not None
            and self.options.controller
            and bool(_CONTROLLER.has_controller(self.chain, self.scalar))
        )

    @property
    def has_sensor_header(self) -> bool:
        """Whether the folder has NAME_sensor.h: wrench from joint torques, filters, reader of calibrations."""
        return bool(self.chain.sensor or self.has_controller) and self.scalar == DOUBLE

    @cached_property
    def springs(self) -> KernelOptions:
        """Springs and groups of functions; the controller's functions are among the groups where it is there."""
        groups = self.options.groups
        if groups and _CONTROLLER and self.has_controller:
            called = _CONTROLLER.called_kernels(self.chain, self.options.springs, self.options.pairs)
            groups = tuple(dict.fromkeys((*groups, *called)))
        return replace(self.options, kernels=groups)

    @property
    def has_widths(self) -> bool:
        """Whether the folder can become a library of several vector widths; the smallest folders have one width."""
        return self.options.python or bool(self.batch.kernels)

    def print(self, variant: Variant) -> VariantCode:
        """Print the kernels in a variant, in the robot's type of numbers."""
        return print_kernels(self.chain, self.name, replace(variant, scalar=self.scalar), self.springs)

    @cached_property
    def single(self) -> VariantCode:
        """Kernels for one configuration, as C."""
        return self.print(SINGLE)

    @cached_property
    def batch(self) -> VariantCode:
        """Kernels for many configurations, as C."""
        return self.print(BATCH)

    @cached_property
    def ranges(self) -> Ranges:
        """Largest arguments for which rounding bounds are stated."""
        return self.options.ranges

    @cached_property
    def bounds(self) -> dict[str, tuple[Stated, ...]]:
        """Rounding bounds of every function, by qualified name; none where the family that finds them is gone."""
        kernels, found = [kernel for kernel, _ in self.single.kernels], part("rounding.bounds")
        if found is None:
            return {kernel.qualified_name: () for kernel in kernels}
        bounds = found.ErrorBounds(self.chain, self.ranges, self.scalar, self.single.lowered)
        return {kernel.qualified_name: tuple(bounds.stated(kernel)) for kernel in kernels}

    def pages(self, code: VariantCode) -> list[KernelPage]:
        """Return the public functions of one configuration, printed in a variant."""
        return [
            kernel_page(self.chain, self.name, self.scalar, kernel, function, self.bounds[kernel.qualified_name])
            for kernel, function in code.kernels
        ]

    @cached_property
    def kernels(self) -> list[KernelPage]:
        """Public functions of the robot."""
        return self.pages(self.single)

    @cached_property
    def groups(self) -> list[KernelGroup]:
        """Public functions by tip and group."""
        return groups_of(self.kernels)

    @cached_property
    def wrapped(self) -> list[WrappedPage]:
        """Functions of the wrappers for CasADi, JAX and PyTorch; none unless derivatives were chosen."""
        return wrapped_pages(self.chain, [kernel for kernel, _ in self.single.kernels])

    @property
    def has_wrappers(self) -> bool:
        """Whether the folder has wrappers for CasADi, JAX and PyTorch."""
        return self.options.python and bool(self.wrapped)

    @cached_property
    def controller(self) -> object | None:
        """Tables of the impedance controller; None without one."""
        if not _CONTROLLER or not self.has_controller:
            return None
        placement, bounded = self.springs.placement, "bounded" in self.springs.springs
        page: object = _CONTROLLER.controller_page(
            self.name, self.chain, self.scalar, placement, bounded=bounded, pairs=self.options.pairs
        )
        return page

    @cached_property
    def banner(self) -> str:
        """First line of every file."""
        total = sum((function.operations for _, function in self.single.kernels), Operations())
        return (
            f"Generated by stiffgen {__version__} for robot {comment(self.chain.robot)} from "
            f"{comment(self.chain.source)} (SHA-256 {self.chain.digest[:16]}); {total.total} operations in "
            f"{len(self.kernels)} functions. Do not edit. {OF_ITS_USER}"
        )

    @cached_property
    def variables(self) -> dict[str, Any]:
        """Variables of the templates of all backends."""
        return {
            "banner_line": self.banner,
            "name": self.name,
            "macro": self.name.upper(),
            "version": __version__,
            "compatible": ".".join(__version__.split(".")[:2]),
            "sources": SOURCES,
            "options": self.options,
            "scalar": self.scalar,
            "robot": self.chain,
            "n": self.chain.dof,
            "positions": len(self.chain.coordinates),
            "fixed": "world" if self.chain.floating else "base",
            "tool": tool_lines(self.chain),
            "kernels": self.kernels,
            "groups": self.groups,
            "batched": bool(self.batch.kernels),
            "has_widths": self.has_widths,
            "has_sensor_header": self.has_sensor_header,
            "functions": self.wrapped,
            "controller": self.controller,
            "libm": LIBM,
            "libm_of_two": LIBM_OF_TWO,
            "own": OWN,
        }


def _no_variables(request: Request) -> dict[str, Any]:
    return {}


@dataclass(frozen=True)
class Backend:
    """A language in which kernels are printed: a folder of templates, and what is written with them.

    Attributes:
        folder: folder whose subfolder ``templates`` has the templates; it may use those of other backends, too.
        files: function that returns each file's template by its name, or a source by its path: a program that is the
            same for every robot, and gets a banner. No files where the options do not ask for the backend.
        variables: function that returns the variables of these templates, beside :attr:`Request.variables`.

    """

    folder: Path
    files: Callable[[Request], Mapping[str, str | Path]]
    variables: Callable[[Request], Mapping[str, Any]] = _no_variables
