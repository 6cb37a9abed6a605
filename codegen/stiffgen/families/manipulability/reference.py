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
        others = np.stack([np.prod(np.delete(s, k, axis=1), axis=1) for k in range(s.shape[1])], axis=1)
        gradient = np.einsum("sk,sak,siab,skb->si", others, U, rates, Vt)
        sensitivity = s[:, 0] * others.sum(axis=1)
        condition = s[:, 0] / np.maximum(s[:, -1], np.finfo(float).tiny ** 0.5)
        # Columns of dJ/dq are Lie brackets of those of J; sums of brackets can cancel in every entry.
        rate = s[:, 0] * (1 + s[:, 0]) * condition * others.max(axis=1)
        return Manipulability(s.prod(axis=1), gradient, sensitivity, np.broadcast_to(rate[:, None], gradient.shape))
