#include "law.h"

/* Return whether all numbers lie between the bounds. NaN does not: its bits tell, whatever a compiler's flags say. */
int all_within(const double *x, int count, double least, double most)
{
    int good = 1;
    for (int i = 0; i < count; ++i) {
        uint64_t bits;
        memcpy(&bits, x + i, sizeof bits);
        good = good && (bits << 1) < 0xffe0000000000000u && x[i] >= least && x[i] <= most;
    }
    return good;
}

/* Diagonalise a symmetric matrix (n x n) by rotations (Jacobi): A becomes V^T A V, diagonal. */
static void diagonalise(int n, double *A, double *V)
{
    for (int i = 0; i < n * n; ++i) {
        V[i] = i % (n + 1) == 0 ? 1.0 : 0.0; /* unit matrix */
    }
    for (int k = 0; k < SWEEPS * n * n; ++k) {
        const int p = k / n % n, q = k % n; /* row and column of the next entry, sweep after sweep */
        if (p >= q || !(fabs(A[p * n + q]) > 1e-130)) { /* below the diagonal, or 0 but for numbers that underflow */
            continue;
        }
        const double ratio = (A[q * n + q] - A[p * n + p]) / (2.0 * A[p * n + q]); /* t^2 + 2 ratio t = 1 makes it 0 */
        const double t = copysign(1.0, ratio) / (fabs(ratio) + sqrt(ratio * ratio + 1.0));
        const double c = 1.0 / sqrt(t * t + 1.0), s = t * c;
        for (int i = 0; i < n; ++i) { /* columns p and q */
            const double a = A[i * n + p], b = A[i * n + q], v = V[i * n + p], w = V[i * n + q];
            A[i * n + p] = c * a - s * b;
            A[i * n + q] = s * a + c * b;
            V[i * n + p] = c * v - s * w;
            V[i * n + q] = s * v + c * w;
        }
        for (int i = 0; i < n; ++i) { /* rows p and q */
            const double a = A[p * n + i], b = A[q * n + i];
            A[p * n + i] = c * a - s * b;
            A[q * n + i] = s * a + c * b;
        }
    }
}

/* Factorise M = L L^T (Cholesky). Return whether M is positive definite. */
static int factorise(const double *M, double *L)
{
    memset(L, 0, N * N * sizeof(double));
    for (int i = 0; i < N; ++i) {
        for (int j = 0; j <= i; ++j) {
            double rest = M[i * N + j];
            for (int k = 0; k < j; ++k) {
                rest -= L[i * N + k] * L[j * N + k];
            }
            if (i == j && !(rest > 0.0)) {
                return 0;
            }
            L[i * N + j] = i == j ? sqrt(rest) : rest / L[j * N + j];
        }
    }
    return 1;
}

/* Solve L x = y in place; the entries of x lie a stride apart. */
static void solve(const double *L, double *x, int stride)
{
    for (int i = 0; i < N; ++i) {
        for (int j = 0; j < i; ++j) {
            x[i * stride] -= L[i * N + j] * x[j * stride];
        }
        x[i * stride] /= L[i * N + i];
    }
}

/*
 * Design B = L U diag(2 zeta sqrt|l|) U^T L^T + d I, with M = L L^T and the symmetric part of Kq = L U diag(l) U^T L^T.
 * A mode with l < 0, which falls, is damped as if it stood. Return whether M is positive definite.
 */
int design_damping(const CALL(paper_config) *c, const double *M, const double *K, double *B)
{
    double L[N * N], A[N * N], U[N * N];
    if (!factorise(M, L)) {
        return 0;
    }
    for (int i = 0; i < N * N; ++i) {
        A[i] = (K[i] + K[i % N * N + i / N]) / 2.0; /* row i / N, column i % N, with its transpose */
        B[i] = i % (N + 1) == 0 ? c->joint_damping : 0.0;
    }
    for (int i = 0; i < 2 * N; ++i) { /* all columns: L^-1 A, then all rows: L^-1 A L^-T = U diag(l) U^T */
        solve(L, i < N ? A + i : A + (i - N) * N, i < N ? N : 1);
    }
    diagonalise(N, A, U);
    for (int k = 0; k < N; ++k) {
        double mode[N] = {0.0}; /* column k of L U */
        for (int i = 0; i < N * N; ++i) {
            mode[i / N] += L[i] * U[i % N * N + k];
        }
        for (int i = 0; i < N * N; ++i) {
            B[i] += 2.0 * c->damping_ratio * sqrt(fabs(A[k * (N + 1)])) * mode[i / N] * mode[i % N];
        }
    }
    return 1;
}

/* Return whether a task stiffness (6 x 6) is finite, symmetric and positive semidefinite, up to single precision. */
int is_stiffness(const double *K)
{
    double A[36], V[36], size = 0.0, off = 0.0, least = 0.0;
    for (int i = 0; i < 36; ++i) {
        A[i] = (K[i] + K[i % 6 * 6 + i / 6]) / 2.0; /* with its transpose */
        size = fmax(size, fabs(K[i]));
        off = fmax(off, fabs(K[i] - A[i]));
    }
    diagonalise(6, A, V);
    for (int i = 0; i < 6; ++i) {
        least = fmin(least, A[7 * i]); /* eigenvalue on the diagonal */
    }
    return all_within(K, 36, -1e9, 1e9) && off <= 1e-6 * size && least >= -1e-6 * size;
}
