/* Velocities of the joints for the tips' twists, within the joints' bounds: damped least squares. */
#include "follow.h"

static const double DAMPING = 1e-3; /* [m^2] added to squares of singular values */
static const double HELP = 1e-6;    /* [m^2/s] of a fixed joint's column times the twists' lack, from which it helps */
enum { PASSES = (int)N + 3, ROUNDS = 3 }; /* that fix or free joints; that lose (DAMPING / (DAMPING + s^2))^ROUNDS */

/* Add the products of a joint's column to A, the lower triangle of J J^T, times a share. */
static void add_column(const double *J, int joint, double share, double *A)
{
    for (int r = 0; r < ROWS; ++r) {
        const double part = share * J[r * N + joint];
        for (int s = 0; s <= r; ++s) {
            A[r * ROWS + s] += part * J[s * N + joint];
        }
    }
}

/*
 * Let the free joints do what the twists lack, from velocities that cost nothing. A: damped J J^T of the free joints.
 * sides: as for choose. lack: what the twists lack in the end: DAMPING x after each round, which solves A x = lack.
 */
static void move_free(const double *J, const double *A, const double *twists, const int *sides, double *velocity,
    double *lack)
{
    double L[ROWS * ROWS], sum[ROWS] = {0.0};
    find_triangle(ROWS, A, L);
    multiply(J, velocity, lack);
    for (int r = 0; r < ROWS; ++r) {
        lack[r] = twists[r] - lack[r];
    }
    for (int round = 0; round < ROUNDS; ++round) {
        solve_triangles(ROWS, L, lack);
        for (int r = 0; r < ROWS; ++r) {
            sum[r] += lack[r];
            lack[r] *= DAMPING;
        }
    }
    for (int r = 0; r < ROWS; ++r) {
        for (int i = 0; i < N; ++i) {
            velocity[i] += sides[i] % 2 == 0 ? J[r * N + i] * sum[r] : 0.0;
        }
    }
}

/*
 * Choose the joint that changes sides: the one farthest beyond its bound, else the fixed one that helps the tips most
 * when it leaves its bound; -1: none. sides: 1 and -1 at upper and lower bounds, 0 free, 2 freed for good.
 */
static int choose(const double *J, const double *lack, const double *low, const double *high, const int *sides,
    const double *velocity)
{
    int beyond = -1, inward = -1;
    double farthest = DBL_EPSILON, most = HELP;
    for (int i = 0; i < N; ++i) {
        const int side = sides[i] % 2;
        const double over = side == 0 ? fabs(velocity[i] - clamp(velocity[i], low[i], high[i])) : 0.0;
        double help = 0.0;
        for (int r = 0; r < ROWS && side != 0; ++r) {
            help -= side * J[r * N + i] * lack[r];
        }
        beyond = over > farthest ? i : beyond;
        farthest = over > farthest ? over : farthest;
        inward = help > most ? i : inward;
        most = help > most ? help : most;
    }
    return beyond >= 0 ? beyond : inward;
}

/*
 * Solve J velocity = twists as well as bounds allow, from velocities that cost nothing. A joint beyond its bounds is
 * fixed there, worst first, and freed once if that helps (slowing all joints keeps the line, but near a singular
 * posture the tip hardly moves. A joint kept fixed from call to call stays so while others do its part: the arm swings)
 */
void solve_bounded(const double *J, const double *twists, const double *low, const double *high, double *velocity)
{
    double A[ROWS * ROWS], free[N], lack[ROWS];
    int sides[N] = {0};
    memcpy(free, velocity, sizeof free);
    for (int r = 0; r < ROWS; ++r) {
        for (int s = 0; s <= r; ++s) {
            A[r * ROWS + s] = dot(N, J + r * N, J + s * N) + (r == s ? DAMPING : 0.0);
        }
    }
    for (int pass = 0, joint = 0; pass < PASSES && joint >= 0; ++pass) {
        move_free(J, A, twists, sides, velocity, lack);
        joint = choose(J, lack, low, high, sides, velocity);
        if (joint >= 0) {
            const int freed = sides[joint] % 2 != 0, above = velocity[joint] > high[joint] ? 1 : -1;
            const double bound = clamp(velocity[joint], low[joint], high[joint]);
            sides[joint] = freed ? 2 : above;
            add_column(J, joint, freed ? 1.0 : -1.0, A);
            for (int i = 0; i < N; ++i) {
                velocity[i] = sides[i] % 2 == 0 ? free[i] : velocity[i];
            }
            velocity[joint] = freed ? free[joint] : bound;
        }
    }
    for (int i = 0; i < N; ++i) {
        velocity[i] = clamp(velocity[i], low[i], high[i]);
    }
}
