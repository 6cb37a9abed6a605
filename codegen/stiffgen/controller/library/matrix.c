/*
 * Vectors and symmetric matrices of the controller: dense, row-major, n x n.
 *
 * A function that can fail returns 0 or a code MATRIX_...; after an error its results are unspecified. Results must
 * overlap neither an argument nor one another, unless a function allows it.
 * Source: G. Golub, C. Van Loan, Matrix Computations: Cholesky reduction (8.7).
 */
#include "impedance.h"

enum { BLOCK = 4 }; /* sums that a loop takes at once */

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
 * Combine rows of n numbers: result_j is the sum of factors_k A_kj over all rows, for the first `count` columns. Four
 * sums at a time stay in registers; the last four may overlap those before.
 */
void combine_rows(int rows, int n, int count, const double *factors, const double *A, double *result)
{
    int j = 0;
    for (; count >= BLOCK && j < count; j += BLOCK) {
        const int first = j + BLOCK <= count ? j : count - BLOCK;
        double a = 0.0, b = 0.0, c = 0.0, d = 0.0;
        for (int k = 0; k < rows; ++k) {
            const double x = factors[k], *const row = A + k * n + first;
            a += x * row[0];
            b += x * row[1];
            c += x * row[2];
            d += x * row[3];
        }
        result[first] = a;
        result[first + 1] = b;
        result[first + 2] = c;
        result[first + 3] = d;
    }
    for (; j < count; ++j) {
        double sum = 0.0;
        for (int k = 0; k < rows; ++k) {
            sum += factors[k] * A[k * n + j];
        }
        result[j] = sum;
    }
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

/* Copy the lower triangle of a matrix to the upper one. */
static void mirror_triangle(int n, double *A)
{
    for (int i = 1; i < n; ++i) {
        for (int j = 0; j < i; ++j) {
            A[j * n + i] = A[i * n + j];
        }
    }
}

/* Compute Y^T diag(d) Y of the rows of Y, n numbers each; one triangle is mirrored. */
void form_congruence(int rows, int n, const double *Y, const double *d, double *result)
{
    for (int i = 0; i < n; ++i) {
        double factors[MAX_ROWS] = {0.0};
        for (int k = 0; k < rows; ++k) {
            factors[k] = d[k] * Y[k * n + i];
        }
        combine_rows(rows, n, i + 1, factors, Y, result + i * n);
    }
    mirror_triangle(n, result);
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
