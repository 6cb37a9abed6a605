/* Symmetric matrices, row-major. */
#include "shared.h"

/*
 * Return the smallest eigenvalue of a symmetric 3 x 3 matrix. With B = K - mean 1, whose norm is sqrt(6) p, the roots
 * of the characteristic polynomial are mean + 2 p cos(angle + k third), where cos(3 angle) = det(B) / (2 p^3).
 */
double smallest_eigenvalue(const double *K)
{
    static const double rounded = 1e-9, third = 2.09439510239319549; /* [rad] of a turn: k = 1 */
    const double mean = (K[0] + K[4] + K[8]) / 3.0, a = K[0] - mean, d = K[4] - mean, f = K[8] - mean;
    const double b = K[1], c = K[2], e = K[5];
    const double p = sqrt((a * a + d * d + f * f + 2.0 * (b * b + c * c + e * e)) / 6.0);
    if (!(p > rounded * fabs(mean))) {
        return mean - 2.0 * p;
    }
    const double det = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d);
    const double angle = acos(clamp(0.5 * det / (p * p * p), -1.0, 1.0)) / 3.0;
    return mean + 2.0 * p * cos(angle + third);
}

/* Factorise a positive definite A = L L^T (lower triangles); the pivots of a semidefinite one are not quite 0. */
void find_triangle(int n, const double *A, double *L)
{
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j <= i; ++j) {
            const double rest = A[i * n + j] - dot(j, L + i * n, L + j * n);
            L[i * n + j] = i == j ? sqrt(larger(rest, DBL_MIN)) : rest / L[j * n + j];
        }
    }
}

/* Solve L L^T x = b in place. */
void solve_triangles(int n, const double *L, double *x)
{
    for (int i = 0; i < n; ++i) {
        x[i] = (x[i] - dot(i, L + i * n, x)) / L[i * n + i];
    }
    for (int i = n - 1; i >= 0; --i) {
        for (int k = i + 1; k < n; ++k) {
            x[i] -= L[k * n + i] * x[k];
        }
        x[i] /= L[i * n + i];
    }
}
