/*
 * Modes of two symmetric matrices, K v = lambda M v, and what the controller makes of them.
 *
 * Source: T. Ogita, K. Aishima, Iterative refinement for symmetric eigenvalue decomposition, Japan J.
 * Indust. Appl. Math. 35 (2018).
 */
#include "impedance.h"

/* Largest entry of a matrix to diagonalise, whose squares and their sums are finite; stiffness, over the trace, that a
 * direction without any before and after a change counts with: S stays positive definite. */
static const double LARGEST_ENTRY = 1e140, UNCHANGED = 1e-10;
enum { REFINEMENTS = 4 }; /* rounds of refine_modes */
/* Changes above which refine_modes gives up, in the first round and over the round before; the change whose square is 0
 * up to rounding. */
static const double LARGEST_CHANGE = 0.05, LARGEST_SHARE = 0.2, LAST_CHANGE = 5e-8;
static const double LEAST_DIVISOR = 1e-100; /* nothing is divided by less: quotients and their squares stay finite */

/* Invert a lower triangular matrix; the entries above the diagonal become 0. */
static void invert_triangle(int n, const double *L, double *inverse)
{
    memset(inverse, 0, (size_t)(n * n) * sizeof(double));
    for (int i = 0; i < n; ++i) {
        double *const row = inverse + i * n;
        const double reciprocal = 1.0 / L[i * (n + 1)];
        for (int k = 0; k < i; ++k) {
            add_scaled(k + 1, -reciprocal * L[i * n + k], inverse + k * n, row);
        }
        row[i] = reciprocal;
    }
}

/* Factorise the M of a pencil: L with L L^T = M / *scale, and its inverse. */
static int factorise_pencil(int n, const double *M, double *L, double *inverse, double *scale)
{
    *scale = largest_diagonal(n, M);
    const int error = factorise_cholesky(n, M, *scale, 0.0, L);
    if (error == 0) {
        invert_triangle(n, L, inverse);
    }
    return error;
}

/* Compute the symmetric part of a matrix. */
void take_symmetric_part(int n, const double *K, double *result)
{
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j <= i; ++j) {
            result[i * n + j] = result[j * n + i] = 0.5 * (K[i * n + j] + K[j * n + i]);
        }
    }
}

/*
 * Solve K v = lambda M v for the symmetric part of K and M = scale L L^T, from the inverse of L. Results: the
 * eigenvalues lambda (ascending), and rows w with v = L^-T w, which may overwrite the inverse. C is work space.
 */
static int diagonalise_pencil(int n, const double *K, double scale, const double *inverse, double *C,
                              double *eigenvalues, double *rows)
{
    take_symmetric_part(n, K, C);
    /* L^-1 C L^-T from the last row on: a row depends on the rows before it, and on no column behind its diagonal */
    for (int i = n - 1; i >= 0; --i) {
        double product[MAX_ROWS] = {0.0};
        for (int k = 0; k <= i; ++k) {
            add_scaled(i + 1, inverse[i * n + k], C + k * n, product);
        }
        for (int j = 0; j <= i; ++j) {
            C[i * n + j] = C[j * n + i] = dot(j + 1, product, inverse + j * n);
        }
    }
    if (!(largest_entry(n * n, C) <= LARGEST_ENTRY)) {
        return MATRIX_NOT_FINITE;
    }
    const int error = diagonalise_symmetric(n, C, eigenvalues, rows);
    for (int i = 0; i < n; ++i) {
        eigenvalues[i] /= scale;
    }
    return error;
}

/*
 * Solve K v = lambda M v for the symmetric part of K. Results: L with L L^T = M / *scale, the eigenvalues lambda
 * (ascending), and rows w with v = L^-T w. C is work space.
 */
int solve_pencil(int n, const double *K, const double *M, double *L, double *C, double *eigenvalues, double *rows,
                 double *scale)
{
    const int error = factorise_pencil(n, M, L, rows, scale);
    return error != 0 ? error : diagonalise_pencil(n, K, *scale, rows, C, eigenvalues, rows);
}

/*
 * Compute the modes of K v = lambda M v, for the symmetric part of K: the eigenvalues lambda (ascending), and rows v
 * with v . M v = 1. work: 2 n^2 numbers.
 */
int solve_modes(int n, const double *K, const double *M, double *work, double *eigenvalues, double *modes)
{
    double *const C = work, *const inverse = work + n * n, scale;
    int error = factorise_pencil(n, M, C, inverse, &scale);
    if (error == 0) {
        error = diagonalise_pencil(n, K, scale, inverse, C, eigenvalues, modes);
    }
    if (error == 0) { /* v = L^-T w, of length 1 with respect to M = scale L L^T */
        for (int k = 0; k < n * n; ++k) {
            inverse[k] /= sqrt(scale);
        }
        multiply_rows(n, modes, inverse, C);
        memcpy(modes, C, (size_t)(n * n) * sizeof(double));
    }
    return error;
}

/*
 * Compute the changes of modes that nearly solve K v = lambda M v: mode i changes by the sum of changes[i][j] v_j. With
 * S = v_i . K v_j and R = -v_i . M v_j the change is (S + lambda_i R) / (lambda_i - lambda_j), and (1 - v . M v) / 2
 * along the mode itself: S and R then vanish to first order. products is work space. Return 0 where a mode is 0, as
 * before the first design, or two eigenvalues are equal: then there are no changes.
 */
static int compare_modes(int n, const double *K, const double *M, const double *modes, double *products,
                         double *eigenvalues, double *changes)
{
    multiply_rows(n, modes, K, products);
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j <= i; ++j) {
            changes[i * n + j] = dot(n, products + i * n, modes + j * n);
        }
    }
    multiply_rows(n, modes, M, products);
    for (int i = 0; i < n; ++i) {
        const double square = dot(n, products + i * n, modes + i * n);
        if (!(square > LEAST_DIVISOR)) {
            return 0;
        }
        eigenvalues[i] = changes[i * (n + 1)] / square; /* v . K v / v . M v; those before i are known below */
        changes[i * (n + 1)] = 0.5 * (1.0 - square);
        for (int j = 0; j < i; ++j) {
            const double S = changes[i * n + j], R = -dot(n, products + i * n, modes + j * n);
            const double gap = eigenvalues[i] - eigenvalues[j];
            if (!(fabs(gap) > LEAST_DIVISOR)) {
                return 0;
            }
            const double reciprocal = 1.0 / gap;
            changes[i * n + j] = (S + eigenvalues[i] * R) * reciprocal;
            changes[j * n + i] = -(S + eigenvalues[j] * R) * reciprocal;
        }
    }
    return 1;
}

/*
 * Refine modes that nearly solve K v = lambda M v, for symmetric matrices. Each round squares the error, unless two
 * eigenvalues are close (Ogita and Aishima 2018, for a pencil). work: 2 n^2 numbers. Return whether the modes are those
 * of solve_modes up to rounding and signs; else they are unspecified.
 */
int refine_modes(int n, const double *K, const double *M, double *work, double *eigenvalues, double *modes)
{
    double *const products = work, *const changes = work + n * n;
    double most = LARGEST_CHANGE;
    for (int round = 0; round < REFINEMENTS; ++round) {
        if (!compare_modes(n, K, M, modes, products, eigenvalues, changes)) {
            return 0;
        }
        double squares = 0.0; /* of all changes */
        for (int i = 0; i < n; ++i) {
            squares += dot(n, changes + i * n, changes + i * n);
        }
        if (!(squares <= most * most)) { /* NaN, of modes that are not finite, gives up, too */
            return 0;
        }
        most = LARGEST_SHARE * sqrt(squares);
        multiply_rows(n, changes, modes, products);
        add_scaled(n * n, 1.0, products, modes);
        if (squares <= LAST_CHANGE * LAST_CHANGE) { /* the error that is left is about its square */
            sort_eigenpairs(n, eigenvalues, modes);
            return 1;
        }
    }
    return 0;
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
 * cost = share S V diag(max(l, 0)) V^T S. A difference below ROUNDED of the trace of S is covered in one step, and one
 * of stiffnesses that are nothing without a cost. Return whether K differed from wanted.
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
    const double trace = S[0] + S[4] + S[8], part = size <= ROUNDED * trace ? 1.0 : share;
    if (trace <= LEAST_DIVISOR) { /* K has fallen to almost 0 */
        for (int k = 0; k < 9; ++k) { /* wanted may be K */
            K[k] = wanted[k];
        }
        return size != 0.0;
    }
    for (int k = 0; k < 9; k += 4) { /* the diagonal */
        S[k] += UNCHANGED * trace;
    }
    if (size == 0.0 || solve_pencil(3, D, S, L, C, values, rows, &scale) != 0) {
        return 0;
    }
    multiply_lower(3, L, rows); /* columns of S V / sqrt(scale): the scale goes to the values */
    for (int k = 0; k < 3; ++k) {
        values[k] = part * larger(values[k], 0.0) * scale;
    }
    form_congruence(3, 3, rows, values, cost);
    for (int k = 0; k < 9; ++k) {
        K[k] += part * D[k] - cost[k];
    }
    return 1;
}
