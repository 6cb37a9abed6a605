"""Wrapper for PyTorch on the CPU: operators with autograd and vmap (first derivatives in both modes).

The operators (torch.ops.NAME.hybrid_joint_stiffness and others) read and write the tensors' memory in place. They
compute in float64; other real tensors are converted first. Leading dimensions broadcast as in NumPy. The gradient with
respect to a stiffness is symmetric, and exact for motions of the base with respect to base_pose.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import torch

from . import _c
from ._functions import MOTIONS, NAME, Function, entry_gradient, namespaces, unbroadcast

Tensors = tuple[torch.Tensor, ...]


def _operator(function: Function) -> Any:
    """Return the function as an operator; its tensors must have the same number of leading dimensions."""
    ufunc = getattr(_c, function.name)
    parameters = ", ".join(f"Tensor {name}" for name in function.arguments)
    one = len(function.results) == 1
    schema = f"({parameters}) -> {'Tensor' if one else '(' + ', '.join(['Tensor'] * len(function.results)) + ')'}"

    def empty(*tensors: torch.Tensor) -> Tensors | torch.Tensor:
        leading = function.leading([tuple(tensor.shape) for tensor in tensors])
        results = tuple(tensors[0].new_empty((*leading, *shape)) for shape in function.results)
        return results[0] if one else results

    def evaluate(*tensors: torch.Tensor) -> Tensors | torch.Tensor:
        """Check the tensors' type, and compute into the memory of new ones."""
        for tensor, name in zip(tensors, function.arguments, strict=True):
            if tensor.dtype != torch.float64:
                raise TypeError(f"{function.path}(): {name} is {tensor.dtype}; the operator needs torch.float64")
        results = empty(*tensors)
        out = tuple(result.numpy() for result in ((results,) if one else results))  # views of the tensors' memory
        ufunc(*(tensor.detach().numpy() for tensor in tensors), out=out)
        return results

    def batched(info: Any, dimensions: tuple[int | None, ...], *tensors: torch.Tensor) -> tuple[Any, Any]:
        moved = [
            tensor.unsqueeze(0) if dimension is None else tensor.movedim(dimension, 0)
            for tensor, dimension in zip(tensors, dimensions, strict=True)
        ]
        return operator(*moved), 0 if one else (0,) * len(function.results)

    operator = torch.library.custom_op(
        f"{NAME}::{function.name}", evaluate, mutates_args=(), device_types="cpu", schema=schema
    )
    operator.register_fake(empty)
    operator.register_vmap(batched)
    return operator


def _traced(operator: Any, keep: Any, pulled_back: Any, pushed_forward: Any) -> Any:
    """Return the operator for torch.func.grad and similar, which ignore the gradient registered with an operator."""

    def keep_for_both(ctx: Any, inputs: Tensors, output: Any) -> None:
        keep(ctx, inputs, output)
        ctx.save_for_forward(*inputs)

    class Traced(torch.autograd.Function):
        generate_vmap_rule = True
        forward = staticmethod(lambda *tensors: operator(*tensors))
        setup_context = staticmethod(keep_for_both)
        backward = staticmethod(pulled_back)
        jvp = staticmethod(pushed_forward)

    return Traced.apply


def _units(function: Function, sizes: list[int], leading: int) -> Tensors:
    """Return a unit cotangent for each entry of the results, along a dimension before the leading ones.

    The tensor of each result has the shape (entries of all results, 1, ..., 1, *shape of the result), with as many ones
    as there are ``leading`` dimensions.
    """
    units = torch.eye(sum(sizes), dtype=torch.float64).split(sizes, dim=1)
    return tuple(
        unit.reshape(sum(sizes), *(1,) * leading, *shape) for unit, shape in zip(units, function.results, strict=True)
    )


def _differentiable(function: Function) -> Any:
    """Return the function with gradients from its vector-Jacobian product, if it has one."""
    operator = _operator(function)
    one = len(function.results) == 1

    def keep(ctx: Any, inputs: Tensors, output: Any) -> None:
        ctx.save_for_backward(*inputs)

    def no_more(ctx: Any, *cotangents: torch.Tensor) -> None:
        only_first = f"{function.path}() has first derivatives only"
        raise NotImplementedError(function.no_derivative if function.is_gradient else only_first)

    def gradients_of(tensors: Tensors, cotangents: Tensors) -> list[torch.Tensor]:
        gradients = traced_product(*tensors, *cotangents)
        each = gradients if isinstance(gradients, tuple) else (gradients,)
        if "base_pose" in function.arguments:
            motions = torch.tensor(MOTIONS, dtype=torch.float64)
            each = (entry_gradient(each[0], tensors[0], motions), *each[1:])
        return list(each)

    def pulled_back(ctx: Any, *cotangents: torch.Tensor) -> Tensors | torch.Tensor:
        tensors = ctx.saved_tensors
        pairs = zip(gradients_of(tensors, cotangents), tensors, strict=True)
        results = tuple(unbroadcast(gradient, tensor.shape) for gradient, tensor in pairs)
        return results if len(results) > 1 else results[0]

    def pushed_forward(ctx: Any, *tangents: torch.Tensor | None) -> Tensors | torch.Tensor:
        """Return the Jacobian-vector product, from the gradients of all entries of the results in one batch."""
        tensors = ctx.saved_tensors
        leading = function.leading([tuple(tensor.shape) for tensor in tensors])
        sizes = [math.prod(shape) for shape in function.results]
        cotangents = _units(function, sizes, len(leading))
        change = torch.zeros((sum(sizes), *leading), dtype=torch.float64)
        gradients = gradients_of(tuple(tensor.unsqueeze(0) for tensor in tensors), cotangents)
        for gradient, tangent in zip(gradients, tangents, strict=True):
            if tangent is not None:
                products = gradient * tangent.unsqueeze(0)  # (entries, *leading, *shape of the argument)
                # flat, since the entries of a number have no dimension to sum over
                change = change + products.reshape(*products.shape[: 1 + len(leading)], -1).sum(-1)
        parts = change.movedim(0, -1).split(sizes, dim=-1)
        results = tuple(part.reshape((*leading, *shape)) for part, shape in zip(parts, function.results, strict=True))
        return results[0] if one else results

    if function.is_gradient:
        pulled_back = pushed_forward = no_more
    else:
        traced_product = _traced(_operator(function.product), keep, no_more, no_more)
    operator.register_autograd(pulled_back, setup_context=keep)
    traced = _traced(operator, keep, pulled_back, pushed_forward)

    @functools.wraps(getattr(_c, function.name))
    def call(*arguments: Any, **named: Any) -> Tensors | torch.Tensor:
        tensors = [torch.as_tensor(each).to(torch.float64) for each in function.ordered(arguments, named)]
        shapes = function.aligned([tuple(tensor.shape) for tensor in tensors])
        results: Any = traced(*(tensor.reshape(shape) for tensor, shape in zip(tensors, shapes, strict=True)))
        return results if one else tuple(results)

    return call


globals().update(namespaces(_differentiable))
