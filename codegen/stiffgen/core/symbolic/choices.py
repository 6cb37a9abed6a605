# SPDX-License-Identifier: MIT
"""Options that choose kernels, as data: springs, potentials, groups."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from stiffgen.core.described import option, with_attributes
from stiffgen.core.errors import OptionError
from stiffgen.core.family import needed, part
from stiffgen.core.given import checked_words, shown
from stiffgen.core.symbolic.placement import Placement

_SPRINGS = part("springs.springs")
KINDS: tuple[str, ...] = _SPRINGS.KINDS if _SPRINGS else ()
"""Words of --spring."""


@dataclass(frozen=True)
class Potential:
    """Function U(p, R, parameters), and file name and text of its source.

    The function of a sealed potential has name and parameters, and refuses to be called: its source was not run.
    """

    function: Callable[..., Any]
    file: str = ""
    source: str = ""
    is_sealed: bool = False

    @property
    def name(self) -> str:
        """Name of the function, which is the group of the kernels."""
        return str(self.function.__name__)


ALL = "all"
"""Word of --kernels for all kernels but those on request."""


@dataclass(frozen=True, kw_only=True)
class KernelOptions:
    """Options that select the kernels of a robot."""

    springs: Sequence[str] = option(
        "additional spring (default: trace); repeatable",
        default=(),
        flag="--spring",
        group="springs",
        choices=KINDS,
        action="append",
    )
    placement: Placement = option(
        "axes (base, tip, equilibrium) and centre (X,Y,Z [m]) of the springs; repeatable",
        factory=Placement,
        group="springs",
        record=Placement,
    )
    potentials: Sequence[Potential] = option(
        "your own U(p, R, parameters) of CasADi expressions; runs the file; repeatable",
        default=(),
        flag="--potential",
        group="springs",
        metavar="FILE.py:FUNCTION",
        action="append",
    )
    pairs: Sequence[str] = option(
        "spring between two tips; repeatable",
        default=(),
        flag="--pair",
        group="springs",
        metavar="A:B",
        action="append",
    )
    derivatives: bool = option(
        "generate NAME_vjp for every function: gradients in reverse mode", default=False, group="output"
    )
    kernels: str | Sequence[str] = option(
        "groups or functions, separated by commas, such as hybrid,spring.energy (default: all); all,compliance adds "
        "the tip's compliance, all,tangents bounds for implicit steps; pose and the controller's functions are always "
        "included",
        default=ALL,
        group="output",
        metavar="GROUPS",
    )
    batches: bool = option(
        "generate functions for many configurations per call",
        default=True,
        negative="omit NAME_batch.c",
        group="output",
    )

    def __post_init__(self) -> None:
        """Take one word for the only spring; refuse values of other types."""
        object.__setattr__(self, "springs", checked_words(self.springs, "--spring"))
        object.__setattr__(self, "pairs", checked_words(self.pairs, "--pair"))
        checked_words(self.kernels, "--kernels")
        if not isinstance(self.placement, Placement):
            raise OptionError(f"--placement: takes a record stiffgen.Placement(...), not {shown(self.placement)}")
        chosen = (self.potentials,) if isinstance(self.potentials, Potential) else self.potentials
        several = chosen if isinstance(chosen, (list, tuple)) else (chosen,)
        for each in several:
            if not isinstance(each, Potential):
                reader = "stiffgen.core.potentials.read_potential('FILE.py:FUNCTION')"
                raise OptionError(f"--potential: takes what {reader} returns, not {shown(each)}")
        object.__setattr__(self, "potentials", tuple(several))

    @property
    def groups(self) -> tuple[str, ...]:
        """Groups and functions that were chosen; none for all but those on request."""
        chosen = self.kernels.split(",") if isinstance(self.kernels, str) else self.kernels
        names = tuple(name.strip() for name in chosen)
        return () if set(names) == {ALL} else names

    def all_springs(self) -> tuple[Any, ...]:
        """Return all springs, the default spring first.

        Raises:
            PotentialError: a kind is unknown, a potential is not valid, or a name occurs twice.

        """
        chosen = "--spring" if self.springs else "--potential"
        family = needed("springs.potentials", chosen) if self.springs or self.potentials else part("springs.potentials")
        return tuple(family.springs_of(self)) if family else ()

    def springs_record(self) -> dict[str, Any]:
        """Return the record that :func:`stiffgen.core.manifest.springs_of_manifest` reads."""
        return {
            "kinds": [each.name for each in self.all_springs()],
            "translation_axes": self.placement.translation_axes,
            "rotation_axes": self.placement.rotation_axes,
            "centre": list(self.placement.centre),
            "potentials": [
                {
                    "file": each.file,
                    "function": each.name,
                    "parameters": [
                        [name, [int(extent) for extent in shape]]
                        for name, shape in getattr(each.function, "parameters", {}).items()
                    ],
                    "source": each.source,
                }
                for each in self.potentials
            ],
            **({"pairs": list(self.pairs)} if self.pairs else {}),
            # absent: all kernels but those on request; with functions of batches
            **({"groups": list(self.groups)} if self.groups else {}),
            **({"batches": False} if not self.batches else {}),
        }


KernelOptions.__doc__ = with_attributes(KernelOptions)
