/*
 * Eigenvalues and eigenvectors of a symmetric matrix.
 *
 * Sources: G. Golub, C. Van Loan, Matrix Computations: Householder and implicit QL (8.3). B. Parlett, The Symmetric
 * Eigenvalue Problem: QL without square roots (8.15). O. Smith, Eigenvalues of a symmetric 3 x 3 matrix, Comm. ACM 4
 * (1961).
 */
#include "impedance.h"

enum { MAX_ITERATIONS = 60 }; /* per eigenvalue: two are usual; the bound makes the time bounded */
/* Square of the entries beside the diagonal of a matrix of size 1 that are 0 up to rounding. */
static const double NEGLIGIBLE = 0.25 * DBL_EPSILON * DBL_EPSILON;
/* Norm of a matrix that counts as 0, and square of entries, of a matrix of size 1, that are not reflected: with both,
 * no quotient overflows. */
static const double LEAST_SIZE = 1e-100, LEAST_SQUARE = 1e-100;

/*
 * Reflect the block of A from row and column k + 1 on, so that row k has zeros behind `beside`, and A stays symmetric:
 * A - v w^T - w v^T. Row k of A becomes v from entry k + 1 on. Return beta of the reflection I - beta v v^T, or 0 for
 * none: the squares of the entries behind `beside` sum up to no more than `least`.
 */
static double reflect_behind(int n, int k, double least, double *A, double *beside)
{
    const int first = k + 1, count = n - first;
    double *const v = A + k * n + first;
    double w[MAX_ROWS] = {0.0};
    const double below = dot(count - 1, v + 1, v + 1);
    *beside = v[0];
    if (!(below > least)) {
        return 0.0;
    }
    const double size = sqrt(v[0] * v[0] + below);
    *beside = v[0] > 0.0 ? -size : size;
    v[0] -= *beside;
    const double beta = 2.0 / (v[0] * v[0] + below);
    for (int i = 0; i < count; ++i) {
        w[i] = beta * dot(count, A + (first + i) * n + first, v);
    }
    add_scaled(count, -0.5 * beta * dot(count, v, w), v, w);
    for (int i = 0; i < count; ++i) {
        double *const row = A + (first + i) * n + first;
        for (int j = 0; j < count; ++j) {
            row[j] -= v[i] * w[j] + w[i] * v[j];
        }
    }
    return beta;
}

/*
 * Reduce A (destroyed) to a tridiagonal matrix by Householder reflections: its diagonal, and the squares of the entries
 * beside it, which count as positive; both for A over its norm `size`. rows becomes Q^T; NULL for none.
 */
static void tridiagonalise(int n, double *A, double size, double *diagonal, double *squares, double *rows)
{
    const double scale = 1.0 / size, least = LEAST_SQUARE * size * size;
    double beta[MAX_ROWS] = {0.0}, beside[MAX_ROWS] = {0.0}, sign = 1.0;
    for (int k = 0; k < n - 2; ++k) {
        beta[k] = reflect_behind(n, k, least, A, beside + k);
    }
    if (n > 1) {
        beside[n - 2] = A[(n - 1) * n - 1];
    }
    for (int i = 0; i < n; ++i) {
        diagonal[i] = scale * A[i * n + i];
        squares[i] = scale * beside[i] * (scale * beside[i]);
    }
    if (rows == NULL) {
        return;
    }
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j < n; ++j) {
            rows[i * n + j] = i == j ? 1.0 : 0.0;
        }
    }
    /* from the last reflection on, whose block of rows is the smallest */
    for (int k = n - 3; k >= 0; --k) {
        const double *const v = A + k * n;
        for (int i = k + 1; i < n && beta[k] > 0.0; ++i) {
            double *const row = rows + i * n + k + 1;
            add_scaled(n - k - 1, -beta[k] * dot(n - k - 1, row, v + k + 1), v + k + 1, row);
        }
    }
    for (int i = 1; i < n; ++i) { /* turn rows round, so that all entries beside the diagonal are positive */
        sign = beside[i - 1] < 0.0 ? -sign : sign;
        for (int j = 0; j < n; ++j) {
            rows[i * n + j] *= sign;
        }
    }
}

/* Rotate a row and the next one: the first becomes c x - s y, the second s x + c y. */
static void rotate_rows(int n, double c, double s, double *row)
{
    double *const next = row + n;
    for (int k = 0; k < n; ++k) {
        const double x = row[k], y = next[k];
        row[k] = c * x - s * y;
        next[k] = s * x + c * y;
    }
}

/* Swap two arrays. */
static void swap(int count, double *x, double *y)
{
    for (int k = 0; k < count; ++k) {
        const double value = x[k];
        x[k] = y[k];
        y[k] = value;
    }
}

/* Sort eigenvalues and their rows (NULL for none), ascending. */
void sort_eigenpairs(int n, double *d, double *rows)
{
    for (int i = 1; i < n; ++i) {
        for (int j = i; j >= 1 && d[j] < d[j - 1]; --j) {
            swap(1, d + j - 1, d + j);
            if (rows != NULL) {
                swap(n, rows + (j - 1) * n, rows + j * n);
            }
        }
    }
}

/* Return Wilkinson's shift: the eigenvalue of the block (a, b; b, d) that is nearer to a, from the square of b. */
static double find_shift(double a, double d, double square)
{
    const double half = 0.5 * (d - a), root = sqrt(half * half + square);
    return half < 0.0 ? a + (half + root) : a + (half - root);
}

/*
 * Do one sweep of implicit QL on the block l ... m of a tridiagonal matrix whose norm is 1: its diagonal d and the
 * squares e of the entries beside it. A rotation needs the squares of cosine and sine of the last one alone, and no
 * root.
 */
static void sweep_block(int n, int l, int m, double *d, double *e, double *rows)
{
    const double shift = find_shift(d[l], d[l + 1], e[l]);
    double gamma = d[m] - shift, p = gamma * gamma, cosine = 1.0, sine = 0.0, sign = 1.0;
    for (int i = m - 1; i >= l; --i) {
        const double square = e[i], r = p + square, before = gamma;
        e[i + 1] = sine * r;
        if (p > NEGLIGIBLE) {
            const double product = p * (d[i] - shift) - square * gamma;
            gamma = product / r;
            cosine = p / r;
            sine = square / r;
            p = product * product / (r * p);
            d[i + 1] = before + (d[i] - gamma);
            sign = before < 0.0 ? -sign : sign;
        } else { /* a right angle, up to rounding */
            p = cosine * square;
            gamma = cosine = 0.0;
            sine = 1.0;
            d[i + 1] = d[i];
            sign = -sign;
        }
        if (rows != NULL) {
            rotate_rows(n, sign * sqrt(cosine), sqrt(sine), rows + i * n);
        }
    }
    e[l] = sine * p;
    d[l] = shift + gamma;
    for (int k = 0; rows != NULL && gamma * sign < 0.0 && k < n; ++k) {
        rows[l * n + k] = -rows[l * n + k]; /* the entries beside the diagonal stay positive */
    }
}

/*
 * Compute eigenvalues (ascending) and eigenvectors (the ROWS of `rows`; NULL for none) of a symmetric A (destroyed):
 * implicit QL in the variant of Pal, Walker and Kahan.
 */
int diagonalise_symmetric(int n, double *A, double *d, double *rows)
{
    double e[MAX_ROWS], size = norm(n * n, A);
    if (!(size > LEAST_SIZE)) {
        memset(A, 0, (size_t)(n * n) * sizeof(double));
        size = 1.0;
    }
    tridiagonalise(n, A, size, d, e, rows);
    for (int l = 0; l < n; ++l) {
        for (int iteration = 0;; ++iteration) {
            int m = l;
            while (m < n - 1 && e[m] > NEGLIGIBLE) {
                ++m;
            }
            if (m == l) {
                break;
            }
            if (iteration == MAX_ITERATIONS) {
                return MATRIX_NOT_CONVERGED;
            }
            sweep_block(n, l, m, d, e, rows);
        }
        d[l] *= size;
    }
    sort_eigenpairs(n, d, rows);
    return 0;
}

/* Compute the adjugate of a symmetric matrix (3 x 3). */
static void compute_adjugate(const double *A, double *adjugate)
{
    for (int i = 0; i < 3; ++i) {
        const double *const x = A + (i + 1) % 3 * 3, *const y = A + (i + 2) % 3 * 3;
        adjugate[3 * i] = x[1] * y[2] - x[2] * y[1];
        adjugate[3 * i + 1] = x[2] * y[0] - x[0] * y[2];
        adjugate[3 * i + 2] = x[0] * y[1] - x[1] * y[0];
    }
}

/* Return the largest root of t^3 - 3 t = 2 r, r from 0 to 1: Newton's method, whose error is 1.4e-2 at the start. */
static double find_largest_root(double r)
{
    double t = 1.7320508075688773 + 0.2679491924311227 * r;
    for (int round = 0; round < 3; ++round) {
        t = (2.0 * t * t * t + 2.0 * r) / (3.0 * t * t - 3.0);
    }
    return t;
}

/*
 * Return the largest eigenvalue of a symmetric A (3 x 3). B = (A - mean I) / size has eigenvalues t with t^3 - 3 t =
 * det B. One of the outer two is well apart from the others, and the polynomial is good for that one alone. If it is
 * the smallest, -t, the projection on its eigenvector is that of the adjugate of B + t I; what B is on the other two,
 * less their mean t / 2, has opposite eigenvalues, which come from its norm without cancellation.
 */
double find_largest_eigenvalue(const double *A)
{
    const double mean = (A[0] + A[4] + A[8]) / 3.0;
    double B[9], adjugate[9];
    for (int k = 0; k < 9; ++k) {
        B[k] = k % 4 == 0 ? A[k] - mean : A[k];
    }
    const double size = sqrt(dot(9, B, B) / 6.0);
    if (!(size > 0.0)) {
        return mean;
    }
    const double inverse = 1.0 / size;
    for (int k = 0; k < 9; ++k) {
        B[k] *= inverse;
    }
    compute_adjugate(B, adjugate);
    const double half = 0.5 * dot(3, B, adjugate), t = find_largest_root(smaller(fabs(half), 1.0));
    if (half >= 0.0) {
        return mean + size * t;
    }
    for (int k = 0; k < 9; k += 4) {
        B[k] += t;
    }
    compute_adjugate(B, adjugate);
    const double projected = 1.5 * t / (adjugate[0] + adjugate[4] + adjugate[8]);
    for (int k = 0; k < 9; ++k) {
        B[k] += projected * adjugate[k] - (k % 4 == 0 ? 1.5 * t : 0.0);
    }
    return mean + size * (0.5 * t + sqrt(0.5 * dot(9, B, B)));
}
