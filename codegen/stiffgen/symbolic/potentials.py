# SPDX-License-Identifier: MIT
"""A user's own potential: a Python function U(p, R, parameters) of CasADi expressions becomes a spring.

    import casadi as ca

    def bowl(p, R, parameters):
        away = p - parameters.centre
        return parameters.stiffness * ca.dot(away, away) ** 2 / 4

    bowl.parameters = {"centre": (3,), "stiffness": ()}

p (3) is the tip's origin [m], R (3x3) its rotation, both in base axes; ``parameters`` has the attributes that the
function's attribute ``parameters`` declares, with their shapes: () a number, (k,) a vector, (k, l) a matrix. They
become arguments of the generated functions, in this order, after q. The result is the energy [J].
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import casadi as ca

from stiffgen.errors import PotentialError, listed
from stiffgen.names import checked_identifier
from stiffgen.symbolic.arguments import Argument
from stiffgen.symbolic.springs import KINDS, Placement, Spring, spring

_WITHOUT_DERIVATIVES = {
    ca.OP_FLOOR: "floor", ca.OP_CEIL: "ceil", ca.OP_FMOD: "fmod", ca.OP_REMAINDER: "remainder", ca.OP_SIGN: "sign",
    ca.OP_COPYSIGN: "copysign", ca.OP_ERFINV: "erfinv", ca.OP_LIFT: "lift",
}  # fmt: skip


@dataclass(frozen=True)
class Potential:
    """Function U(p, R, parameters), with the file and text of its source."""

    function: Callable[..., Any]
    file: str = ""
    source: str = ""

    @property
    def name(self) -> str:
        """Name of the function: the group of the kernels."""
        return str(self.function.__name__)


class _Parameters:
    """Declared parameters of a potential as attributes."""

    def __init__(self, owner: str, values: dict[str, ca.SX]) -> None:
        self._owner, self._values = owner, values

    def __getattr__(self, name: str) -> ca.SX:
        if name.startswith("_"):
            raise AttributeError(name)
        if name not in self._values:
            raise PotentialError(
                f"potential {self._owner}: takes the parameter '{name}', which it does not declare "
                f"(declared: {listed(list(self._values)) or 'none'}); name it with its shape in "
                f"{self._owner}.parameters"
            )
        return self._values[name]


def spring_of(potential: Potential) -> Spring:
    """Return the spring of a user's potential.

    Raises:
        PotentialError: the function is not one of (p, R, parameters), its energy is not a scalar, not twice
            differentiable symbolically, or contains symbols that it was not given.

    """
    name = potential.name
    checked_identifier(name)
    if name in {spring(kind).name for kind in KINDS}:
        raise PotentialError(f"potential {name}: the name is taken by stiffgen's own functions; give it another")
    declared = getattr(potential.function, "parameters", {})
    arguments = tuple(_argument(name, parameter, shape) for parameter, shape in _items(name, declared))

    def energy(p: ca.SX, R: ca.SX, *values: ca.SX) -> ca.SX:
        given = {argument.name: value for argument, value in zip(arguments, values, strict=True)}
        try:
            result = potential.function(p, R, _Parameters(name, given))
        except PotentialError:
            raise
        except Exception as error:
            raise PotentialError(f"potential {name}: fails on CasADi's SX ({type(error).__name__}: {error})") from error
        return _checked(name, result, [p, R, *values])

    text = inspect.getdoc(potential.function) or ""
    where = f" of {potential.file}" if potential.file else ""
    user = Spring(name, arguments, energy, f"U(p, R) by the function {name}{where}", " ".join(text.split()))
    p, R = ca.SX.sym("p", 3), ca.SX.sym("R", 3, 3)
    symbols = [ca.SX.sym(a.name, *_extent(a)) for a in arguments]
    value = energy(p, R, *symbols)
    _refuse_without_derivatives(name, value, [p, R, *symbols])
    return user


def _items(owner: str, declared: Any) -> list[tuple[str, Any]]:
    try:
        return list(declared.items())
    except AttributeError as error:
        raise PotentialError(f"potential {owner}: .parameters must be a dictionary of names and shapes") from error


def _extent(argument: Argument) -> tuple[int, ...]:
    return tuple(int(extent) for extent in argument.shape)


def _argument(owner: str, name: Any, shape: Any) -> Argument:
    try:
        extents = tuple(int(extent) for extent in shape)
        valid = len(extents) <= 2 and all(extent > 0 for extent in extents)
    except (TypeError, ValueError):
        valid = False
    if not valid:
        raise PotentialError(f"potential {owner}: the shape of parameter '{name}' must be (), (k,) or (k, l)")
    if not isinstance(name, str):
        raise PotentialError(f"potential {owner}: a parameter cannot be called '{name}'; give it another name")
    checked_identifier(name)
    return Argument(
        name, extents, "SI", f"parameter of the potential {owner}", symbol=f"{name}_", plural=f"{name}_of_tips"
    )


def _checked(name: str, result: Any, given: list[ca.SX]) -> ca.SX:
    if isinstance(result, (int, float, ca.DM)):
        result = ca.SX(result)
    if not isinstance(result, ca.SX):
        raise PotentialError(f"potential {name}: returns {type(result).__name__}, not a CasADi SX expression")
    if result.shape != (1, 1):
        raise PotentialError(f"potential {name}: its energy must be a scalar, not of shape {result.shape}")
    known = {symbol.element_hash() for each in given for entry in [each] for symbol in ca.symvar(ca.densify(entry))}
    strange = [symbol.name() for symbol in ca.symvar(result) if symbol.element_hash() not in known]
    if strange:
        raise PotentialError(
            f"potential {name}: contains symbols that it was not given ({listed(strange)}); declare them as parameters"
        )
    return ca.densify(result)


def _refuse_without_derivatives(name: str, value: ca.SX, given: list[ca.SX]) -> None:
    """Refuse what is not twice differentiable, or has no C."""
    function = ca.Function("U", given, [value])
    operations = {function.instruction_id(k) for k in range(function.n_instructions())}
    found = sorted(_WITHOUT_DERIVATIVES[each] for each in operations & set(_WITHOUT_DERIVATIVES))
    if found:
        raise PotentialError(
            f"potential {name}: is not twice differentiable ({listed(found)}); write it with smooth functions, or with "
            "if_else whose pieces meet with two derivatives"
        )


@dataclass(frozen=True)
class SpringOptions:
    """Springs of a robot: kinds of :func:`stiffgen.symbolic.springs.spring`, and a user's own potentials.

    The default spring, "trace", always comes first. With ``derivatives`` every kernel of the robot, those of
    springs included, has its vector-Jacobian product beside it (:mod:`stiffgen.symbolic.adjoint`). ``groups`` names
    the kernels to generate, a group ("hybrid") or one function ("spring.energy"); none for all kernels. Without
    ``batches`` no kernel has functions for many configurations.
    """

    kinds: tuple[str, ...] = ()
    placement: Placement = field(default_factory=Placement)
    potentials: tuple[Potential, ...] = ()
    derivatives: bool = False
    groups: tuple[str, ...] = ()
    batches: bool = True

    def springs(self) -> tuple[Spring, ...]:
        """Return all springs, the default one first.

        Raises:
            PotentialError: an unknown kind, a potential that is refused, or a name twice.

        """
        unknown = [kind for kind in self.kinds if kind not in KINDS]
        if unknown:
            raise PotentialError(f"there is no spring '{unknown[0]}'; springs are {listed(list(KINDS))}")
        kinds = [kind for kind in KINDS if kind == "trace" or kind in self.kinds]
        springs = [spring(kind, self.placement) for kind in kinds] + [spring_of(each) for each in self.potentials]
        names = [each.name for each in springs]
        twice = [name for name in dict.fromkeys(names) if names.count(name) > 1]
        if twice:
            raise PotentialError(f"potential {twice[0]}: given twice; each needs a name of its own")
        return tuple(springs)

    def to_manifest(self) -> dict[str, Any]:
        """Return the record that :func:`stiffgen.loading.springs_of_manifest` reads."""
        return {
            "kinds": [each.name for each in self.springs()],
            "translation_axes": self.placement.translation_axes,
            "rotation_axes": self.placement.rotation_axes,
            "centre": list(self.placement.centre),
            "potentials": [
                {"file": each.file, "function": each.name, "source": each.source} for each in self.potentials
            ],
            **({"groups": list(self.groups)} if self.groups else {}),
            **({} if self.batches else {"batches": False}),
        }
