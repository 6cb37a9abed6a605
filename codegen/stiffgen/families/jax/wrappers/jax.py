"""Wrapper for JAX on the CPU: the functions of this package with jit, vmap and first derivatives in both modes.

XLA calls the compiled functions on its own buffers without copies. Arguments are float64: set
``jax.config.update("jax_enable_x64", True)``. Leading dimensions broadcast as in NumPy. The gradient with respect to
a stiffness is symmetric, and exact for motions of the base with respect to base_pose.
"""

from __future__ import annotations

import ctypes
import functools
import itertools
import math
import os
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from . import _c
from ._functions import MOTIONS, NAME, Function, entry_gradient, namespaces, unbroadcast

_LIBRARY = Path(__file__).parent / f"{NAME}_jax{'.pyd' if os.name == 'nt' else '.so'}"
if not _LIBRARY.exists():  # jax was not installed when the folder was generated
    try:
        from stiffgen import build_jax

        build_jax(Path(__file__).parent.parent, NAME)
    except Exception as _error:
        raise ImportError(
            f"{NAME}.jax: its calls for XLA are not compiled, and compiling them failed ({_error}); install jax where "
            "stiffgen is, and run 'stiffgen generate --derivatives' again"
        ) from _error
_library = ctypes.CDLL(str(_LIBRARY))
if ctypes.c_char_p.in_dll(_library, f"{NAME}_jax_sources").value != _c.SOURCES.encode():
    raise ImportError(f"{NAME}.jax: its calls for XLA were compiled from other sources; run 'stiffgen generate' again")


def _target(function: Function) -> str:
    """Return the function's name in XLA; register the function on first use. Other sources have other names."""
    name = f"{NAME}_{function.name}_{_c.SOURCES}"
    if name not in _registered:
        handler = getattr(_library, f"{NAME}_jax_{function.name}")
        jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(handler), platform="cpu")
        _registered.add(name)
    return name


# Registered names of the whole process: XLA accepts a name once, and two copies of this folder share their names.
_registered: set[str] = jax.ffi.__dict__.setdefault("_stiffgen_targets", set())


def _called(function: Function, arguments: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
    leading = function.leading([argument.shape for argument in arguments])
    results = [jax.ShapeDtypeStruct((*leading, *shape), jnp.float64) for shape in function.results]
    return tuple(jax.ffi.ffi_call(_target(function), results, vmap_method="expand_dims")(*arguments))


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _first_order(path: str, arguments: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
    return arguments


@_first_order.defjvp
def _no_second_order(path: str, primals: Any, tangents: Any) -> Any:
    raise NotImplementedError(
        f"{NAME}.jax: {path}() has first derivatives only; for the Hessian of an energy take its joint_stiffness"
    )


def _gradients(
    function: Function, arguments: tuple[jax.Array, ...], cotangents: tuple[jax.Array, ...]
) -> list[jax.Array]:
    """Return the gradient with respect to every argument, with the leading dimensions of the results."""
    gradients = _called(function.product, (*arguments, *cotangents))
    if "base_pose" in function.arguments:
        gradients = (entry_gradient(gradients[0], arguments[0], jnp.asarray(MOTIONS)), *gradients[1:])
    return list(gradients)


def _pulled_back(
    function: Function, arguments: tuple[jax.Array, ...], cotangents: tuple[jax.Array, ...]
) -> tuple[jax.Array, ...]:
    """Return the vector-Jacobian product."""
    gradients = _gradients(function, arguments, cotangents)
    return tuple(unbroadcast(each, argument.shape) for each, argument in zip(gradients, arguments, strict=True))


def _pushed_forward(
    function: Function, arguments: tuple[jax.Array, ...], tangents: tuple[jax.Array, ...]
) -> tuple[jax.Array, ...]:
    """Return the Jacobian-vector product, from the gradients of all entries of the results in one batch.

    The entries are a dimension before the leading ones. The change of an entry is the sum of its gradients times the
    tangents.
    """
    leading = function.leading([argument.shape for argument in arguments])
    cotangents = _unit_cotangents(function, len(leading))
    entries = cotangents[0].shape[0]
    gradients = _gradients(function, tuple(argument[None] for argument in arguments), cotangents)
    changes = jnp.zeros((entries, *leading))
    for gradient, tangent in zip(gradients, tangents, strict=True):
        products = gradient * tangent[None]  # (entries, *leading, *shape of the argument)
        of_argument = tuple(range(1 + len(leading), products.ndim))
        changes = changes + products.sum(of_argument)
    per_result = _split(jnp.moveaxis(changes, 0, -1), [math.prod(shape) for shape in function.results], axis=-1)
    return tuple(each.reshape((*leading, *shape)) for each, shape in zip(per_result, function.results, strict=True))


def _unit_cotangents(function: Function, leading: int) -> tuple[jax.Array, ...]:
    """Return a unit cotangent for each entry of the results, for arguments with a number of ``leading`` dimensions.

    The array of each result has the shape (entries of all results, 1, ..., 1, *shape of the result).
    """
    sizes = [math.prod(shape) for shape in function.results]
    units = _split(jnp.eye(sum(sizes)), sizes, axis=1)
    ones = (1,) * leading
    return tuple(unit.reshape((-1, *ones, *shape)) for unit, shape in zip(units, function.results, strict=True))


def _split(array: jax.Array, sizes: list[int], axis: int) -> list[jax.Array]:
    """Return parts of an array with these sizes along an axis."""
    ends = list(itertools.accumulate(sizes))
    return jnp.split(array, ends[:-1], axis=axis)


def _flat(arrays: tuple[jax.Array, ...]) -> jax.Array:
    """Return the entries of all arrays as one vector."""
    return jnp.concatenate([array.ravel() for array in arrays])


def _like(arrays: tuple[jax.Array, ...], flat: jax.Array) -> tuple[jax.Array, ...]:
    """Return the entries of a vector as arrays with the shapes of others."""
    parts = _split(flat, [array.size for array in arrays], axis=0)
    return tuple(part.reshape(array.shape) for part, array in zip(parts, arrays, strict=True))


def _linear(push: Any, pull: Any, tangents: tuple[jax.Array, ...], results: tuple[jax.Array, ...]) -> Any:
    """Return ``push(tangents)``, whose transpose is ``pull``.

    JAX has one public linear function with a transpose of its own that vmap accepts, the solution x of a square system.
    With flat vectors t and c for tangents and changes of the results, the system and its solutions are

        matrix           (t, c - push(t)) = (tangents, 0)        so that c = push(tangents)
        its inverse      (t, c) -> (t, c + push(t))
        its transpose's  (t, c) -> (t + pull(c), c)
    """

    def pushed(flat: jax.Array) -> jax.Array:
        return _flat(push(_like(tangents, flat)))

    def pulled(flat: jax.Array) -> jax.Array:
        return _flat(pull(_like(results, flat)))

    def matrix(x: Any) -> Any:
        t, c = x
        return t, c - pushed(t)

    def inverse(_: Any, x: Any) -> Any:
        t, c = x
        return t, c + pushed(t)

    def inverse_of_transpose(_: Any, x: Any) -> Any:
        t, c = x
        return t + pulled(c), c

    start = _flat(tangents)
    zeros = jnp.pad(start[:0], (0, sum(result.size for result in results)))  # linear in the tangents, as JAX demands
    _, changes = jax.lax.custom_linear_solve(matrix, (start, zeros), inverse, inverse_of_transpose)
    return _like(results, changes)


def _differentiable(function: Function) -> Any:
    """Return the function with derivatives in both modes from its vector-Jacobian product, if it has one."""

    @jax.custom_jvp
    def evaluated(*arguments: jax.Array) -> tuple[jax.Array, ...]:
        return _called(function, arguments)

    @evaluated.defjvp
    def derivative(arguments: tuple[jax.Array, ...], tangents: tuple[jax.Array, ...]) -> Any:
        """Return results and their changes along tangents; JAX transposes them into the VJP."""
        if function.is_gradient:
            raise NotImplementedError(function.no_derivative)
        fixed = _first_order(function.path, arguments)
        push, pull = (functools.partial(each, function, fixed) for each in (_pushed_forward, _pulled_back))
        results = evaluated(*arguments)
        return results, _linear(push, pull, tangents, results)

    @jax.jit
    def compiled(*arguments: Any) -> jax.Array | tuple[jax.Array, ...]:
        arrays = [jnp.asarray(argument, dtype=float) for argument in arguments]
        shapes = function.aligned([array.shape for array in arrays])
        results = evaluated(*(array.reshape(shape) for array, shape in zip(arrays, shapes, strict=True)))
        return results if len(results) > 1 else results[0]

    @functools.wraps(getattr(_c, function.name))
    def call(*arguments: Any, **named: Any) -> jax.Array | tuple[jax.Array, ...]:
        """Check that JAX computes in float64, order the arguments, and run."""
        if jnp.result_type(float) != jnp.float64:
            raise TypeError(
                f"{NAME}.jax computes in float64, which JAX has switched off; "
                'jax.config.update("jax_enable_x64", True) at the start of the program switches it on'
            )
        return compiled(*function.ordered(arguments, named))

    return call


globals().update(namespaces(_differentiable))
