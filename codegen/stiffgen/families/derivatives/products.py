# SPDX-License-Identifier: MIT
"""Kernels of vector-Jacobian products: a kernel NAME_vjp for every kernel NAME."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.core.symbolic.program import Program
from stiffgen.core.symbolic.quantities import Normal
from stiffgen.core.symbolic.steps import ArgumentSlice, Sum, Term
from stiffgen.families.derivatives import adjoint, gradients


def _cotangent(result: Argument, count: int) -> Argument:
    """Return the cotangent of a result of a kernel with ``count`` results."""
    meaning = f"weight of each entry of {result.name}" + (", both triangles" if result.symmetric else "")
    name = gradients.cotangent_name(result.name, count)
    return Argument(
        name, result.shape, "1", meaning, symbol="G" if count == 1 else f"G_{result.name}", per_configuration=True,
        draw=Normal(), largest="none",
    )  # fmt: skip


def _gradient(argument: Argument) -> Argument:
    """Return the gradient with respect to an argument, a result of the product."""
    name = gradients.bar_name(argument.name)
    if argument.is_base_pose:
        meaning = (
            "gradient with respect to the base's motion: covector of the base link's twist (linear, angular) in base "
            "link axes; its product with (v, w) is the change of L as the base moves to p + R v, R exp([w])"
        )
        return Argument(name, (6,), "1/m, 1/rad", meaning)
    meaning = f"gradient with respect to {argument.name}"
    if argument.symmetric_part:
        meaning += ", symmetric"
    return Argument(name, argument.shape, f"1/({argument.unit})", meaning)


def _reverse_program(chain: Chain, of: Kernel) -> Program:
    """Return the program of the product of ``of``: a total over the tips is differentiated tip by tip."""
    inputs, results = ([argument.array(chain) for argument in each] for each in (of.arguments, of.results))
    cotangents = [_cotangent(result, len(results)).array(chain) for result in of.results]
    return adjoint.reverse(chain, (of.by_tips or of.program)(chain), inputs, results, cotangents)


def _product_of_whole(chain: Chain, of: Kernel, whole: Kernel) -> Program:
    """Return the program of the product of ``whole``, with zero cotangents for results that ``of`` does not have."""
    product = vector_jacobian_product(whole)
    cotangents_of_part = {result.name: _cotangent(result, len(of.results)).array(chain) for result in of.results}
    inputs = [(argument.array(chain), ArgumentSlice(argument.array(chain))) for argument in whole.arguments]
    for result in whole.results:
        cotangent = _cotangent(result, len(whole.results)).array(chain)
        inputs.append((cotangent, ArgumentSlice(cotangents_of_part.get(result.name))))  # without one: zeros
    outputs = tuple(result.array(chain) for result in product.results)
    term = Term(product.qualified_name, chain, product.program(chain), tuple(inputs))
    return (Sum(outputs, tuple(output.name for output in outputs), (term,)),)


def vector_jacobian_product(of: Kernel, whole: Kernel | None = None) -> Kernel:
    """Return the kernel NAME_vjp: gradients with respect to every argument, from one cotangent per result.

    ``whole`` is the larger kernel that includes the results of ``of``, if any.
    """
    count = len(of.results)
    cotangents = tuple(_cotangent(result, count) for result in of.results)
    names = " + ".join(f"sum {cotangent.name} * {r.name}" for cotangent, r in zip(cotangents, of.results, strict=True))
    return replace(
        of,
        name=f"{of.name}_vjp",
        arguments=(*of.arguments, *cotangents),
        results=tuple(map(_gradient, of.arguments)),
        summary=f"Reverse mode of {of.name}: gradients of L = {names} with respect to every argument.",
        equation=f"x_bar = (d {', '.join(result.name for result in of.results)}/dx)^T cotangent",
        note="",
        product_of=of.name,
        program=partial(_product_of_whole, of=of, whole=whole) if whole else partial(_reverse_program, of=of),
    )


def products(kernels: tuple[Kernel, ...]) -> Iterator[Kernel]:
    """Yield VJP kernels, callees first: the product of a part calls that of the whole kernel."""
    by_name = {(kernel.path, kernel.name): kernel for kernel in kernels}
    parts_of: dict[tuple[tuple[str, ...], str], list[Kernel]] = {}  # by path and name of the whole kernel
    for kernel in kernels:
        whole = kernel.path, kernel.part_of
        if whole in by_name:
            parts_of.setdefault(whole, []).append(kernel)
    for kernel in kernels:
        if kernel.is_gradient:
            continue
        if (kernel.path, kernel.part_of) not in by_name:
            yield vector_jacobian_product(kernel)
        for part in parts_of.get((kernel.path, kernel.name), ()):
            yield vector_jacobian_product(part, whole=kernel)
