/*
 * Symmetric matrices of a controller: dense, row-major, n x n. Every robot's NAME_impedance.c has its own static copy.
 *
 * Allocation-free, reentrant, deterministic, bounded time. A function that can fail returns 0 or why not; after an error
 * its results are unspecified. Results must overlap neither an argument nor one another.
 * Source: G. Golub, C. Van Loan, Matrix Computations: Cholesky reduction (8.7), cyclic Jacobi (8.5).
 */
enum { MATRIX_NOT_FINITE = 1, MATRIX_NOT_SYMMETRIC, MATRIX_NOT_POSITIVE, MATRIX_NOT_CONVERGED };

enum { MAX_SWEEPS = 40 }; /* 6 to 9 are used up to 40 joints; the bound is what makes the time bounded */

static const double SYMMETRY = 1e-9;

/* The largest absolute entry, or infinity if an entry is NaN or infinite. */
static double largest(int count, const double *A)
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

static int is_symmetric(int n, const double *A, double scale)
{
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j < i; ++j) {
            if (!(fabs(A[i * n + j] - A[j * n + i]) <= SYMMETRY * scale)) {
                return 0;
            }
        }
    }
    return 1;
}

static int check(int n, const double *A, double *scale)
{
    *scale = largest(n * n, A);
    if (!(*scale <= DBL_MAX)) {
        return MATRIX_NOT_FINITE;
    }
    return is_symmetric(n, A, *scale) ? 0 : MATRIX_NOT_SYMMETRIC;
}

/* Symmetric part of A over its size, or over 1 if that is 0; returns which. */
static double scaled_symmetric(int n, const double *A, double size, double *result)
{
    const double unit = size > 0.0 ? size : 1.0;
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j < n; ++j) {
            result[i * n + j] = (A[i * n + j] / unit + A[j * n + i] / unit) / 2.0;
        }
    }
    return unit;
}

/* result = Y diag(d) Y^T, Y with its columns as rows; one triangle computed and mirrored. */
static void congruence(int n, const double *rows, const double *d, double *result)
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

/* Cyclic Jacobi on A (destroyed), entries of order one: eigenvalues ascending, eigenvectors as ROWS of rows. */
static int jacobi(int n, double *A, double *eigenvalues, double *rows)
{
    double norm = 0.0;
    int rotations = 1;
    for (int i = 0; i < n * n; ++i) {
        norm += A[i] * A[i];
        rows[i] = 0.0;
    }
    for (int i = 0; i < n; ++i) {
        rows[i * n + i] = 1.0;
    }
    const double negligible = 0.5 * DBL_EPSILON * sqrt(norm) / n;
    for (int sweep = 0; sweep < MAX_SWEEPS && rotations > 0; ++sweep) {
        rotations = 0;
        for (int p = 0; p < n - 1; ++p) {
            for (int q = p + 1; q < n; ++q) {
                double *const Ap = A + p * n, *const Aq = A + q * n;
                const double apq = Ap[q];
                if (!(fabs(apq) > negligible)) {
                    continue;
                }
                ++rotations;
                const double theta = 0.5 * (Aq[q] - Ap[p]) / apq;
                const double t = (theta < 0.0 ? -1.0 : 1.0) / (fabs(theta) + sqrt(1.0 + theta * theta));
                const double c = 1.0 / sqrt(1.0 + t * t);
                const double s = t * c;
                const double app = Ap[p] - t * apq, aqq = Aq[q] + t * apq;
                for (int k = 0; k < n; ++k) {
                    const double x = Ap[k], y = Aq[k];
                    Ap[k] = c * x - s * y;
                    Aq[k] = s * x + c * y;
                }
                Ap[p] = app;
                Aq[q] = aqq;
                Ap[q] = Aq[p] = 0.0;
                for (int k = 0; k < n; ++k) {
                    A[k * n + p] = Ap[k];
                    A[k * n + q] = Aq[k];
                }
                double *const Vp = rows + p * n, *const Vq = rows + q * n;
                for (int k = 0; k < n; ++k) {
                    const double x = Vp[k], y = Vq[k];
                    Vp[k] = c * x - s * y;
                    Vq[k] = s * x + c * y;
                }
            }
        }
    }
    for (int i = 0; i < n; ++i) {
        eigenvalues[i] = A[i * n + i];
    }
    for (int i = 0; i < n - 1; ++i) {
        int least = i;
        for (int j = i + 1; j < n; ++j) {
            least = eigenvalues[j] < eigenvalues[least] ? j : least;
        }
        if (least != i) {
            const double value = eigenvalues[i];
            eigenvalues[i] = eigenvalues[least];
            eigenvalues[least] = value;
            for (int k = 0; k < n; ++k) {
                const double x = rows[i * n + k];
                rows[i * n + k] = rows[least * n + k];
                rows[least * n + k] = x;
            }
        }
    }
    return rotations == 0 ? 0 : MATRIX_NOT_CONVERGED;
}

/* Lower Cholesky factor L of A / scale. */
static int cholesky(int n, const double *A, double scale, double *L)
{
    if (!(scale > 0.0)) {
        return MATRIX_NOT_POSITIVE;
    }
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j <= i; ++j) {
            const double a = A[i * n + j] / scale;
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

/* x <- L^-1 x, for the column x[0], x[stride], ... */
static void solve_lower(int n, const double *L, double *x, int stride)
{
    for (int i = 0; i < n; ++i) {
        double sum = x[i * stride];
        for (int k = 0; k < i; ++k) {
            sum -= L[i * n + k] * x[k * stride];
        }
        x[i * stride] = sum / L[i * n + i];
    }
}

/* x <- L^-T x. */
static void solve_upper(int n, const double *L, double *x)
{
    for (int i = n - 1; i >= 0; --i) {
        double sum = x[i];
        for (int k = i + 1; k < n; ++k) {
            sum -= L[k * n + i] * x[k];
        }
        x[i] = sum / L[i * n + i];
    }
}

/* K = scale_K scale_M-scaled pencil: L with L L^T = M / *scale, eigenvalues lambda, W^T as rows with V = L^-T W. */
static int pencil(int n, const double *K, const double *M, double *L, double *C, double *eigenvalues, double *rows,
                  double *scale)
{
    double size;
    int error = check(n, K, &size);
    if (error == 0) {
        error = check(n, M, scale);
    }
    if (error == 0) {
        error = cholesky(n, M, *scale, L);
    }
    if (error != 0) {
        return error;
    }
    const double unit = scaled_symmetric(n, K, size, C);
    for (int j = 0; j < n; ++j) {
        solve_lower(n, L, C + j, n);
    }
    for (int i = 0; i < n; ++i) {
        solve_lower(n, L, C + i * n, 1);
    }
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j < i; ++j) {
            C[i * n + j] = C[j * n + i] = (C[i * n + j] + C[j * n + i]) / 2.0;
        }
    }
    if (!(largest(n * n, C) <= 1e140)) {
        return MATRIX_NOT_FINITE;
    }
    error = jacobi(n, C, eigenvalues, rows);
    for (int i = 0; i < n; ++i) {
        eigenvalues[i] *= unit / *scale;
        if (!(fabs(eigenvalues[i]) <= DBL_MAX)) {
            return MATRIX_NOT_FINITE;
        }
    }
    return error;
}

/* Rows w_k -> rows L w_k: the columns of M V over sqrt(scale). */
static void times_lower(int n, const double *L, double *rows)
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
 * The part of a symmetric D with positive eigenvalues against a metric S: D V = S V diag(l), V^T S V = I, result
 * S V diag(max(l, 0)) V^T S. largest_eigenvalue: of the pencil. work: 3 n n doubles.
 */
static int positive_part(int n, const double *D, const double *S, double *result, double *work)
{
    double scale, values[MAX_ROWS];
    double *const L = work, *const C = work + n * n, *const rows = work + 2 * n * n;
    const int error = pencil(n, D, S, L, C, values, rows, &scale);
    if (error != 0) {
        return error;
    }
    times_lower(n, L, rows);
    for (int k = 0; k < n; ++k) {
        values[k] = values[k] > 0.0 ? values[k] * scale : 0.0;
    }
    congruence(n, rows, values, result);
    return 0;
}

/* Whether A (n x n, n at most 6) is finite, symmetric to 1e-9 of its largest entry, and positive semidefinite to the same. */
static int is_positive_semidefinite(int n, const double *A)
{
    double L[36];
    const double scale = largest(n * n, A);
    if (!(scale <= DBL_MAX) || !is_symmetric(n, A, scale)) {
        return 0;
    }
    if (scale == 0.0) {
        return 1;
    }
    /* Cholesky of A / scale + tolerance I exists exactly if no eigenvalue lies below the tolerance. */
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j <= i; ++j) {
            double sum = A[n * i + j] / scale + (i == j ? SYMMETRY : 0.0);
            for (int k = 0; k < j; ++k) {
                sum -= L[n * i + k] * L[n * j + k];
            }
            if (i > j) {
                L[n * i + j] = sum / L[(n + 1) * j];
            } else if (sum > 0.0) {
                L[(n + 1) * i] = sqrt(sum);
            } else {
                return 0;
            }
        }
    }
    return 1;
}
