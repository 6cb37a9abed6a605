/* Velocities of the joints for the tips' twists, within the joints' bounds: damped least squares. */
#include "follow.h"

static const double DAMPING = 1e-3; /* [m^2] added to squares of singular values */
static const double SLIP = 5e-3;    /* [m/s] that a tip may be off its line while its rotation lags */
static const double GAIN = 0.7;     /* share of a tip's error that must go, so that its rotation may lag */
static const double LAG = 40.0;     /* times the rotations' damping, where they lag */
enum { ROUNDS = 2 }; /* of refinement: the share (damping / (damping + singular value^2))^ROUNDS of a twist is lost */

/* Factorise a symmetric positive definite A = L L^T (lower triangles). */
void factorise(int n, const double *A, double *L)
{
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j <= i; ++j) {
            const double rest = A[i * n + j] - dot(j, L + i * n, L + j * n);
            L[i * n + j] = i == j ? sqrt(fmax(rest, DBL_MIN)) : rest / L[j * n + j];
        }
    }
}

/* Solve L L^T x = b in place. */
void solve(int n, const double *L, double *x)
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

/* Compute the twists of velocities. */
void multiply(const double *J, const double *velocity, double *twists)
{
    for (int r = 0; r < ROWS; ++r) {
        twists[r] = dot(N, J + r * N, velocity);
    }
}

/* Add the products of a joint's column to A, the lower triangle of J J^T, times a share. */
void add_column(const double *J, int joint, double share, double *A)
{
    for (int r = 0; r < ROWS; ++r) {
        const double part = share * J[r * N + joint];
        for (int s = 0; s <= r; ++s) {
            A[r * ROWS + s] += part * J[s * N + joint];
        }
    }
}

/* Let the free joints do what the twists lack. A: damped J J^T of the free joints. */
static void move_free(const double *J, const double *A, const double *twists, const int *fixed, double *velocity)
{
    double L[ROWS * ROWS], x[ROWS];
    factorise(ROWS, A, L);
    for (int round = 0; round < ROUNDS; ++round) {
        multiply(J, velocity, x);
        for (int r = 0; r < ROWS; ++r) {
            x[r] = twists[r] - x[r];
        }
        solve(ROWS, L, x);
        for (int i = 0; i < N; ++i) {
            for (int r = 0; r < ROWS && fixed[i] == 0; ++r) {
                velocity[i] += J[r * N + i] * x[r];
            }
        }
    }
}

/*
 * Solve J velocity = twists, from velocities that cost nothing. A joint that would be faster than it may, or would
 * leave its range, is fixed at what it may do, worst first, and the others do what is left as well as they can. (To
 * slow all joints keeps the line, but near singular postures the tip then hardly moves.) Return how many are fixed.
 */
static int solve_bounded(const step_t *k, const double *twists, const double *free, double lag, double *velocity)
{
    double A[ROWS * ROWS];
    int fixed[N] = {0};
    memcpy(A, k->G, sizeof A);
    for (int r = 0; r < ROWS; ++r) {
        A[r * (ROWS + 1)] += r % 6 < 3 ? DAMPING : lag * DAMPING;
    }
    for (int count = 0; count < N; ++count) {
        int worst = -1;
        double most = DBL_EPSILON;
        for (int i = 0; i < N; ++i) {
            velocity[i] = fixed[i] ? velocity[i] : free[i];
        }
        move_free(k->J, A, twists, fixed, velocity);
        for (int i = 0; i < N; ++i) {
            const double beyond = fmax(velocity[i] - k->high[i], k->low[i] - velocity[i]) / k->most[i];
            worst = !fixed[i] && beyond > most ? i : worst;
            most = worst == i ? beyond : most;
        }
        if (worst < 0) {
            return count;
        }
        fixed[worst] = 1;
        velocity[worst] = fmin(fmax(velocity[worst], k->low[worst]), k->high[worst]);
        add_column(k->J, worst, -1.0, A);
    }
    return N;
}

/* Return the largest error [m/s] of a tip's translation. */
static double slip(const double *J, const double *twists, const double *velocity)
{
    double most = 0.0, error[ROWS];
    multiply(J, velocity, error);
    for (int r = 0; r < ROWS; ++r) {
        error[r] -= twists[r];
        most = r % 6 == 2 ? fmax(most, norm(3, error + r - 2)) : most;
    }
    return most;
}

/*
 * Find velocities for the twists; they begin as those that cost nothing. The tips' places come first: where joints are
 * at their bounds, and the tips can be much nearer their lines if rotations lag, these lag as far as that needs.
 * (Without "much", they would be given up for whatever little a place out of reach gains by it.)
 */
void solve_velocity(const step_t *k, const double *twists, double *velocity)
{
    double free[N], lagging[N];
    memcpy(free, velocity, sizeof free);
    const int fixed = solve_bounded(k, twists, free, 1.0, velocity);
    const double error = slip(k->J, twists, velocity);
    if (fixed == 0 || error <= SLIP) {
        return;
    }
    solve_bounded(k, twists, free, LAG, lagging);
    const double least = slip(k->J, twists, lagging);
    if (least > GAIN * error) {
        return;
    }
    const double share = fmax(0.0, SLIP - least) / (error - least); /* the bounds are convex, and so is the error */
    for (int i = 0; i < N; ++i) {
        velocity[i] = lagging[i] + share * (velocity[i] - lagging[i]);
    }
}
