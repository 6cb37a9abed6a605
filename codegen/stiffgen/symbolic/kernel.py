# SPDX-License-Identifier: MIT
"""Record of a kernel: one function of every generated robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from stiffgen.robot.chain import Chain, Tip
from stiffgen.symbolic.arguments import Argument
from stiffgen.symbolic.program import Program


@dataclass(frozen=True)
class Batch:
    """C function for many configurations in one call: suffix of its name, and its results."""

    suffix: str
    results: tuple[Argument, ...]


PACKED = "_packed"
"""Suffix of functions that store symmetric results as their upper triangles."""


@dataclass(frozen=True)
class Kernel:
    """Function of every generated robot.

    ``group`` is the namespace: a representation, a spring, or None for what belongs to neither; ``tip`` is None for
    what belongs to no single tip of several (and for the functions of an only tip). ``equation`` names what the kernel
    evaluates and its source; ``note`` says what a caller must know beyond shapes and units.
    """

    name: str
    group: str | None
    arguments: tuple[Argument, ...]
    results: tuple[Argument, ...]
    summary: str
    equation: str
    program: Callable[[Chain], Program]
    note: str = ""
    tip: Tip | None = None
    batch: bool = False
    """Whether C also has it for many configurations in one call: :attr:`batches`."""
    part_of: str = ""
    """Name of a kernel of the group with the same arguments that computes these results beside others at hardly more
    cost: one vector-Jacobian product serves both."""
    product_of: str = ""
    """Name of the kernel of the group whose vector-Jacobian product this is, with its arguments and cotangents."""
    by_tips: Callable[[Chain], Program] | None = None
    """Program of a total as a sum over the tips, which is differentiated tip by tip; ``program`` takes one pass."""
    of_masses: bool = False
    """Whether the kernel needs all moving joints, also side joints, which move masses and no tip."""

    @property
    def qualified_name(self) -> str:
        """``hybrid_joint_stiffness``, ``left_hand_hybrid_joint_stiffness`` or the bare name."""
        tip = self.tip.name if self.tip else None
        return "_".join(part for part in (tip, self.group, self.name) if part)

    @property
    def path(self) -> tuple[str, ...]:
        """Tip and group, as far as it has them: the namespaces that hold the function in Python."""
        return tuple(filter(None, (self.tip.name if self.tip else None, self.group)))

    @property
    def choices(self) -> tuple[str, str]:
        """Words that choose the kernel: its group ("dynamics" where it has none), and group and name."""
        return self.group or "dynamics", ".".join(filter(None, (self.group, self.name.removesuffix("_total"))))

    @property
    def result(self) -> Argument:
        """The only result."""
        (result,) = self.results
        return result

    @property
    def packed(self) -> Batch | None:
        """NAME_..._packed_batch, where there is a batch and a result is symmetric."""
        if not self.batch or not any(result.symmetric for result in self.results):
            return None
        return Batch(f"{PACKED}_batch", tuple(result.packed() for result in self.results))

    @property
    def batches(self) -> tuple[Batch, ...]:
        """NAME_..._batch and :attr:`packed`, as far as there are any."""
        if not self.batch:
            return ()
        return Batch("_batch", self.results), *((self.packed,) if self.packed else ())

    def scope(self, chain: Chain) -> Chain:
        """Return the chain that the program is about: the branch to the tip, the paths to all tips, or the whole."""
        if self.of_masses:
            return chain
        return chain.branch(self.tip) if self.tip else chain.without_side_joints()

    def scope_name(self, chain: Chain) -> str:
        """Return the tip's name, "tree" for a whole that has side joints, else ""."""
        if self.of_masses and len(chain.without_side_joints().joints) < len(chain.joints):
            return "tree"
        return self.tip.name if self.tip else ""

    def steps(self, chain: Chain) -> Program:
        """Return the program for a chain, to be run on its :meth:`scope`."""
        return self.program(self.scope(chain))

    def signature(self, chain: Chain) -> str:
        """Return the shapes as a signature of a NumPy generalised ufunc, "(7),(6)->(7,7)"."""
        given, results = (
            ",".join("(" + ",".join(map(str, argument.array(chain).shape)) + ")" for argument in arrays)
            for arrays in (self.arguments, self.results)
        )
        return f"{given}->{results}"
