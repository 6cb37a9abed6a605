/*
 * Vectors and symmetric matrices of the controller: dense, row-major, n x n.
 *
 * A function that can fail returns 0 or a code MATRIX_...; after an error its results are unspecified. Results must
 * overlap neither an argument nor one another.
 * Source: G. Golub, C. Van Loan, Matrix Computations: Cholesky reduction (8.7), Householder and implicit QL (8.3).
 */
#include "impedance.h"

enum { MAX_ITERATIONS = 60 }; /* per eigenvalue: two are usual; the bound makes the time bounded */

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
    for (int i = 0; i < count; ++i) {
        sum += a[i] * b[i];
    }
    return sum;
}

double norm(int count, const double *x)
{
    return sqrt(dot(count, x, x));
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

/* Compute Y diag(d) Y^T from the columns of Y, stored as rows; one triangle is computed and mirrored. */
void form_congruence(int n, const double *rows, const double *d, double *result)
{
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j <= i; ++j) {
            double sum = 0.0;
            for (int k = 0; k < n; ++k) {
                sum += d[k] * rows[k * n + i] * rows[k * n + j];
            }
            result[i * n + j] = result[j * n + i] = sum;
        }
    }
}

/*
 * Reflect X in place: X - beta v (v^T X), or X - beta (X v) v^T if the strides row and column are exchanged. Entries of
 * v before `first` count as 0.
 */
static void reflect(int n, int first, double beta, const double *v, double *X, int row, int column)
{
    double p[MAX_ROWS] = {0.0};
    for (int i = first; i < n; ++i) {
        for (int j = 0; j < n; ++j) {
            p[j] += beta * v[i] * X[i * row + j * column];
        }
    }
    for (int i = first; i < n; ++i) {
        for (int j = 0; j < n; ++j) {
            X[i * row + j * column] -= v[i] * p[j];
        }
    }
}

/* Reduce A (destroyed) to the tridiagonal matrix (diagonal, beside) by Householder reflections; rows becomes Q^T. */
static void tridiagonalise(int n, double *A, double *diagonal, double *beside, double *rows)
{
    double v[MAX_ROWS] = {0.0};
    for (int i = 0; i < n * n; ++i) {
        rows[i] = i % (n + 1) == 0 ? 1.0 : 0.0;
    }
    for (int k = 0; k < n - 2; ++k) {
        double below = 0.0;
        for (int i = k + 1; i < n; ++i) {
            v[i] = A[k * n + i];
            below += i > k + 1 ? v[i] * v[i] : 0.0;
        }
        if (below > 0.0) {
            const double size = sqrt(v[k + 1] * v[k + 1] + below);
            v[k + 1] += v[k + 1] > 0.0 ? size : -size;
            const double beta = 2.0 / (v[k + 1] * v[k + 1] + below);
            reflect(n, k + 1, beta, v, A, n, 1);
            reflect(n, k + 1, beta, v, A, 1, n);
            reflect(n, k + 1, beta, v, rows, n, 1);
        }
    }
    for (int i = 0; i < n; ++i) {
        diagonal[i] = A[i * n + i];
        beside[i] = i < n - 1 ? A[i * n + i + 1] : 0.0;
    }
}

/* Sort eigenvalues and their rows, ascending. */
static void sort_eigenpairs(int n, double *d, double *rows)
{
    for (int i = 0; i < n - 1; ++i) {
        int least = i;
        for (int j = i + 1; j < n; ++j) {
            least = d[j] < d[least] ? j : least;
        }
        if (least != i) {
            const double value = d[i];
            d[i] = d[least];
            d[least] = value;
            for (int k = 0; k < n; ++k) {
                const double x = rows[i * n + k];
                rows[i * n + k] = rows[least * n + k];
                rows[least * n + k] = x;
            }
        }
    }
}

/* Compute eigenvalues (ascending) and eigenvectors (the ROWS of `rows`) of a symmetric A (destroyed): implicit QL. */
int diagonalise_symmetric(int n, double *A, double *d, double *rows)
{
    double e[MAX_ROWS], size = 0.0;
    for (int i = 0; i < n * n; ++i) {
        size += A[i] * A[i];
    }
    const double negligible = 0.25 * DBL_EPSILON * sqrt(size) / n;
    tridiagonalise(n, A, d, e, rows);
    for (int l = 0; l < n; ++l) {
        for (int iteration = 0;; ++iteration) {
            int m = l;
            while (m < n - 1 && fabs(e[m]) > negligible) {
                ++m;
            }
            if (m == l) {
                break;
            }
            if (iteration == MAX_ITERATIONS) {
                return MATRIX_NOT_CONVERGED;
            }
            /* Wilkinson's shift, then a chase from m up to l */
            const double half = 0.5 * (d[l + 1] - d[l]) / e[l], root = sqrt(half * half + 1.0);
            double g = d[m] - d[l] + e[l] / (half < 0.0 ? half - root : half + root);
            double s = 1.0, c = 1.0, p = 0.0;
            int i = m - 1;
            for (; i >= l; --i) {
                const double f = s * e[i], b = c * e[i], r = sqrt(f * f + g * g);
                e[i + 1] = r;
                if (r == 0.0) {
                    d[i + 1] -= p;
                    break;
                }
                s = f / r;
                c = g / r;
                g = d[i + 1] - p;
                const double t = (d[i] - g) * s + 2.0 * c * b;
                p = s * t;
                d[i + 1] = g + p;
                g = c * t - b;
                double *const low = rows + i * n, *const high = low + n;
                for (int k = 0; k < n; ++k) {
                    const double x = low[k], y = high[k];
                    low[k] = c * x - s * y;
                    high[k] = s * x + c * y;
                }
            }
            if (i < l) {
                d[l] -= p;
                e[l] = g;
            }
            e[m] = 0.0;
        }
    }
    sort_eigenpairs(n, d, rows);
    return 0;
}

/* Compute the lower Cholesky factor L of A / scale + shift I. */
int factorise_cholesky(int n, const double *A, double scale, double shift, double *L)
{
    if (!(scale > 0.0 && scale <= DBL_MAX)) {
        return MATRIX_NOT_POSITIVE;
    }
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j <= i; ++j) {
            const double a = A[i * n + j] / scale + (i == j ? shift : 0.0);
            double sum = a;
            for (int k = 0; k < j; ++k) {
                sum -= L[i * n + k] * L[j * n + k];
            }
            if (i > j) {
                L[i * n + j] = sum / L[j * n + j];
            } else if (sum > n * DBL_EPSILON * a && a > 0.0) {
                L[i * n + i] = sqrt(sum);
            } else {
                return MATRIX_NOT_POSITIVE;
            }
        }
    }
    return 0;
}

/* Replace X, a matrix with the given number of columns, by L^-1 X. */
void solve_lower(int n, int columns, const double *L, double *X)
{
    for (int i = 0; i < n; ++i) {
        double *const row = X + i * columns;
        const double inverse = 1.0 / L[i * (n + 1)];
        for (int k = 0; k < i; ++k) {
            for (int j = 0; j < columns; ++j) {
                row[j] -= L[i * n + k] * X[k * columns + j];
            }
        }
        for (int j = 0; j < columns; ++j) {
            row[j] *= inverse;
        }
    }
}

/* Replace x by L^-T x. */
void solve_upper(int n, const double *L, double *x)
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
 * Solve K v = lambda M v for the symmetric parts of K and M. Results: L with L L^T = M / *scale, the eigenvalues lambda
 * (ascending), and rows w with v = L^-T w. C is work space.
 */
int solve_pencil(int n, const double *K, const double *M, double *L, double *C, double *eigenvalues, double *rows,
                  double *scale)
{
    *scale = largest_entry(n * n, M);
    int error = factorise_cholesky(n, M, *scale, 0.0, L);
    if (error != 0) {
        return error;
    }
    memcpy(rows, K, (size_t)(n * n) * sizeof(double));
    solve_lower(n, n, L, rows);
    for (int k = 0; k < n * n; ++k) {
        C[k] = rows[k % n * n + k / n];
    }
    solve_lower(n, n, L, C);
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j <= i; ++j) {
            C[i * n + j] = C[j * n + i] = (C[i * n + j] + C[j * n + i]) / 2.0;
        }
    }
    if (!(largest_entry(n * n, C) <= 1e140)) {
        return MATRIX_NOT_FINITE;
    }
    error = diagonalise_symmetric(n, C, eigenvalues, rows);
    for (int i = 0; i < n; ++i) {
        eigenvalues[i] /= *scale;
    }
    return error;
}

/* Replace each row w by L w: the rows become the columns of M V / sqrt(scale). */
void multiply_lower(int n, const double *L, double *rows)
{
    for (int k = 0; k < n; ++k) {
        double *const w = rows + k * n;
        for (int i = n - 1; i >= 0; --i) {
            double sum = 0.0;
            for (int j = 0; j <= i; ++j) {
                sum += L[i * n + j] * w[j];
            }
            w[i] = sum;
        }
    }
}

/*
 * Move K (3 x 3) by a share of the difference D = wanted - K, without the part of D that stiffens. That part is the
 * result `cost`. It has the positive eigenvalues of D with respect to S = wanted + K: D V = S V diag(l), V^T S V = I,
 * cost = share S V diag(max(l, 0)) V^T S. A difference below 1e-9 of the trace of S is covered in one step. Return
 * whether K differed from wanted.
 */
int soften(const double *wanted, double share, double *K, double *cost)
{
    double D[9], S[9], L[9], C[9], rows[9], values[3], scale, size = 0.0;
    for (int k = 0; k < 9; ++k) {
        D[k] = wanted[k] - K[k];
        S[k] = wanted[k] + K[k];
        size += fabs(D[k]);
        cost[k] = 0.0;
    }
    const double trace = S[0] + S[4] + S[8], part = size <= 1e-9 * trace ? 1.0 : share;
    for (int k = 0; k < 9; k += 4) {
        S[k] += 1e-10 * trace; /* directions without stiffness before and after */
    }
    if (size == 0.0 || solve_pencil(3, D, S, L, C, values, rows, &scale) != 0) {
        return 0;
    }
    multiply_lower(3, L, rows);
    for (int k = 0; k < 3; ++k) {
        values[k] = part * fmax(values[k], 0.0) * scale;
    }
    form_congruence(3, rows, values, cost);
    for (int k = 0; k < 9; ++k) {
        K[k] += part * D[k] - cost[k];
    }
    return 1;
}

/*
 * Return whether A (n x n, n <= 6) is finite, symmetric and positive semidefinite, up to a share of its largest entry.
 */
int is_positive_semidefinite(int n, const double *A, double tolerance)
{
    double L[36];
    const double scale = largest_entry(n * n, A);
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j < i; ++j) {
            if (!(fabs(A[i * n + j] - A[j * n + i]) <= tolerance * scale)) {
                return 0;
            }
        }
    }
    /* the factor exists exactly if no eigenvalue of A / scale lies below the shift */
    return scale == 0.0 || factorise_cholesky(n, A, scale, tolerance, L) == 0;
}
