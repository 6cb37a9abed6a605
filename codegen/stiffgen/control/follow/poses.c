/* Poses of the tips, and the twists between them. */
#include "follow.h"

static const double ROUGH = 1e-3;   /* what R^T R may differ from 1 by: single precision and drift, not a mistake */
static const double NO_SINE = 1e-6; /* sine up to which, near half a turn, it has lost the digits of the axis */

double dot(int n, const double *a, const double *b)
{
    double sum = 0.0;
    for (int i = 0; i < n; ++i) {
        sum += a[i] * b[i];
    }
    return sum;
}

double norm(int n, const double *a) { return sqrt(dot(n, a, a)); }

double clamp(double x, double least, double most)
{
    const double low = x < least ? least : x;
    return low > most ? most : low;
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

/* Copy a pose with its rotation R made orthonormal, R (3 - R^T R) / 2. Return OK or what is wrong. */
int clean_pose(const double *pose, double *clean)
{
    if (!all_within(pose, 16, -FARTHEST, FARTHEST) || norm(3, pose + 12) > 0.0 || fabs(pose[15] - 1.0) > 0.0) {
        return ID(FOLLOW_E_POSE);
    }
    const double *const x = pose, *const y = pose + 4, *const z = pose + 8;
    const double cross[3] = {x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]};
    double D[9], off = dot(3, cross, z) > 0.0 ? 0.0 : 1.0;
    for (int k = 0; k < 9; ++k) {
        const int i = k / 3, j = k % 3;
        const double one = i == j ? 1.0 : 0.0, product = x[i] * x[j] + y[i] * y[j] + z[i] * z[j];
        D[k] = 1.5 * one - 0.5 * product;
        off = fmax(off, fabs(product - one));
    }
    memcpy(clean, pose, 16 * sizeof *clean);
    for (int k = 0; k < 9; ++k) {
        clean[4 * (k / 3) + k % 3] = dot(3, pose + 4 * (k / 3), D + 3 * (k % 3)); /* D is symmetric */
    }
    return off > ROUGH ? ID(FOLLOW_E_ROTATION) : ID(FOLLOW_OK);
}

/* Compute the twists [m] that lead the tips from poses to others: motions of the origins, and rotation vectors. */
void compare_poses(const double *from, const double *to, double *twists)
{
    for (int t = 0; t < TIPS; ++t, from += 16, to += 16, twists += 6) {
        double D[9]; /* the rotation between the poses */
        for (int k = 0; k < 9; ++k) {
            D[k] = dot(3, to + 4 * (k / 3), from + 4 * (k % 3));
        }
        double axis[3] = {(D[7] - D[5]) / 2.0, (D[2] - D[6]) / 2.0, (D[3] - D[1]) / 2.0}; /* times the sine */
        const double sine = norm(3, axis), angle = atan2(sine, (D[0] + D[4] + D[8] - 1.0) / 2.0);
        if (angle > 1.0 && sine < NO_SINE) { /* the axis is the longest column of D + 1 */
            const int first = D[0] > D[4] ? 0 : 1, k = D[8] > D[4 * first] ? 2 : first;
            for (int i = 0; i < 3; ++i) {
                axis[i] = D[3 * i + k] + (i == k ? 1.0 : 0.0);
            }
        }
        const double size = norm(3, axis);
        for (int i = 0; i < 3; ++i) {
            twists[i] = to[4 * i + 3] - from[4 * i + 3];
            twists[3 + i] = size > 0.0 ? RADIAN * angle / size * axis[i] : 0.0;
        }
    }
}

/* Return the time [s] that twists take at the tips' full speed; of velocities: their share of it. */
double way_of(const config_t *c, const double *twists)
{
    double most = 0.0;
    for (int r = 0; r < ROWS; r += 6) {
        most = fmax(most, norm(3, twists + r) / c->tip_velocity_limit);
        most = fmax(most, norm(3, twists + r + 3) / (RADIAN * c->tip_rotation_limit));
    }
    return most;
}

/* Compute the Jacobian of the twists. */
void weighed_jacobian(const double *q, const double *tool, double *J)
{
    stiffgen_jacobians(q, tool, J);
    for (int k = 0; k < ROWS * N; ++k) {
        J[k] *= k / N % 6 < 3 ? 1.0 : RADIAN;
    }
}
