# SPDX-License-Identifier: MIT
"""Verify that NaN and infinity in an argument give NaN in every dependent entry, and never infinity.

Independent entries keep their value or become NaN. Results that overflow become NaN, too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from stiffgen.core.lower.scalar import DOUBLE, Scalar
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.kernels import Kernel
from stiffgen.core.verify.result import Check, Kernels, as_results, faultless

STACK = 11
"""Configurations of a stack: more than one vector, but not a whole number of vectors."""
_DEPENDS = 1e-9
"""Change of a result, relative to the largest one or to 1, from which on it depends on an entry: beyond rounding."""
LARGE = {"double": (1e155, 1e200, 1e306, 1.7e308), "float": (1e20, 1e28, 1e37, 3.3e38)}
"""Numbers that overflow in a product of two, in any product of two, in a sum of a hundred, in a sum of two."""


def check_not_finite(
    kernels: Kernels, table: tuple[Kernel, ...], pool: Mapping[Argument, FloatArray], scalar: Scalar = DOUBLE
) -> list[Check]:
    """Check that NaN and infinity in any entry of an argument make every entry NaN that depends on it.

    Single calls and a stack of configurations are checked. A result depends on an entry if it changes with the entry.
    """
    calls = [(kernel, kernel.qualified_name, kernels[kernel.qualified_name]) for kernel in table]
    larges = LARGE[scalar.name]
    with np.errstate(all="ignore"):
        return [
            *(faultless(name, "NaN and infinity in", _faults(call, each, pool)) for each, name, call in calls),
            *(faultless(name, "large numbers in", _overflows(call, each, pool, larges)) for each, name, call in calls),
        ]


def _faults(call: Any, kernel: Kernel, pool: Mapping[Argument, FloatArray]) -> list[str]:
    """Return the entries and values with a wrong effect, in a single call or in a stack.

    In the stack the configurations take turns, so that all lanes of a vector are tried.
    """
    stacks = [pool[argument][:STACK] for argument in kernel.arguments]
    clean_stack = [np.array(each) for each in as_results(call(*stacks))]
    is_number = np.all([np.isfinite(each.reshape(len(each), -1)).all(axis=1) for each in clean_stack], axis=0)
    if not is_number.any():
        return ["no random arguments give a finite result (their draws may not suit the function)"]
    sound = int(np.flatnonzero(is_number)[0])
    single = [np.array(stack[sound]) for stack in stacks]
    clean, faults, trials = _flat(call(*single)), [], 0
    negligible = _DEPENDS * max(1.0, float(np.abs(clean).max()))
    for k, (argument, array) in enumerate(zip(kernel.arguments, single, strict=True)):
        for index in np.ndindex(array.shape):
            moved = array[index] + 0.1 * (1 + abs(array[index]))
            depends = ~(np.abs(_flat(call(*_changed(single, k, index, moved))) - clean) <= negligible)
            for value in (np.nan, np.inf, -np.inf):
                title = f"{value} in {argument.name}{list(index)}"
                if not _right(_flat(call(*_changed(single, k, index, value))), clean, depends):
                    faults.append(title)
                trials += 1
                configuration = trials % STACK  # the next one of the stack
                changed = _changed(stacks, k, (configuration, *index), value)
                found = [np.array(each) for each in as_results(call(*changed))]
                faults += _faults_in_stack(found, clean_stack, configuration, depends, title)
    return faults


def _changed(arrays: Sequence[FloatArray], k: int, place: Any, value: Any) -> list[FloatArray]:
    """Return the arrays with another value at a place of the k-th one."""
    changed = arrays[k].copy()
    changed[place] = value
    return [*arrays[:k], changed, *arrays[k + 1 :]]


def _faults_in_stack(
    found: list[FloatArray], clean: list[FloatArray], configuration: int, depends: Any, title: str
) -> list[str]:
    """Return the faults of a stack's results where one configuration has a NaN or infinity.

    ``depends`` is that of the single call: each configuration has values of its own, but the same entries depend.
    """
    faults, others = [], np.arange(STACK) != configuration
    pairs = ((f[others], c[others]) for f, c in zip(found, clean, strict=True))
    if not all(np.array_equal(*pair, equal_nan=True) for pair in pairs):
        faults.append(f"{title} of one configuration reaches another")
    own, own_clean = (np.concatenate([each[configuration].ravel() for each in results]) for results in (found, clean))
    if np.isinf(own).any() or not _right(own, own_clean, depends):
        faults.append(f"{title}, in a stack")
    return faults


def _overflows(call: Any, kernel: Kernel, pool: Mapping[Argument, FloatArray], larges: Sequence[float]) -> list[str]:
    """Return infinite results, single and in a stack, of large numbers in one entry, one argument and all arguments."""
    stacks = [pool[argument][:STACK] for argument in kernel.arguments]
    faults = []
    for large in larges:
        all_large = [np.copysign(large, stack) for stack in stacks]
        plans = [("everywhere", all_large)]  # titles, and the arguments of a call
        for k, (argument, stack) in enumerate(zip(kernel.arguments, stacks, strict=True)):
            plans.append((f"in {argument.name}", [*stacks[:k], all_large[k], *stacks[k + 1 :]]))
            for index in np.ndindex(stack.shape[1:]):
                entry = (..., *index)  # of all configurations
                plans.append((f"in {argument.name}{list(index)}", _changed(stacks, k, entry, all_large[k][entry])))
        for title, given in plans:
            single = [np.ravel(result) for each in zip(*given, strict=True) for result in as_results(call(*each))]
            if np.isinf(np.concatenate([_flat(call(*given)), *single])).any():
                faults.append(f"{large:g} {title}")
    return faults


def _right(found: FloatArray, clean: FloatArray, depends: Any) -> bool:
    """Return whether entries that depend on the argument are NaN, and all others NaN or as before."""
    return bool((np.isnan(found) | ~depends).all() and (np.isnan(found) | (found == clean)).all())


def _flat(value: Any) -> FloatArray:
    """Return the entries of all results, one after the other."""
    return np.concatenate([np.asarray(each, dtype=float).ravel() for each in as_results(value)])
