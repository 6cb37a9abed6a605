// SPDX-License-Identifier: MIT
// Small dense matrices, row-major in one array, as in the kernels.

/** Multiply A (n x k) by B (k x m). */
export function multiply(A, B, n, k, m) {
  const C = new Float64Array(n * m);
  for (let i = 0; i < n; ++i) {
    for (let l = 0; l < k; ++l) {
      const a = A[i * k + l];
      for (let j = 0; j < m; ++j) C[i * m + j] += a * B[l * m + j];
    }
  }
  return C;
}

/** Return the transpose (m x n) of A (n x m). */
export function transpose(A, n, m) {
  const T = new Float64Array(n * m);
  for (let i = 0; i < n; ++i) for (let j = 0; j < m; ++j) T[j * n + i] = A[i * m + j];
  return T;
}

/** Return the antisymmetric part (A - A^T)/2 of a square matrix. */
export function antisymmetric(A, n) {
  return A.map((value, k) => (value - A[(k % n) * n + Math.floor(k / n)]) / 2);
}

export function dot(a, b) {
  let sum = 0;
  for (let k = 0; k < a.length; ++k) sum += a[k] * b[k];
  return sum;
}

export const norm = (a) => Math.sqrt(dot(a, a));
export const largest = (A) => A.reduce((most, value) => Math.max(most, Math.abs(value)), 0);
export const plus = (a, b, factor = 1) => a.map((value, k) => value + factor * b[k]);
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const identity = (n) => Float64Array.from({ length: n * n }, (_, k) => (k % (n + 1) === 0 ? 1 : 0));

/** Return the matrix with the blocks A (3 x 3) and B (3 x 3) on its diagonal. */
export function blocks(A, B) {
  const M = new Float64Array(36);
  for (let i = 0; i < 3; ++i) {
    for (let j = 0; j < 3; ++j) {
      M[6 * i + j] = A[3 * i + j];
      M[6 * (i + 3) + j + 3] = B[3 * i + j];
    }
  }
  return M;
}

/** Return the block (3 x 3) of a matrix K (6 x 6) whose diagonal begins at row `first`. */
export const blockOf = (K, first) =>
  Float64Array.from({ length: 9 }, (_, k) => K[6 * (first + Math.floor(k / 3)) + first + (k % 3)]);

/** Solve A x = b, A (n x n), by Gaussian elimination with pivots; null where A is singular up to rounding. */
export function solve(A, b) {
  const n = b.length, M = Float64Array.from(A), x = Float64Array.from(b);
  for (let k = 0; k < n; ++k) {
    let pivot = k;
    for (let i = k + 1; i < n; ++i) if (Math.abs(M[i * n + k]) > Math.abs(M[pivot * n + k])) pivot = i;
    if (!(Math.abs(M[pivot * n + k]) > 0)) return null;
    for (let j = 0; j < n; ++j) [M[k * n + j], M[pivot * n + j]] = [M[pivot * n + j], M[k * n + j]];
    [x[k], x[pivot]] = [x[pivot], x[k]];
    for (let i = k + 1; i < n; ++i) {
      const factor = M[i * n + k] / M[k * n + k];
      for (let j = k; j < n; ++j) M[i * n + j] -= factor * M[k * n + j];
      x[i] -= factor * x[k];
    }
  }
  for (let k = n - 1; k >= 0; --k) {
    for (let j = k + 1; j < n; ++j) x[k] -= M[k * n + j] * x[j];
    x[k] /= M[k * n + k];
  }
  return x;
}

/** Return the determinant of A (n x n), n at most 3. */
export function determinant(A, n) {
  if (n === 1) return A[0];
  if (n === 2) return A[0] * A[3] - A[1] * A[2];
  return dot(A.slice(0, 3), cross(A.slice(3, 6), A.slice(6, 9)));
}

/** Compute eigenvalues and eigenvectors (columns of `vectors`) of a symmetric matrix by Jacobi's rotations. */
export function eigen(A, n) {
  const S = Float64Array.from(A), vectors = identity(n);
  const turned = (M, i, j, c, s, by, to) => {
    for (let k = 0; k < n; ++k) {
      const a = M[i * by + k * to], b = M[j * by + k * to];
      M[i * by + k * to] = c * a - s * b;
      M[j * by + k * to] = s * a + c * b;
    }
  };
  for (let sweep = 0; sweep < 30; ++sweep) {
    let off = 0;
    for (let i = 0; i < n; ++i) for (let j = i + 1; j < n; ++j) off += S[i * n + j] ** 2;
    if (off <= 1e-30 * dot(S, S)) break;
    for (let i = 0; i < n; ++i) {
      for (let j = i + 1; j < n; ++j) {
        if (S[i * n + j] === 0) continue;
        const angle = Math.atan2(2 * S[i * n + j], S[j * n + j] - S[i * n + i]) / 2;
        const c = Math.cos(angle), s = Math.sin(angle);
        turned(S, i, j, c, s, n, 1);
        turned(S, i, j, c, s, 1, n);
        turned(vectors, i, j, c, s, 1, n);
      }
    }
  }
  return { values: Array.from({ length: n }, (_, k) => S[k * n + k]), vectors };
}

/** Return the rotation (3 x 3) about w by the angle |w| [rad] (Rodrigues). */
export function turn(w) {
  const angle = norm(w), sine = angle < 1e-8 ? 1 : Math.sin(angle) / angle;
  const rest = angle < 1e-4 ? 0.5 : (1 - Math.cos(angle)) / angle ** 2;
  const [x, y, z] = w, W = Float64Array.of(0, -z, y, z, 0, -x, -y, x, 0), W2 = multiply(W, W, 3, 3, 3);
  return identity(3).map((value, k) => value + sine * W[k] + rest * W2[k]);
}

/** Return the rotation vector [rad] of a rotation by less than pi. */
export function rotationVector(R) {
  const axis = [(R[7] - R[5]) / 2, (R[2] - R[6]) / 2, (R[3] - R[1]) / 2], sine = norm(axis);
  const angle = Math.atan2(sine, (R[0] + R[4] + R[8] - 1) / 2);
  return axis.map((value) => value * (sine < 1e-12 ? 1 : angle / sine));
}
