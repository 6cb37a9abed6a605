/* Search for a posture of poses: damped steps of least squares from many starts, within the joints' bounds. */
#include "posture.h"

enum { TRIALS = 40, STEPS = 60 }; /* of a search; of a trial */
static const double REACHED = 5e-6;      /* [m] or [rad] from a pose at which one step more is the last */
static const double FLAT_SHARE = 1e-9;   /* damping at the pose, where the longest twist of a joint counts as 1 */
static const double STEP_SHARE = 0.05;   /* damping over the error: what its neglected second derivative may do */
static const double LONGEST_STEP = 0.5;  /* [rad] or [m] */
static const double HALF_TURN = 3.14159265358979324;

/* Return the largest distance [m] or angle [rad] of the tips' twists. */
static double largest_part(const double *twists)
{
    double most = 0.0;
    for (int k = 0; k < ROWS; k += 3) {
        most = larger(most, norm(3, twists + k));
    }
    return most;
}

/* Return what counts as one in a row of twists: RADIAN [m], or one radian. */
static double unit_of(int row) { return row % 6 < 3 ? RADIAN : 1.0; }

/* Compute the joints' twists X = J^T (N x ROWS), the longest of which is made 1. Return its length before. */
static double find_twists(const double *q, const double *tool, double *X)
{
    double J[ROWS * N], longest = DBL_MIN;
    stiffgen_jacobians(q, tool, J);
    for (int i = 0; i < N; ++i) {
        for (int r = 0; r < ROWS; ++r) {
            X[i * ROWS + r] = J[r * N + i] / unit_of(r);
        }
        longest = larger(longest, norm(ROWS, X + i * ROWS));
    }
    divide(N * ROWS, longest, X);
    return longest;
}

/* Solve (X^T X + damping) x = b in place. */
static void solve_damped(const double *X, double damping, double *x)
{
    double A[ROWS * ROWS], L[ROWS * ROWS];
    for (int r = 0; r < ROWS; ++r) {
        for (int s = 0; s <= r; ++s) {
            A[r * ROWS + s] = r == s ? damping : 0.0;
            for (int i = 0; i < N; ++i) {
                A[r * ROWS + s] += X[i * ROWS + r] * X[i * ROWS + s];
            }
        }
    }
    find_triangle(ROWS, A, L);
    solve_triangles(ROWS, L, x);
}

/*
 * Hold the free joint whose step leads farthest out of its bounds, at the bound, and take out of X and error what it
 * does to the tips. Return whether there is one.
 */
static int hold_joint(const double *q, const double *low, const double *high, int *held, double *X, double *error,
                      double *step)
{
    double farthest = 0.0;
    int found = -1;
    for (int i = 0; i < N; ++i) {
        const double next = q[i] + step[i], beyond = fabs(next - clamp(next, low[i], high[i])); /* [rad], [m] */
        found = !held[i] && beyond > farthest ? i : found;
        farthest = found == i ? beyond : farthest;
    }
    if (found < 0) {
        return 0;
    }
    held[found] = 1;
    step[found] = clamp(q[found] + step[found], low[found], high[found]) - q[found]; /* up to the bound */
    for (int r = 0; r < ROWS; ++r) {
        error[r] -= step[found] * X[found * ROWS + r];
        X[found * ROWS + r] = 0.0;
    }
    return 1;
}

/*
 * Find the step from q that takes the error, the twists to the goal, out of the tips, within bounds: damped least
 * squares, step = X (X^T X + damping)^-1 error, where damping = FLAT_SHARE + |error|^2 + STEP_SHARE |error|.
 */
static void find_step(const double *q, const double *tool, const double *low, const double *high, double *error,
                      double *step)
{
    double X[N * ROWS];
    const double longest = find_twists(q, tool, X);
    for (int r = 0; r < ROWS; ++r) {
        error[r] /= longest * unit_of(r);
    }
    const double square = dot(ROWS, error, error), damping = FLAT_SHARE + square + STEP_SHARE * sqrt(square);
    int held[N] = {0}, again = 1;
    memset(step, 0, N * sizeof *step);
    for (int round = 0; round < N && again; ++round) { /* each round holds one more joint at its bound */
        double x[ROWS];
        memcpy(x, error, sizeof x);
        solve_damped(X, damping, x);
        for (int i = 0; i < N; ++i) {
            step[i] = held[i] ? step[i] : dot(ROWS, X + i * ROWS, x);
        }
        again = hold_joint(q, low, high, held, X, error, step);
    }
}

/* Return a number from 0 to 1 that is as good as random for a trial and a joint: bits mixed as MurmurHash3 ends. */
static double spread(int trial, int joint)
{
    uint32_t bits = ((uint32_t)trial << 8) + (uint32_t)joint + 1u; /* different for each: fewer than 256 joints */
    bits = (bits ^ (bits >> 16)) * 0x85ebca6bu;
    bits = (bits ^ (bits >> 13)) * 0xc2b2ae35u;
    return (double)(bits ^ (bits >> 16)) / 4294967296.0; /* 2^32 */
}

/* Choose where a trial starts: first at `start`, then ever farther from it, at most half a turn. */
static void start_trial(const double *start, const double *low, const double *high, int trial, double *q)
{
    const double share = trial == 0 ? 0.0 : 0.4 + 0.6 * trial / (double)TRIALS; /* of the way to an even spread */
    for (int i = 0; i < N; ++i) {
        const double least = larger(low[i], start[i] - HALF_TURN), most = smaller(high[i], start[i] + HALF_TURN);
        const double far = least + spread(trial, i) * (most - least);
        q[i] = clamp(start[i] + share * (far - start[i]), low[i], high[i]);
    }
}

/* Step from q towards a posture of the goal. Return whether one is found. */
static int try_posture(const double *goal, const double *tool, const double *low, const double *high, double *q)
{
    int found = 0;
    for (int k = 0; k < STEPS && !found; ++k) {
        double here[16 * TIPS], error[ROWS], step[N];
        stiffgen_poses(q, tool, here);
        compare_poses(TIPS, here, goal, error);
        found = largest_part(error) <= REACHED; /* improved by one step more */
        find_step(q, tool, low, high, error, step);
        const double share = smaller(LONGEST_STEP / larger(norm(N, step), LONGEST_STEP), 1.0); /* of a long step */
        for (int i = 0; i < N; ++i) {
            q[i] += share * step[i];
        }
    }
    return found;
}

/* Search from `start` on. tool: poses of tools, or NULL. Return OK, or why there is no result; then it is `start`. */
int search(const double *poses, const double *tool, const double *start, const double *low, const double *high,
           double *posture)
{
    double goal[16 * TIPS], tools[16 * TIPS], q[N];
    int good = doubles_within(start, N, -FARTHEST, FARTHEST);
    memmove(posture, start, N * sizeof *posture); /* both may be one array */
    for (int t = 0; t < TIPS; ++t) {
        good = good && clean_pose(poses + 16 * t, goal + 16 * t);
        good = good && (tool == NULL || clean_pose(tool + 16 * t, tools + 16 * t));
    }
    if (!good) {
        return ID(FIND_POSTURE_E_POSE);
    }
    for (int i = 0; i < N; ++i) {
        if (!(low[i] <= high[i])) {
            return ID(FIND_POSTURE_E_BOUNDS);
        }
    }
    for (int trial = 0; trial < TRIALS; ++trial) {
        start_trial(start, low, high, trial, q);
        if (try_posture(goal, tool != NULL ? tools : NULL, low, high, q)) {
            memcpy(posture, q, sizeof q);
            return ID(FIND_POSTURE_OK);
        }
    }
    return ID(FIND_POSTURE_E_NO_POSTURE);
}
