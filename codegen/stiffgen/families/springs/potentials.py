# SPDX-License-Identifier: MIT
"""User-defined potentials: a Python function U(p, R, parameters) of CasADi expressions becomes a spring.

Example::

    import casadi as ca

    def bowl(p, R, parameters):
        away = p - parameters.centre
        return parameters.stiffness * ca.dot(away, away) ** 2 / 4

    bowl.parameters = {"centre": (3,), "stiffness": ()}

p (3) is the tip's origin [m] and R (3x3) its rotation, both in base axes. The result is the energy [J].

The function's attribute ``parameters`` declares names and shapes: () a number, (k,) a vector, (k, l) a matrix. The
argument ``parameters`` has one attribute per name. The parameters become arguments of the generated functions, after q
and in the order of declaration. The generated argument of ``centre`` is called ``parameter_centre``: no name of the
generator, of C or of math.h begins in this way, so that every identifier may name a parameter.
"""

from __future__ import annotations

import inspect
import re
from typing import Any

import casadi as ca

from stiffgen.core.errors import PotentialError, listed, printable
from stiffgen.core.names import MAX_LENGTH, identifier
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.choices import KINDS, KernelOptions, Potential
from stiffgen.core.symbolic.quantities import Uniform
from stiffgen.families.springs.springs import Spring, spring

MAX_PARAMETERS = 27
"""Largest number of parameters of a potential.

The reverse mode of the energy takes q, the poses of the base and of a tool, the parameters and three cotangents, and
returns a gradient for all but the cotangents. A NumPy ufunc takes 64 arguments and results.
"""
_WITHOUT_DERIVATIVES = {
    ca.OP_FLOOR: "floor", ca.OP_CEIL: "ceil", ca.OP_FMOD: "fmod", ca.OP_REMAINDER: "remainder", ca.OP_SIGN: "sign",
    ca.OP_COPYSIGN: "copysign", ca.OP_ERFINV: "erfinv", ca.OP_LIFT: "lift",
}  # fmt: skip


class _Parameters:
    """Declared parameters of a potential as attributes."""

    def __init__(self, owner: str, values: dict[str, ca.SX]) -> None:
        self._owner, self._values = owner, values

    def __getattr__(self, name: str) -> ca.SX:
        """Return a declared parameter, or name those that are."""
        if name.startswith("_"):
            raise AttributeError(name)
        if name not in self._values:
            raise PotentialError(
                f"potential {self._owner}: takes the parameter '{name}', which it does not declare "
                f"(declared: {listed(list(self._values)) or 'none'}); add the name and its shape to "
                f"{self._owner}.parameters"
            )
        return self._values[name]


def spring_of(potential: Potential) -> Spring:
    """Return the spring of a user's potential.

    Raises:
        PotentialError: the function does not take (p, R, parameters); or its energy is not a scalar, is not twice
            differentiable symbolically, or contains foreign symbols.

    """
    name = potential.name
    _check_name(name)
    declared = dict(_items(name, getattr(potential.function, "parameters", {})))
    if len(declared) > MAX_PARAMETERS:
        raise PotentialError(
            f"potential {name}: declares {len(declared)} parameters, more than the {MAX_PARAMETERS} that its functions "
            "can take in NumPy; put numbers that belong together into one vector or matrix"
        )
    arguments = tuple(
        _argument(name, parameter, shape, _argument_name(name, list(declared), k))
        for k, (parameter, shape) in enumerate(declared.items())
    )

    def energy(p: ca.SX, R: ca.SX, *values: ca.SX) -> ca.SX:
        """Call the user's function; all that goes wrong in it becomes a PotentialError."""
        parameters = dict(zip(declared, values, strict=True))
        try:
            result = potential.function(p, R, _Parameters(name, parameters))
        except PotentialError:
            raise
        except Exception as error:
            raise PotentialError(f"potential {name}: fails on CasADi's SX ({type(error).__name__}: {error})") from error
        return _checked(name, result, [p, R, *values])

    text = inspect.getdoc(potential.function) or ""
    source = f" of {potential.file}" if potential.file else ""
    user = Spring(name, arguments, energy, f"U(p, R) by the function {name}{source}", " ".join(text.split()))
    if potential.is_sealed:  # its function cannot be called
        return user
    p, R = ca.SX.sym("p", 3), ca.SX.sym("R", 3, 3)
    symbols = [ca.SX.sym(a.name, *map(int, a.shape)) for a in arguments]
    _check_differentiable(name, energy(p, R, *symbols), [p, R, *symbols])
    return user


def _check_name(name: str) -> None:
    """Raise PotentialError unless a function's name can be the name of a spring."""
    if identifier(name) != name:
        raise PotentialError(
            f"potential {printable(name)}: the function's name is no usable name in C and Python; call it "
            f"{identifier(name)}"
        )
    if name in {spring(kind).name for kind in KINDS}:
        raise PotentialError(f"potential {name}: the name is taken by stiffgen's own functions; give it another")


def _items(owner: str, declared: Any) -> list[tuple[str, Any]]:
    """Return names and shapes that the potential ``owner`` declares, not checked yet."""
    try:
        return list(declared.items())
    except AttributeError as error:
        raise PotentialError(f"potential {owner}: .parameters must be a dictionary of names and shapes") from error


def _argument_name(owner: str, names: list[Any], k: int) -> str:
    """Return the name of the k-th parameter's argument.

    A number precedes a name that begins with another one and "_": the printers append "_bar", "_step" and the like.
    """
    name = names[k]
    if not isinstance(name, str) or len(name) > MAX_LENGTH or not re.fullmatch(r"[A-Za-z](_?[A-Za-z0-9])*", name):
        raise PotentialError(
            f"potential {owner}: a parameter cannot be called '{printable(str(name))}', which is no identifier of C "
            f"and C++; use at most {MAX_LENGTH} letters, digits and single underscores, a letter first"
        )
    longer = any(name.startswith(f"{other}_") for other in names if other != name)
    return f"parameter_{k + 1}_{name}" if longer else f"parameter_{name}"


def _argument(owner: str, name: str, shape: Any, full: str) -> Argument:
    """Return the argument called ``full`` of the parameter ``name``, whose shape is what the user wrote."""
    try:
        extents = tuple(int(extent) for extent in shape)
        valid = len(extents) <= 2 and all(extent > 0 for extent in extents)
    except (TypeError, ValueError):
        valid = False
    if not valid:
        raise PotentialError(f"potential {owner}: the shape of parameter '{name}' must be (), (k,) or (k, l)")
    meaning = f"parameter '{name}' of the potential {owner}"
    return Argument(
        full, extents, "SI", meaning, symbol=f"{full}_", plural=f"{full}_of_tips", draw=Uniform(0.2, 2.0),
        largest="none",
    )  # fmt: skip


def _checked(name: str, result: Any, inputs: list[ca.SX]) -> ca.SX:
    """Return the energy as a scalar expression of the inputs.

    Raises:
        PotentialError: the result is no such expression.

    """
    if isinstance(result, (int, float, ca.DM)):
        result = ca.SX(result)
    if not isinstance(result, ca.SX):
        raise PotentialError(f"potential {name}: returns {type(result).__name__}, not a CasADi SX expression")
    if result.shape != (1, 1):
        raise PotentialError(f"potential {name}: its energy must be a scalar, not of shape {result.shape}")
    known = {symbol.element_hash() for each in inputs for symbol in ca.symvar(ca.densify(each))}
    foreign = [symbol.name() for symbol in ca.symvar(result) if symbol.element_hash() not in known]
    if foreign:
        raise PotentialError(
            f"potential {name}: contains symbols that it was not given ({listed(foreign)}); declare them as parameters"
        )
    return ca.densify(result)


def _check_differentiable(name: str, value: ca.SX, inputs: list[ca.SX]) -> None:
    """Raise PotentialError for operations that are not twice differentiable or that C does not have."""
    function = ca.Function("U", inputs, [value])
    operations = {function.instruction_id(k) for k in range(function.n_instructions())}
    found = sorted(_WITHOUT_DERIVATIVES[each] for each in operations & set(_WITHOUT_DERIVATIVES))
    if found:
        raise PotentialError(
            f"potential {name}: is not twice differentiable ({listed(found)}); use smooth functions, or if_else with "
            "branches whose values and first two derivatives agree at the switch"
        )


def springs_of(options: KernelOptions) -> tuple[Spring, ...]:
    """Return all springs, the default spring first."""
    unknown = [kind for kind in options.springs if kind not in KINDS]
    if unknown:
        raise PotentialError(f"there is no spring '{unknown[0]}'; springs are {listed(list(KINDS))}")
    kinds = [kind for kind in KINDS if kind == "trace" or kind in options.springs]
    springs = [spring(kind, options.placement) for kind in kinds] + [spring_of(each) for each in options.potentials]
    names = [each.name for each in springs]
    twice = [name for name in dict.fromkeys(names) if names.count(name) > 1]
    if twice:
        raise PotentialError(f"potential {twice[0]}: given twice; rename one of the two functions")
    return tuple(springs)
