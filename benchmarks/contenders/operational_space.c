/* SPDX-License-Identifier: MIT */
/*
 * Torques in operational space of many configurations: J^T Lambda (kp e - kd J dq), Lambda = (J M^-1 J^T)^-1. J and M
 * come from generated batches of a robot named "batch" with 7 joints; the rest runs in vectors of 8 configurations.
 */
#include <stddef.h>

#include "batch.h"

enum { N = 7, LANES = 8, CHUNK = 64 };
typedef double lanes __attribute__((vector_size(8 * LANES)));

/* Overwrite A by L below and D on the diagonal of A = L D L^T. */
static inline void factor(int size, lanes A[size][size])
{
    for (int j = 0; j < size; ++j) {
        for (int i = j + 1; i < size; ++i) {
            const lanes part = A[i][j] / A[j][j];
            for (int k = j + 1; k <= i; ++k) A[i][k] -= part * A[k][j];
            A[j][i] = part;
        }
        for (int i = j + 1; i < size; ++i) A[i][j] = A[j][i];
    }
}

static void torques_of_eight(const double *J, const double *M, const double *dq, const double *error, const double gains[2], double *torque)
{
    lanes mass[N][N], column[6][N], y[6][N], A[6][6], f[6];
    for (int c = 0; c < LANES; ++c) {
        for (int i = 0; i < N; ++i)
            for (int j = 0; j < N; ++j) mass[i][j][c] = M[N * N * c + N * i + j];
        for (int k = 0; k < 6; ++k) {
            double rate = 0;
            for (int j = 0; j < N; ++j) {
                column[k][j][c] = J[6 * N * c + N * k + j];
                rate += J[6 * N * c + N * k + j] * dq[N * c + j];
            }
            f[k][c] = gains[0] * error[6 * c + k] - gains[1] * rate;
        }
    }
    factor(N, mass);
    for (int k = 0; k < 6; ++k)
        for (int i = 0; i < N; ++i) {
            y[k][i] = column[k][i];
            for (int j = 0; j < i; ++j) y[k][i] -= mass[i][j] * y[k][j];
        }
    for (int k = 0; k < 6; ++k)
        for (int l = 0; l <= k; ++l) {
            lanes sum = y[k][0] * y[l][0] / mass[0][0];
            for (int i = 1; i < N; ++i) sum += y[k][i] * y[l][i] / mass[i][i];
            A[k][l] = A[l][k] = sum;
        }
    factor(6, A);
    for (int k = 0; k < 6; ++k)
        for (int l = 0; l < k; ++l) f[k] -= A[k][l] * f[l];
    for (int k = 5; k >= 0; --k) {
        f[k] /= A[k][k];
        for (int l = k + 1; l < 6; ++l) f[k] -= A[l][k] * f[l];
    }
    for (int j = 0; j < N; ++j) {
        lanes sum = column[0][j] * f[0];
        for (int k = 1; k < 6; ++k) sum += column[k][j] * f[k];
        for (int c = 0; c < LANES; ++c) torque[N * c + j] = sum[c];
    }
}

/* count is a multiple of 64; error is the pose error (6) per configuration, gains are kp [1/s^2] and kd [1/s]. */
void operational_space(size_t count, const double *q, const double *dq, const double *error, const double gains[2], double *torque)
{
    double J[6 * N * CHUNK], M[N * N * CHUNK];
    for (size_t c = 0; c < count; c += CHUNK) {
        batch_hybrid_jacobian_batch(CHUNK, q + N * c, N, J);
        batch_mass_matrix_batch(CHUNK, q + N * c, N, M);
        for (size_t k = 0; k < CHUNK; k += LANES) {
            const size_t at = c + k;
            torques_of_eight(J + 6 * N * k, M + N * N * k, dq + N * at, error + 6 * at, gains, torque + N * at);
        }
    }
}
