/* Poses, and the twists between them. */
#include "posture.h"

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

/* Return whether all numbers lie between the bounds; NaN does not. */
int all_within(const double *x, int count, double least, double most)
{
    int good = 1;
    for (int i = 0; i < count; ++i) {
        good = good && x[i] >= least && x[i] <= most;
    }
    return good;
}

/* Copy a pose with its rotation made orthonormal, by two Newton steps R (3 - R^T R) / 2. Return whether it is one. */
int clean_pose(const double *pose, double *clean)
{
    if (!all_within(pose, 16, -FARTHEST, FARTHEST) || norm(3, pose + 12) > 0.0 || fabs(pose[15] - 1.0) > 0.0) {
        return 0;
    }
    memcpy(clean, pose, 16 * sizeof *clean);
    for (int round = 0; round < 2; ++round) {
        double R[12], D[9];
        memcpy(R, clean, sizeof R);
        for (int k = 0; k < 9; ++k) {
            const int i = k / 3, j = k % 3;
            D[k] = (i == j ? 3.0 : 0.0) - R[i] * R[j] - R[4 + i] * R[4 + j] - R[8 + i] * R[8 + j];
            if (fabs(D[k] - (i == j ? 2.0 : 0.0)) > ROUGH) {
                return 0;
            }
        }
        for (int k = 0; k < 9; ++k) {
            clean[k / 3 * 4 + k % 3] = dot(3, R + k / 3 * 4, D + k % 3 * 3) / 2.0; /* D is symmetric */
        }
    }
    const double *const x = clean, *const y = clean + 4;
    const double cross[3] = {x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]};
    return dot(3, cross, clean + 8) > 0.0;
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

/* Compute the twists (hybrid axes) of all tips from poses to others: motions of the origins, and rotation vectors. */
void compare_poses(const double *from, const double *to, double *twists)
{
    for (int t = 0; t < TIPS; ++t, from += 16, to += 16, twists += 6) {
        double D[9]; /* the rotation between the poses */
        for (int k = 0; k < 9; ++k) {
            D[k] = dot(3, to + k / 3 * 4, from + k % 3 * 4);
        }
        double w[3] = {(D[7] - D[5]) / 2.0, (D[2] - D[6]) / 2.0, (D[3] - D[1]) / 2.0};
        take_logarithm(D, w);
        for (int i = 0; i < 3; ++i) {
            twists[i] = to[4 * i + 3] - from[4 * i + 3];
            twists[3 + i] = w[i];
        }
    }
}
