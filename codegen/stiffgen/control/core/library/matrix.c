/* Numbers, vectors, and matrices of N rows, row-major. */
#include "impedance.h"

/* Count up to LONGEST. */
int count_up(int x, int by)
{
    const int sum = x + by;
    return sum < LONGEST ? sum : LONGEST;
}

/* Compute y += a x. */
void add_scaled(int count, double a, const double *x, double *y)
{
    for (int i = 0; i < count; ++i) {
        y[i] += a * x[i];
    }
}

/* Mix two vectors: a + share (b - a). Return the largest distance to b that is left. */
double mix(int count, const double *a, const double *b, double share, double *result)
{
    double left = 0.0;
    for (int i = 0; i < count; ++i) {
        result[i] = a[i] + share * (b[i] - a[i]);
        left = larger(left, fabs(b[i] - result[i]));
    }
    return left;
}

/* Factorise A = L L^T in place: the lower triangle becomes L. Return 0 where A is not positive definite. */
int factorise(double *A)
{
    static const double least_pivot = 1e-12; /* over the diagonal: what rounding leaves of a singular matrix */
    for (int i = 0; i < N; ++i) {
        double *const row = A + i * N;
        for (int j = 0; j < i; ++j) {
            row[j] = (row[j] - dot(j, row, A + j * N)) / A[j * (N + 1)];
        }
        const double pivot = row[i] - dot(i, row, row);
        if (!(pivot > least_pivot * fabs(row[i]))) {
            return 0;
        }
        row[i] = sqrt(pivot);
    }
    return 1;
}

/* Invert the lower triangle L in place; the upper one stays. */
void invert_triangle(double *L)
{
    for (int j = 0; j < N; ++j) {
        L[j * (N + 1)] = 1.0 / L[j * (N + 1)];
        for (int i = j + 1; i < N; ++i) { /* columns beyond j are still those of L */
            double sum = L[i * N + j] * L[j * (N + 1)];
            for (int k = j + 1; k < i; ++k) {
                sum += L[i * N + k] * L[k * N + j];
            }
            L[i * N + j] = -sum / L[i * (N + 1)];
        }
    }
}

/* Replace a symmetric K by C = L^-1 K L^-T. inverse: L^-1. */
void form_pencil(const double *inverse, double *K)
{
    for (int j = 0; j < N; ++j) {
        for (int i = N - 1; i >= 0; --i) { /* L^-1 K: row i needs the rows above alone */
            double sum = 0.0;
            for (int k = 0; k <= i; ++k) {
                sum += inverse[i * N + k] * K[k * N + j];
            }
            K[i * N + j] = sum;
        }
    }
    for (int i = 0; i < N; ++i) {
        for (int j = i; j >= 0; --j) { /* entry j needs the entries before it alone */
            K[i * N + j] = dot(j + 1, inverse + j * N, K + i * N);
        }
    }
    for (int i = 0; i < N; ++i) {
        for (int j = i + 1; j < N; ++j) {
            K[i * N + j] = K[j * N + i];
        }
    }
}

/* Compute L x. inverse: L^-1, which takes the place of L. */
void multiply_lower(const double *inverse, const double *x, double *result)
{
    for (int i = 0; i < N; ++i) {
        result[i] = (x[i] - dot(i, inverse + i * N, result)) / inverse[i * (N + 1)];
    }
}

/* Compute L^T x. inverse: L^-1. */
void multiply_upper(const double *inverse, const double *x, double *result)
{
    memcpy(result, x, N * sizeof *result);
    for (int last = 0; last < N; ++last) {
        const int i = N - 1 - last;
        for (int k = i + 1; k < N; ++k) {
            result[i] -= inverse[k * N + i] * result[k];
        }
        result[i] /= inverse[i * (N + 1)];
    }
}
