# SPDX-License-Identifier: MIT
"""Run the functions of NAME.casadi, NAME.torch or NAME.jax at given states: a program of its own.

``python -m stiffgen.lab.languages.frameworks FRAMEWORK FOLDER ASKED.npz ANSWERED.npz``. ASKED has the functions'
paths, and stacks of arguments, directions and cotangents; ANSWERED gets results and derivatives. JAX starts threads,
which would disturb the forks of ``stiffgen verify``, and PyTorch takes the name of an operator once per process.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from functools import reduce
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from stiffgen.core.opened import open_robot

Stacks = Sequence[Any]
Answer = tuple[list[Any], Any, Any]
"""Results, and derivatives along the directions in reverse and forward mode (None for a function without them)."""


def main(framework: str, folder: str, asked: str, answered: str) -> None:
    """Run every function and write the answers."""
    package = open_robot(Path(folder)).module
    module, answer = import_module(f"{package.__name__}.{framework}"), _ANSWERS[framework]
    results: dict[str, Any] = {}
    with np.load(asked) as given:
        for k, path in enumerate(json.loads(str(given["paths"]))):
            function = reduce(getattr, path.split("."), module)
            parts = [_stacks(given, f"{k} {what} ") for what in ("given", "direction", "cotangent")]
            values, reverse, forward = answer(function, *parts)
            results |= {f"{k} value {i}": np.asarray(value) for i, value in enumerate(values)}
            if reverse is not None:
                results |= {f"{k} reverse": np.asarray(reverse), f"{k} forward": np.asarray(forward)}
    np.savez(answered, **results)


def _stacks(given: Any, start: str) -> list[Any]:
    """Return the arrays whose names have this start, in their order."""
    count = sum(name.startswith(start) for name in given.files)
    return [given[f"{start}{i}"] for i in range(count)]


def _casadi(function: Any, given: Stacks, directions: Stacks, cotangents: Stacks) -> Answer:
    """Evaluate state by state: casadi.Function takes no stacks. Forward mode takes all derivatives at once."""
    values: list[list[Any]] = []
    reverse, forward = [], []
    for state in range(len(given[0])):
        matrices = [_matrix(each[state]) for each in given]
        results = [np.array(each) for each in function.call(matrices)]
        values.append([each.ravel() for each in results])
        if not cotangents:
            continue
        rates = [_matrix(each[state]) for each in directions]
        weights = [_matrix(each[state]) for each in cotangents]
        gradients = function.reverse(1).call([*matrices, *results, *weights])
        reverse.append(sum(float((np.array(g) * rate).sum()) for g, rate in zip(gradients, rates, strict=True)))
        jacobian = function.jacobian().call([*matrices, *results])
        forward.append(_casadi_forward(jacobian, weights, rates))
    stacked = [np.stack(each) for each in zip(*values, strict=True)]
    if not cotangents:
        return stacked, None, None
    return stacked, np.array(reverse), np.array(forward)


def _casadi_forward(jacobian: list[Any], weights: list[Any], rates: list[Any]) -> float:
    """Return weights . J . rates from CasADi's blocks of J: result by result, and in each argument by argument.

    CasADi counts the entries of a matrix column by column.
    """
    pairs = [(weight, rate) for weight in weights for rate in rates]
    return sum(
        float(weight.ravel(order="F") @ np.array(block) @ rate.ravel(order="F"))
        for block, (weight, rate) in zip(jacobian, pairs, strict=True)
    )


def _matrix(value: Any) -> Any:
    """Return an array as CasADi's matrix: three indices combine the first two."""
    return value.reshape(-1, value.shape[-1]) if value.ndim > 1 else value.reshape(-1, 1)


def _torch(function: Any, given: Stacks, directions: Stacks, cotangents: Stacks) -> Answer:
    """Return values, reverse mode contracted with directions, and forward mode contracted with cotangents."""
    torch = import_module("torch")
    tensors = [torch.tensor(each, requires_grad=bool(cotangents)) for each in given]
    values = _several(function(*tensors))
    found = [each.detach().numpy() for each in values]
    if not cotangents:
        return found, None, None
    weights, rates = ([torch.tensor(each) for each in stacks] for stacks in (cotangents, directions))
    gradients = torch.autograd.grad(values, tensors, weights, allow_unused=True, materialize_grads=True)
    constants = tuple(each.detach() for each in tensors)
    changes = _several(torch.func.jvp(function, constants, tuple(rates))[1])
    return found, _contracted(gradients, rates), _contracted(changes, weights)


def _jax(function: Any, given: Stacks, directions: Stacks, cotangents: Stacks) -> Answer:
    """Return values, reverse mode contracted with directions, and forward mode contracted with cotangents."""
    jax = import_module("jax")
    jax.config.update("jax_enable_x64", True)
    if not cotangents:
        return list(_several(function(*given))), None, None

    def results(*arguments: Any) -> Any:
        return _several(function(*arguments))

    values, pulled_back = jax.vjp(results, *given)
    gradients = pulled_back(tuple(cotangents))
    changes = jax.jvp(results, tuple(given), tuple(directions))[1]
    return list(values), _contracted(gradients, directions), _contracted(changes, cotangents)


def _several(results: Any) -> tuple[Any, ...]:
    return tuple(results) if isinstance(results, (tuple, list)) else (results,)


def _contracted(these: Stacks, others: Stacks) -> Any:
    """Return the sum of the products of all entries, one per state."""
    pairs = [(np.asarray(one), np.asarray(other)) for one, other in zip(these, others, strict=True)]
    return sum((one * other).reshape(len(one), -1).sum(1) for one, other in pairs)


_ANSWERS: dict[str, Callable[[Any, Stacks, Stacks, Stacks], Answer]] = {
    "casadi": _casadi,
    "torch": _torch,
    "jax": _jax,
}

if __name__ == "__main__":
    main(*sys.argv[1:])
