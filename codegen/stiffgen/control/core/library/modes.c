/*
 * Modes of a symmetric matrix: eigenvalues, and the turns that lead to the eigenvectors, which are never multiplied
 * out: a vector goes to the modes and back by the turns themselves. Householder reflections to a tridiagonal matrix
 * (Golub, Van Loan 8.3; the vectors stay in A), then implicit QL by squares (Pal, Walker, Kahan; Parlett 8.15).
 */
#include "impedance.h"

enum { SWEEPS = 30 }; /* for one eigenvalue; two are usual */

/* Add a turn of two rows, or, for the row ~row, a change of its sign. */
static void add_turn(modes_t *m, int row, double cosine, double sine)
{
    m->row[m->count] = (int16_t)row;
    m->cosine[m->count] = cosine;
    m->sine[m->count] = sine;
    m->count += 1;
}

/*
 * Reflect the rows and columns beyond k (Householder: A -= v w^T + w v^T), so that row k has one entry beside the
 * diagonal. The reflection's vector v stays in row k. Return the entry.
 */
static double eliminate(double *A, int k, double *beta)
{
    const int count = N - k - 1;
    double *const v = A + k * N + k + 1, w[N] = {0.0};
    const double below = count > 1 ? dot(count - 1, v + 1, v + 1) : 0.0, first = count > 0 ? v[0] : 0.0;
    *beta = 0.0;
    if (!(below > 0.0)) {
        return first;
    }
    const double beside = (first > 0.0 ? -1.0 : 1.0) * sqrt(first * first + below);
    v[0] -= beside;
    *beta = 2.0 / (v[0] * v[0] + below);
    for (int i = 0; i < count; ++i) {
        w[i] = *beta * dot(count, A + (k + 1 + i) * N + k + 1, v);
    }
    add_scaled(count, -0.5 * *beta * dot(count, v, w), v, w);
    for (int i = 0; i < count; ++i) {
        double *const row = A + (k + 1 + i) * N + k + 1;
        for (int j = 0; j < count; ++j) {
            row[j] -= v[i] * w[j] + w[i] * v[j];
        }
    }
    return beside;
}

/* Reduce A to a tridiagonal matrix; its size becomes 1. e: squares of the entries beside the diagonal. */
static void tridiagonalise(double *A, double scale, modes_t *m, double *e)
{
    double side = 1.0;
    for (int k = 0; k < N; ++k) {
        const double beside = eliminate(A, k, &m->beta[k]);
        m->d[k] = scale * A[k * (N + 1)];
        e[k] = scale * beside * (scale * beside);
        m->side[k] = side;
        side = beside < 0.0 ? -side : side;
    }
}

/* Do one sweep of implicit QL on the rows l ... last. */
static void sweep(modes_t *m, double *e, int l, int last, double negligible)
{
    double *const d = m->d;
    const double h = 0.5 * (d[l + 1] - d[l]), root = sqrt(h * h + e[l]);
    const double shift = d[l] + (h < 0.0 ? h + root : h - root); /* Wilkinson's */
    double gamma = d[last] - shift, p = gamma * gamma, cosine = 1.0, sine = 0.0, sign = 1.0;
    for (int i = last - 1; i >= l; --i) {
        const double square = e[i], r = p + square, before = gamma;
        e[i + 1] = sine * r;
        if (p > negligible) {
            const double product = p * (d[i] - shift) - square * gamma;
            gamma = product / r;
            cosine = p / r;
            sine = square / r;
            p = product * product / (r * p);
            d[i + 1] = before + (d[i] - gamma);
            sign = before < 0.0 ? -sign : sign;
        } else { /* a right angle */
            p = cosine * square;
            gamma = cosine = 0.0;
            sine = 1.0;
            d[i + 1] = d[i];
            sign = -sign;
        }
        add_turn(m, i, sign * sqrt(cosine), sqrt(sine));
    }
    e[l] = sine * p;
    d[l] = shift + gamma;
    if (gamma * sign < 0.0) {
        add_turn(m, ~l, -1.0, 0.0);
    }
}

/* Find the modes of A, in whose place the reflections remain. */
void find_modes(double *A, modes_t *m)
{
    const double size = norm(NN, A), negligible = 0.25 * DBL_EPSILON * DBL_EPSILON;
    double e[N];
    memset(m, 0, sizeof *m);
    tridiagonalise(A, size > 0.0 ? 1.0 / size : 0.0, m, e);
    for (int l = 0; l < N; ++l) {
        for (int round = 0; round < SWEEPS && m->count <= MOST_TURNS - N - 1; ++round) {
            int last = l;
            while (last < N - 1 && e[last] > negligible) {
                ++last;
            }
            if (last == l) {
                break;
            }
            sweep(m, e, l, last, negligible);
        }
    }
    for (int i = 0; i < N; ++i) {
        m->d[i] *= size;
    }
}

/* Apply reflection k to a vector. */
static void reflect(const modes_t *m, const double *A, int k, double *y)
{
    const double *const v = A + k * N + k + 1;
    const double factor = m->beta[k] > 0.0 ? m->beta[k] * dot(N - k - 1, v, y + k + 1) : 0.0;
    for (int i = 0; factor != 0.0 && i < N - k - 1; ++i) {
        y[k + 1 + i] -= factor * v[i];
    }
}

/* Apply all turns to a vector; side -1: backwards, from the last on. */
static void turn(const modes_t *m, double side, double *y)
{
    const int count = m->count;
    for (int j = 0; j < count; ++j) {
        const int k = side > 0.0 ? j : count - 1 - j, i = m->row[k];
        if (i < 0) {
            y[~i] = -y[~i];
        } else {
            const double c = m->cosine[k], s = side * m->sine[k], a = y[i], b = y[i + 1];
            y[i] = c * a - s * b;
            y[i + 1] = s * a + c * b;
        }
    }
}

/* Replace y by its parts in the modes. A: what find_modes left. */
void to_modes(const modes_t *m, const double *A, double *y)
{
    for (int k = 0; k < N - 1; ++k) {
        reflect(m, A, k, y);
    }
    for (int i = 0; i < N; ++i) {
        y[i] *= m->side[i];
    }
    turn(m, 1.0, y);
}

/* Replace y, parts in the modes, by the vector that it is. */
void from_modes(const modes_t *m, const double *A, double *y)
{
    turn(m, -1.0, y);
    for (int i = 0; i < N; ++i) {
        y[i] *= m->side[i];
    }
    for (int k = N - 2; k >= 0; --k) {
        reflect(m, A, k, y);
    }
}
