# SPDX-License-Identifier: MIT
"""Manipulability and its gradient from the singular values of the Jacobian, with the rounding close to a singularity.

With J = U diag(s) V^T the manipulability is the product of s, and dw = sum over k of prod(s without s_k) u_k^T dJ v_k.
Neither divides by a singular value. A relative error e of J changes each s_k by e s_1 and turns u_k and v_k by up to
e s_1/s_k; that is what the errors count.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiffgen.core.robot.geometry import FloatArray


@dataclass(frozen=True)
class Manipulability:
    """References of one tip.

    Attributes:
        measure: w [m^3 with six or more hinges], (count,).
        gradient: dw/dq [m^3/rad], (count, n).
        measure_error: change of w for a relative change of J by one, to first order, (count,).
        gradient_error: the same of the gradient's entries, (count, n).

    """

    measure: FloatArray
    gradient: FloatArray
    measure_error: FloatArray
    gradient_error: FloatArray

    @staticmethod
    def of(jacobian: FloatArray, derivative: FloatArray) -> Manipulability:
        """Return the references of stacks of J, (count, 6, m), and of dJ/dq, (count, n, 6, m)."""
        U, s, Vt = np.linalg.svd(np.asarray(jacobian, dtype=float), full_matrices=False)
        rates = np.asarray(derivative, dtype=float)
        largest, least = s[:, 0], s[:, -1]
        others = np.stack([np.prod(np.delete(s, k, axis=1), axis=1) for k in range(s.shape[1])], axis=1)  # without s_k
        # dw/dq_i = sum over k of others_k u_k^T dJ/dq_i v_k; s for the state, a and b for row and column of J
        gradient = np.einsum("sk,sak,siab,skb->si", others, U, rates, Vt)
        # A relative error e of J changes each s_k by e s_1, and w by e s_1 times the sum of the others' products.
        measure_error = largest * others.sum(axis=1)
        # dw/dq_i is w tr(J^+ dJ/dq_i), and J^+ changes by up to e s_1/s_min of its size. Columns of dJ/dq are Lie
        # brackets of those of J; sums of brackets can cancel in every entry.
        condition = largest / np.maximum(least, np.finfo(float).tiny ** 0.5)
        gradient_error = largest * (1 + largest) * condition * others.max(axis=1)
        return Manipulability(
            measure=s.prod(axis=1),
            gradient=gradient,
            measure_error=measure_error,
            gradient_error=np.broadcast_to(gradient_error[:, None], gradient.shape),
        )
