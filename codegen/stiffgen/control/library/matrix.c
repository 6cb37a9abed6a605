/*
 * Vectors and symmetric matrices of the controller: dense, row-major, n x n.
 *
 * A function that can fail returns 0 or a code MATRIX_...; after an error its results are unspecified. Results must
 * overlap neither an argument nor one another, unless a function allows it.
 * Source: G. Golub, C. Van Loan, Matrix Computations: Cholesky reduction (8.7).
 */
#include "impedance.h"

enum { BLOCK = 4 }; /* columns that combine_blocks takes at once, twice */

/* Return the larger of two numbers, or the one that is not NaN: fmax without a call into the C library. */
double larger(double x, double y)
{
    const double result = x > y ? x : y; /* y if one of them is NaN */
    return isnan(y) ? x : result;
}

/* Return the smaller of two numbers, or the one that is not NaN. */
double smaller(double x, double y)
{
    const double result = x < y ? x : y;
    return isnan(y) ? x : result;
}

double clamp(double x, double least, double most)
{
    if (x < least) {
        return least;
    }
    return x > most ? most : x;
}

/* Clamp a count to 0 ... most. */
int clamp_count(int x, int most)
{
    if (x < 0) {
        return 0;
    }
    return x < most ? x : most;
}

double dot(int count, const double *a, const double *b)
{
    double sum = 0.0;
    int i = 0;
    for (; i < count - 1; i += 2) {
        sum += a[i] * b[i];
        sum += a[i + 1] * b[i + 1];
    }
    return i < count ? sum + a[i] * b[i] : sum;
}

double norm(int count, const double *x)
{
    return sqrt(dot(count, x, x));
}

/*
 * Combine at least one row of A, n numbers apart, with factors that are `step` apart: BLOCK columns, and BLOCK columns
 * `apart` numbers behind these, which may overlap them.
 */
static inline void combine_blocks(int rows, int n, int apart, const double *factors, int step, const double *A,
                                  double *result)
{
    double a = 0.0, b = 0.0, c = 0.0, d = 0.0, e = 0.0, f = 0.0, g = 0.0, h = 0.0;
    for (int k = 0; k < rows; ++k) { /* eight numbers stay in registers: compilers make two or four vectors of them */
        const double x = factors[k * step], *const row = A + k * n, *const other = row + apart;
        a += x * row[0];
        b += x * row[1];
        c += x * row[2];
        d += x * row[3];
        e += x * other[0];
        f += x * other[1];
        g += x * other[2];
        h += x * other[3];
    }
    result[0] = a;
    result[1] = b;
    result[2] = c;
    result[3] = d;
    result[apart] = e;
    result[apart + 1] = f;
    result[apart + 2] = g;
    result[apart + 3] = h;
}

/*
 * Compute F A, m rows of n numbers. A has `rows` rows, and entry (i, k) of F is F[i down + k right]. Inline, so that
 * compilers see the numbers of rows and columns.
 */
static inline void multiply_matrices(int m, int rows, int n, const double *F, int down, int right, const double *A,
                                     double *result)
{
    const int blocks = 2 * BLOCK;
    int j = 0;
    for (; j <= n - BLOCK; j += blocks) {
        const int apart = clamp_count(n - BLOCK - j, BLOCK);
        for (int i = 0; i < m; ++i) {
            combine_blocks(rows, n, apart, F + i * down, right, A + j, result + i * n + j);
        }
    }
    for (; j < n; ++j) {
        for (int i = 0; i < m; ++i) {
            double sum = 0.0;
            for (int k = 0; k < rows; ++k) {
                sum += F[i * down + k * right] * A[k * n + j];
            }
            result[i * n + j] = sum;
        }
    }
}

/* Multiply rows by a square matrix A. */
void multiply_rows(int n, const double *rows, const double *A, double *result)
{
    multiply_matrices(n, n, n, rows, n, 1, A, result);
}

/* Add a x to y. */
void add_scaled(int count, double a, const double *x, double *y)
{
    for (int i = 0; i < count; ++i) {
        y[i] += a * x[i];
    }
}

/* Multiply a matrix over the joints and a vector. */
void multiply_vector(const double *A, const double *x, double *result)
{
    for (int i = 0; i < N; ++i) {
        result[i] = dot(N, A + i * N, x);
    }
}

/* Multiply 3 x 3 matrices with row lengths a and b: C = A B, or A^T B if transposed. */
void multiply3(const double *A, int a, int transposed, const double *B, int b, double *C)
{
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            double sum = 0.0;
            for (int k = 0; k < 3; ++k) {
                sum += (transposed ? A[a * k + i] : A[a * i + k]) * B[b * k + j];
            }
            C[3 * i + j] = sum;
        }
    }
}

/* Return the largest absolute entry, or infinity if an entry is NaN or infinite. */
double largest_entry(int count, const double *A)
{
    double result = 0.0;
    for (int i = 0; i < count; ++i) {
        const double size = fabs(A[i]);
        if (!(size <= DBL_MAX)) {
            return HUGE_VAL;
        }
        result = size > result ? size : result;
    }
    return result;
}

/* Return the largest entry of a positive semidefinite matrix, which is on its diagonal; at least 0. */
double largest_diagonal(int n, const double *A)
{
    double result = 0.0;
    for (int i = 0; i < n; ++i) {
        result = larger(result, A[i * (n + 1)]);
    }
    return result;
}

/* Transpose a matrix of `rows` rows with n numbers each. */
void transpose(int rows, int n, const double *A, double *result)
{
    for (int i = 0; i < n; ++i) {
        for (int k = 0; k < rows; ++k) {
            result[i * rows + k] = A[k * n + i];
        }
    }
}

/* Multiply each of n columns by its factor. */
void scale_columns(int rows, int n, const double *factors, double *A)
{
    for (int k = 0; k < rows; ++k) {
        for (int i = 0; i < n; ++i) {
            A[k * n + i] *= factors[i];
        }
    }
}

/* Compute X^T X of the rows of X, n numbers each; symmetric in every bit, since equal products are summed alike. */
void multiply_transposed(int rows, int n, const double *X, double *result)
{
    multiply_matrices(n, rows, n, X, 1, n, X, result);
}

/* Compute Y^T diag(d) Y of the rows of Y, n numbers each, d >= 0. The rows become those of diag(d)^(1/2) Y. */
void form_congruence(int rows, int n, double *Y, const double *d, double *result)
{
    for (int k = 0; k < rows; ++k) {
        const double root = sqrt(d[k]);
        for (int i = 0; i < n; ++i) {
            Y[k * n + i] *= root;
        }
    }
    multiply_transposed(rows, n, Y, result);
}

/* Compute the lower Cholesky factor L of A / scale + shift I, column by column. */
int factorise_cholesky(int n, const double *A, double scale, double shift, double *L)
{
    if (!(scale > 0.0 && scale <= DBL_MAX)) {
        return MATRIX_NOT_POSITIVE;
    }
    for (int j = 0; j < n; ++j) {
        const double *const row = L + j * n;
        const double a = A[j * (n + 1)] / scale + shift, square = a - dot(j, row, row);
        if (!(square > n * DBL_EPSILON * a && a > 0.0)) {
            return MATRIX_NOT_POSITIVE;
        }
        const double root = sqrt(square), reciprocal = 1.0 / root, share = reciprocal / scale;
        L[j * (n + 1)] = root;
        for (int i = j + 1; i < n; ++i) {
            L[i * n + j] = share * A[i * n + j] - reciprocal * dot(j, L + i * n, row);
        }
    }
    return 0;
}

/* Replace x by L^-1 x. */
void solve_forward(int n, const double *L, double *x)
{
    for (int i = 0; i < n; ++i) {
        x[i] = (x[i] - dot(i, L + i * n, x)) / L[i * (n + 1)];
    }
}

/* Replace the n rows of X, `count` numbers each, by those of L^-1 X. */
void solve_rows(int n, int count, const double *L, double *X)
{
    double sums[MAX_ROWS] = {0.0};
    for (int i = 0; i < n; ++i) {
        const double reciprocal = 1.0 / L[i * (n + 1)];
        if (i > 0) {
            multiply_matrices(1, i, count, L + i * n, n, 1, X, sums);
        }
        for (int k = 0; k < count; ++k) {
            X[i * count + k] = (X[i * count + k] - sums[k]) * reciprocal;
        }
    }
}

/* Replace x by L^-T x. */
void solve_backward(int n, const double *L, double *x)
{
    for (int i = n - 1; i >= 0; --i) {
        double sum = x[i];
        for (int k = i + 1; k < n; ++k) {
            sum -= L[k * n + i] * x[k];
        }
        x[i] = sum / L[i * n + i];
    }
}

/* Replace x by (A + shift I)^-1 x, at most MAX_ROWS numbers. Return whether A + shift I is positive definite. */
int solve_damped(int n, const double *A, double shift, double *x)
{
    double L[MAX_ROWS * MAX_ROWS] = {0.0};
    if (factorise_cholesky(n, A, 1.0, shift, L) != 0) {
        return 0;
    }
    solve_forward(n, L, x);
    solve_backward(n, L, x);
    return 1;
}

/*
 * Return whether A (n x n, n <= 6) is finite, symmetric and positive semidefinite, up to a share of its largest entry.
 */
int is_positive_semidefinite(int n, const double *A, double tolerance)
{
    double L[36], scaled[36];
    const double scale = largest_entry(n * n, A);
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j < i; ++j) {
            if (!(fabs(A[i * n + j] - A[j * n + i]) <= tolerance * scale)) {
                return 0;
            }
        }
    }
    if (scale == 0.0 || scale > DBL_MAX) {
        return scale == 0.0;
    }
    for (int i = 0; i < n * n; ++i) {
        scaled[i] = A[i] / scale; /* 1 / scale may overflow */
    }
    /* the factor exists exactly if no eigenvalue of A / scale lies below the shift */
    return factorise_cholesky(n, scaled, 1.0, tolerance, L) == 0;
}

/* Return whether all entries lie between the bounds (both allowed); NaN does not. */
int doubles_within(const double *x, size_t count, double least, double most)
{
    for (size_t i = 0; i < count; ++i) {
        if (!(x[i] >= least && x[i] <= most)) {
            return 0;
        }
    }
    return 1;
}
