#include <float.h>
#include <math.h>
#include <stddef.h>

#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__
#error "compile without -ffast-math and -ffinite-math-only: NaN and infinity must be seen"
#endif

enum { MAX_SWEEPS = 40 }; /* 6 to 9 are used up to 32 joints; the bound is what makes the time bounded */

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
        return STIFFGEN_E_NOT_FINITE;
    }
    return is_symmetric(n, A, *scale) ? STIFFGEN_OK : STIFFGEN_E_NOT_SYMMETRIC;
}

static int check_ratio(int n, const double *ratio)
{
    for (int i = 0; i < n; ++i) {
        if (!(ratio[i] >= 0.0 && ratio[i] <= DBL_MAX)) {
            return STIFFGEN_E_DAMPING_RATIO;
        }
    }
    return STIFFGEN_OK;
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

static void transpose(int n, double *A)
{
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j < i; ++j) {
            const double a = A[i * n + j];
            A[i * n + j] = A[j * n + i];
            A[j * n + i] = a;
        }
    }
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
    return rotations == 0 ? STIFFGEN_OK : STIFFGEN_E_NOT_CONVERGED;
}

/* Lower Cholesky factor L of A / scale. */
static int cholesky(int n, const double *A, double scale, double *L)
{
    if (!(scale > 0.0)) {
        return STIFFGEN_E_MASS;
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
                return STIFFGEN_E_MASS;
            }
        }
    }
    return STIFFGEN_OK;
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
    if (error == STIFFGEN_OK) {
        error = check(n, M, scale);
    }
    if (error == STIFFGEN_OK) {
        error = cholesky(n, M, *scale, L);
    }
    if (error != STIFFGEN_OK) {
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
        return STIFFGEN_E_NOT_FINITE;
    }
    error = jacobi(n, C, eigenvalues, rows);
    for (int i = 0; i < n; ++i) {
        eigenvalues[i] *= unit / *scale;
        if (!(fabs(eigenvalues[i]) <= DBL_MAX)) {
            return STIFFGEN_E_NOT_FINITE;
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

static int is_size(int n)
{
    return n >= 1 && n <= STIFFGEN_MAX_DOF;
}

static int stiffgen_eigen_symmetric(int n, const double *A, double *eigenvalues, double *vectors, double *work)
{
    double scale;
    if (!is_size(n)) {
        return STIFFGEN_E_SIZE;
    }
    int error = check(n, A, &scale);
    if (error != STIFFGEN_OK) {
        return error;
    }
    const double unit = scaled_symmetric(n, A, scale, work);
    error = jacobi(n, work, eigenvalues, vectors);
    transpose(n, vectors);
    for (int i = 0; i < n; ++i) {
        eigenvalues[i] *= unit;
    }
    return error;
}

static int stiffgen_eigen_generalised(int n, const double *stiffness, const double *mass, double *eigenvalues,
                               double *vectors, double *work)
{
    double scale;
    double *const L = work, *const C = work + n * n;
    if (!is_size(n)) {
        return STIFFGEN_E_SIZE;
    }
    const int error = pencil(n, stiffness, mass, L, C, eigenvalues, vectors, &scale);
    if (error != STIFFGEN_OK) {
        return error;
    }
    for (int k = 0; k < n; ++k) {
        solve_upper(n, L, vectors + k * n);
        for (int i = 0; i < n; ++i) {
            vectors[k * n + i] /= sqrt(scale);
        }
    }
    transpose(n, vectors);
    return STIFFGEN_OK;
}

static int stiffgen_damping_modal(int n, const double *stiffness, const double *mass, const double *ratio, double *damping,
                           double *eigenvalues, double *work)
{
    double scale, diagonal[STIFFGEN_MAX_DOF];
    double *const L = work, *const C = work + n * n, *const rows = work + 2 * n * n;
    if (!is_size(n)) {
        return STIFFGEN_E_SIZE;
    }
    int error = check_ratio(n, ratio);
    if (error == STIFFGEN_OK) {
        error = pencil(n, stiffness, mass, L, C, eigenvalues, rows, &scale);
    }
    if (error != STIFFGEN_OK) {
        return error;
    }
    times_lower(n, L, rows);
    for (int k = 0; k < n; ++k) {
        diagonal[k] = 2.0 * ratio[k] * sqrt(eigenvalues[k] > 0.0 ? eigenvalues[k] : 0.0) * scale;
    }
    congruence(n, rows, diagonal, damping);
    return largest(n * n, damping) <= DBL_MAX ? STIFFGEN_OK : STIFFGEN_E_NOT_FINITE;
}

/* The symmetric square root of the positive part of A. */
static int square_root(int n, const double *A, double *root, double *smallest, double *C, double *rows)
{
    double scale, values[STIFFGEN_MAX_DOF];
    int error = check(n, A, &scale);
    if (error != STIFFGEN_OK) {
        return error;
    }
    const double unit = scaled_symmetric(n, A, scale, C);
    error = jacobi(n, C, values, rows);
    *smallest = values[0];
    for (int k = 0; k < n; ++k) {
        values[k] = values[k] > 0.0 ? sqrt(values[k]) * sqrt(unit) : 0.0;
    }
    congruence(n, rows, values, root);
    return error;
}

static int stiffgen_damping_factorised(int n, const double *stiffness, const double *mass, const double *ratio,
                                double *damping, double *work)
{
    double smallest;
    double *const roots = work, *const other = work + n * n;
    double *const C = work + 2 * n * n, *const rows = work + 3 * n * n;
    if (!is_size(n)) {
        return STIFFGEN_E_SIZE;
    }
    int error = check_ratio(n, ratio);
    if (error == STIFFGEN_OK) {
        error = square_root(n, mass, roots, &smallest, C, rows);
    }
    if (error == STIFFGEN_OK && !(smallest > n * DBL_EPSILON)) {
        error = STIFFGEN_E_MASS;
    }
    if (error == STIFFGEN_OK) {
        error = square_root(n, stiffness, other, &smallest, C, rows);
    }
    if (error != STIFFGEN_OK) {
        return error;
    }
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j <= i; ++j) {
            double sum = 0.0;
            for (int k = 0; k < n; ++k) {
                sum += ratio[k] * (roots[i * n + k] * other[k * n + j] + other[i * n + k] * roots[k * n + j]);
            }
            damping[i * n + j] = damping[j * n + i] = sum;
        }
    }
    return largest(n * n, damping) <= DBL_MAX ? STIFFGEN_OK : STIFFGEN_E_NOT_FINITE;
}

static int stiffgen_damping_task(int n, const double *jacobian, const double *task_damping, double joint_damping,
                          double *damping)
{
    if (!is_size(n)) {
        return STIFFGEN_E_SIZE;
    }
    for (int j = 0; j < n; ++j) {
        double column[6];
        for (int k = 0; k < 6; ++k) {
            column[k] = 0.0;
            for (int l = 0; l < 6; ++l) {
                column[k] += task_damping[k < l ? 6 * k + l : 6 * l + k] * jacobian[l * n + j];
            }
        }
        for (int i = 0; i <= j; ++i) {
            double sum = i == j ? joint_damping : 0.0;
            for (int k = 0; k < 6; ++k) {
                sum += jacobian[k * n + i] * column[k];
            }
            damping[i * n + j] = damping[j * n + i] = sum;
        }
    }
    return STIFFGEN_OK;
}

static int stiffgen_positive_part(int n, const double *A, const double *metric, double *result, double *eigenvalues,
                           double *work)
{
    double scale = 1.0, diagonal[STIFFGEN_MAX_DOF];
    double *const L = work, *const C = work + n * n, *const rows = work + 2 * n * n;
    int error;
    if (!is_size(n)) {
        return STIFFGEN_E_SIZE;
    }
    if (metric != NULL) {
        error = pencil(n, A, metric, L, C, eigenvalues, rows, &scale);
    } else {
        error = stiffgen_eigen_symmetric(n, A, eigenvalues, rows, C);
        transpose(n, rows);
    }
    if (error != STIFFGEN_OK) {
        return error;
    }
    if (eigenvalues[0] >= 0.0) {
        for (int i = 0; i < n * n; ++i) {
            result[i] = A[i];
        }
        return STIFFGEN_OK;
    }
    if (metric != NULL) {
        times_lower(n, L, rows);
    }
    for (int k = 0; k < n; ++k) {
        diagonal[k] = eigenvalues[k] > 0.0 ? eigenvalues[k] * scale : 0.0;
    }
    congruence(n, rows, diagonal, result);
    return STIFFGEN_OK;
}

static int stiffgen_nullspace_stiffness(int n, const double *jacobian, const double *mass, double k, double threshold,
                                 double *stiffness, double *smallest, double *work)
{
    double scale, A[36], C[36], rows[36], values[6], unit[6];
    double *const L = work, *const projector = work + n * n;
    double P[6 * STIFFGEN_MAX_DOF], Z[6 * STIFFGEN_MAX_DOF];
    if (!is_size(n)) {
        return STIFFGEN_E_SIZE;
    }
    int error = check(n, mass, &scale);
    if (error == STIFFGEN_OK && !(largest(6 * n, jacobian) <= 1e100)) {
        error = STIFFGEN_E_NOT_FINITE;
    }
    if (error == STIFFGEN_OK) {
        error = cholesky(n, mass, scale, L);
    }
    if (error != STIFFGEN_OK) {
        return error;
    }
    for (int r = 0; r < 6; ++r) {
        for (int i = 0; i < n; ++i) {
            Z[r * n + i] = jacobian[r * n + i];
        }
        solve_lower(n, L, Z + r * n, 1);
    }
    for (int r = 0; r < 6; ++r) {
        for (int s = 0; s <= r; ++s) {
            double sum = 0.0;
            for (int i = 0; i < n; ++i) {
                sum += Z[r * n + i] * Z[s * n + i];
            }
            A[6 * r + s] = A[6 * s + r] = sum;
        }
    }
    for (int r = 0; r < 6; ++r) {
        solve_upper(n, L, Z + r * n); /* row r of J M^-1, times the mass scale, which cancels */
    }
    int immovable = 0;
    for (int r = 0; r < 6; ++r) {
        const int first = r < 3 ? 0 : 3;
        double most = 0.0;
        for (int s = first; s < first + 3; ++s) {
            most = A[7 * s] > most ? A[7 * s] : most;
        }
        const int moves = A[7 * r] > 1e-14 * most;
        unit[r] = moves ? 1.0 / sqrt(A[7 * r]) : 0.0;
        immovable += moves ? 0 : 1;
    }
    for (int r = 0; r < 6; ++r) {
        for (int s = 0; s < 6; ++s) {
            C[6 * r + s] = unit[r] * A[6 * r + s] * unit[s];
        }
    }
    error = jacobi(6, C, values, rows);
    if (error != STIFFGEN_OK) {
        return error;
    }
    const int structural = n < 6 ? 6 - n : 0;
    const int first = structural > immovable ? structural : immovable;
    *smallest = first < 6 ? values[first] : 0.0;
    for (int e = 0; e < 6; ++e) {
        const double v = values[e] > 0.0 ? values[e] : 0.0;
        values[e] = v >= threshold ? 1.0 / v : v / (threshold * threshold);
    }
    congruence(6, rows, values, A); /* the damped inverse of C */
    for (int r = 0; r < 6; ++r) {
        for (int i = 0; i < n; ++i) {
            double sum = 0.0;
            for (int s = 0; s < 6; ++s) {
                sum += unit[r] * A[6 * r + s] * unit[s] * Z[s * n + i];
            }
            P[r * n + i] = sum;
        }
    }
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j < n; ++j) {
            double sum = i == j ? 1.0 : 0.0;
            for (int r = 0; r < 6; ++r) {
                sum -= jacobian[r * n + i] * P[r * n + j];
            }
            projector[i * n + j] = sum;
        }
    }
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j <= i; ++j) {
            double sum = 0.0;
            for (int l = 0; l < n; ++l) {
                sum += projector[i * n + l] * projector[j * n + l];
            }
            stiffness[i * n + j] = stiffness[j * n + i] = k * sum;
        }
    }
    return STIFFGEN_OK;
}

static int stiffgen_is_positive_semidefinite6(const double *A)
{
    double L[36];
    const double scale = largest(36, A);
    if (!(scale <= DBL_MAX) || !is_symmetric(6, A, scale)) {
        return 0;
    }
    if (scale == 0.0) {
        return 1;
    }
    /* Cholesky of A / scale + tolerance I exists exactly if no eigenvalue lies below the tolerance. */
    for (int i = 0; i < 6; ++i) {
        for (int j = 0; j <= i; ++j) {
            double sum = A[6 * i + j] / scale + (i == j ? SYMMETRY : 0.0);
            for (int k = 0; k < j; ++k) {
                sum -= L[6 * i + k] * L[6 * j + k];
            }
            if (i > j) {
                L[6 * i + j] = sum / L[7 * j];
            } else if (sum > 0.0) {
                L[7 * i] = sqrt(sum);
            } else {
                return 0;
            }
        }
    }
    return 1;
}
