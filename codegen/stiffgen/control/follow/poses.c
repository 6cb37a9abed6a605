/* Poses of the tips, the twists between them, and what size these have. */
#include "follow.h"

static const double ROUGH = 1e-3;   /* what R^T R may differ from 1 by: single precision and drift, not a mistake */
static const double CLEAN = 1e-12;  /* up to which it is orthonormal already */
static const double NO_SINE = 1e-6; /* sine up to which, near half a turn, it has lost the digits of the axis */

double dot(int n, const double *a, const double *b)
{
    double sum = 0.0;
    for (int i = 0; i < n; ++i) {
        sum += a[i] * b[i];
    }
    return sum;
}

double norm(int n, const double *a)
{
    return sqrt(dot(n, a, a));
}

/* Return whether all numbers lie between the bounds. NaN does not: its bits tell, whatever a compiler's flags say. */
int all_within(const double *x, int count, double least, double most)
{
    int good = 1;
    for (int i = 0; i < count; ++i) {
        uint64_t bits;
        memcpy(&bits, x + i, sizeof bits);
        good = good && (bits << 1) <= 0xffe0000000000000u && x[i] >= least && x[i] <= most;
    }
    return good;
}

/* Copy a pose with its rotation made orthonormal: two Newton steps R (3 - R^T R) / 2. Return OK or what is wrong. */
int clean_pose(const double *pose, double *clean)
{
    if (!all_within(pose, 16, -FARTHEST, FARTHEST) || norm(3, pose + 12) > 0.0 || fabs(pose[15] - 1.0) > 0.0) {
        return ID(FOLLOW_E_POSE);
    }
    memcpy(clean, pose, 16 * sizeof *clean);
    double off = 1.0;
    for (int round = 0; round < 2 && off > CLEAN; ++round) {
        double R[12], D[9];
        off = 0.0;
        memcpy(R, clean, sizeof R);
        for (int k = 0; k < 9; ++k) {
            const int i = k / 3, j = k % 3;
            D[k] = (i == j ? 3.0 : 0.0) - R[i] * R[j] - R[4 + i] * R[4 + j] - R[8 + i] * R[8 + j];
            off = fmax(off, fabs(D[k] - (i == j ? 2.0 : 0.0)));
        }
        if (off > ROUGH) {
            return ID(FOLLOW_E_ROTATION);
        }
        for (int k = 0; k < 9 && off > CLEAN; ++k) {
            clean[4 * (k / 3) + k % 3] = dot(3, R + 4 * (k / 3), D + 3 * (k % 3)) / 2.0; /* D is symmetric */
        }
    }
    const double *const x = clean, *const y = clean + 4;
    const double cross[3] = {x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]};
    return dot(3, cross, clean + 8) > 0.0 ? ID(FOLLOW_OK) : ID(FOLLOW_E_ROTATION);
}

/* Turn the axis times the sine (w) of a rotation D into the rotation vector. */
static void take_logarithm(const double *D, double *w)
{
    const double cosine = (D[0] + D[4] + D[8] - 1.0) / 2.0, angle = atan2(norm(3, w), cosine);
    if (cosine < 0.0 && norm(3, w) < NO_SINE) { /* the axis is the longest column of D + 1 */
        const int first = D[0] > D[4] ? 0 : 1, k = D[8] > D[4 * first] ? 2 : first;
        for (int i = 0; i < 3; ++i) {
            w[i] = D[3 * i + k] + (i == k ? 1.0 : 0.0);
        }
    }
    const double size = norm(3, w);
    for (int i = 0; i < 3; ++i) {
        w[i] *= size > 0.0 ? angle / size : 1.0;
    }
}

/* Compute the twists [m] that lead the tips from poses to others: motions of the origins, and rotation vectors. */
void compare_poses(const double *from, const double *to, double *twists)
{
    for (int t = 0; t < TIPS; ++t, from += 16, to += 16, twists += 6) {
        double D[9]; /* the rotation between the poses */
        for (int k = 0; k < 9; ++k) {
            D[k] = dot(3, to + 4 * (k / 3), from + 4 * (k % 3));
        }
        double w[3] = {(D[7] - D[5]) / 2.0, (D[2] - D[6]) / 2.0, (D[3] - D[1]) / 2.0};
        take_logarithm(D, w);
        for (int i = 0; i < 3; ++i) {
            twists[i] = to[4 * i + 3] - from[4 * i + 3];
            twists[3 + i] = RADIAN * w[i];
        }
    }
}

/* Compute the Jacobian of the twists. */
void weighed_jacobian(const double *q, const double *tool, double *J)
{
    stiffgen_jacobians(q, tool, J);
    for (int k = 0; k < ROWS * N; ++k) {
        J[k] *= k / N % 6 < 3 ? 1.0 : RADIAN;
    }
}

/* Return the size [m] of the largest twist of a tip. */
double weigh(const double *twists)
{
    double most = 0.0;
    for (int r = 0; r < ROWS; r += 6) {
        most = fmax(most, norm(3, twists + r) + norm(3, twists + r + 3));
    }
    return most;
}

/* Return the twists' size over the speeds that a tip may have [s]; for velocities: [1]. */
double relative_speed(const config_t *c, const double *twists)
{
    double most = 0.0;
    for (int r = 0; r < ROWS; r += 6) {
        most = fmax(most, norm(3, twists + r) / c->tip_velocity_limit);
        most = fmax(most, norm(3, twists + r + 3) / (RADIAN * c->tip_rotation_limit));
    }
    return most;
}
