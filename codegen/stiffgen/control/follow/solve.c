/* Velocities of the joints for the tips' twists, within the joints' bounds: damped least squares. */
#include "follow.h"

static const double DAMPING = 1e-3; /* [m^2] added to squares of singular values */
static const double HELP = 1e-6;    /* [m^2/s] of a fixed joint's column times the twists' lack, from which it helps */
enum { PASSES = (int)N + 3, ROUNDS = 3 }; /* that fix or free joints; that lose (DAMPING / (DAMPING + s^2))^ROUNDS */
enum { AT_LOWER = -1, FREE_JOINT = 0, AT_UPPER = 1 }; /* sides of a joint */

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
 * Let the free joints do what the twists lack. A = J J^T + DAMPING, of the free joints' columns alone. Each round adds
 * J^T x, where A x = lack; the twists then lack `lack` - J J^T x = DAMPING x: the next round's, and at last the result.
 */
static void move_free(const double *J, const double *A, const double *twists, const int *sides, double *velocity,
    double *lack)
{
    double L[ROWS * ROWS], made[ROWS], x[ROWS], sum[ROWS] = {0.0};
    find_triangle(ROWS, A, L);
    multiply(J, velocity, made);
    for (int r = 0; r < ROWS; ++r) {
        lack[r] = twists[r] - made[r];
    }
    for (int round = 0; round < ROUNDS; ++round) {
        memcpy(x, lack, sizeof x);
        solve_triangles(ROWS, L, x);
        for (int r = 0; r < ROWS; ++r) {
            sum[r] += x[r];
            lack[r] = DAMPING * x[r];
        }
    }
    for (int r = 0; r < ROWS; ++r) {
        for (int i = 0; i < N; ++i) {
            velocity[i] += sides[i] == FREE_JOINT ? J[r * N + i] * sum[r] : 0.0;
        }
    }
}

/* Return the free joint whose velocity is farthest beyond its bounds; -1: none. */
static int farthest_beyond(const double *velocity, const double *low, const double *high, const int *sides)
{
    int found = -1;
    double farthest = DBL_EPSILON; /* [rad/s] */
    for (int i = 0; i < N; ++i) {
        const double beyond = fabs(velocity[i] - clamp(velocity[i], low[i], high[i]));
        found = sides[i] == FREE_JOINT && beyond > farthest ? i : found;
        farthest = found == i ? beyond : farthest;
    }
    return found;
}

/* Return the fixed joint that gives the tips most of what they lack when it leaves its bound inward; -1: none. */
static int most_helpful(const double *J, const double *lack, const int *sides)
{
    int found = -1;
    double most = HELP;
    for (int i = 0; i < N; ++i) {
        double help = 0.0;
        for (int r = 0; r < ROWS && sides[i] != FREE_JOINT; ++r) {
            help -= sides[i] * J[r * N + i] * lack[r];
        }
        found = help > most ? i : found;
        most = larger(help, most);
    }
    return found;
}

/*
 * Solve J velocity = twists as well as bounds allow, from velocities that cost nothing. A pass fixes the joint farthest
 * beyond its bound there, or else frees a fixed one that helps; both may return, so PASSES end it. (Slowing all joints
 * keeps the line, but near a singular posture the tip hardly moves. Sides kept from call to call let the arm swing.)
 */
void solve_bounded(const double *J, const double *twists, const double *low, const double *high, double *velocity)
{
    double A[ROWS * ROWS], costless[N], lack[ROWS];
    int sides[N] = {0}; /* FREE_JOINT */
    memcpy(costless, velocity, sizeof costless);
    for (int r = 0; r < ROWS; ++r) {
        for (int s = 0; s <= r; ++s) {
            A[r * ROWS + s] = dot(N, J + r * N, J + s * N) + (r == s ? DAMPING : 0.0);
        }
    }
    for (int pass = 0; pass < PASSES; ++pass) {
        move_free(J, A, twists, sides, velocity, lack);
        const int beyond = farthest_beyond(velocity, low, high, sides);
        const int helpful = beyond < 0 ? most_helpful(J, lack, sides) : -1;
        if (beyond >= 0) {
            sides[beyond] = velocity[beyond] > high[beyond] ? AT_UPPER : AT_LOWER;
            velocity[beyond] = clamp(velocity[beyond], low[beyond], high[beyond]);
            add_column(J, beyond, -1.0, A);
        } else if (helpful >= 0) {
            sides[helpful] = FREE_JOINT;
            add_column(J, helpful, 1.0, A);
        } else {
            break;
        }
        for (int i = 0; i < N; ++i) { /* the next pass begins anew with the free joints */
            velocity[i] = sides[i] == FREE_JOINT ? costless[i] : velocity[i];
        }
    }
    for (int i = 0; i < N; ++i) {
        velocity[i] = clamp(velocity[i], low[i], high[i]);
    }
}
