/* Poses, the twist between two, and moves by a twist. */
#include "shared.h"

static const double ROUGH = 1e-3; /* what R^T R may differ from 1 by: single precision and drift, not a mistake */

static const double EXACT = 1e-13; /* up to which R is orthonormal but for rounding */

static const double NO_SINE = 1e-6; /* sine up to which, near half a turn, it has lost the digits of the axis */

/* Return the largest entry of R^T R - 1 for a pose (4 x 4) with rotation R, and the index of R's entry in its place. */
double rotation_error(const double *pose, int *entry)
{
    double most = 0.0;
    for (int k = 0; k < 9; ++k) {
        const int i = k / 3, j = k % 3;
        const double product = pose[i] * pose[j] + pose[4 + i] * pose[4 + j] + pose[8 + i] * pose[8 + j];
        const double off = fabs(product - (i == j ? 1.0 : 0.0));
        *entry = off > most ? 4 * i + j : *entry;
        most = larger(off, most);
    }
    return most;
}

/* Return whether a matrix has the numbers and the last row of a pose. */
int has_form_of_pose(const double *pose)
{
    const double last[4] = {pose[12], pose[13], pose[14], pose[15] - 1.0};
    return doubles_within(pose, 16, -FARTHEST, FARTHEST) && doubles_within(last, 4, 0.0, 0.0);
}

/*
 * Copy a pose with its rotation R made orthonormal, by two Newton steps R (3 - R^T R) / 2: one leaves 1e-6 of ROUGH,
 * two leave 1e-12. Return whether it is a pose.
 */
int clean_pose(const double *pose, double *clean)
{
    int unused = 0;
    const double off = rotation_error(pose, &unused);
    if (!has_form_of_pose(pose) || off > ROUGH) {
        return 0;
    }
    memcpy(clean, pose, 16 * sizeof *clean);
    for (int round = 0; round < 2 && off > EXACT; ++round) {
        double R[12], D[9];
        memcpy(R, clean, sizeof R);
        for (int k = 0; k < 9; ++k) {
            const int i = k / 3, j = k % 3;
            D[k] = (i == j ? 1.5 : 0.0) - 0.5 * (R[i] * R[j] + R[4 + i] * R[4 + j] + R[8 + i] * R[8 + j]);
        }
        for (int k = 0; k < 9; ++k) {
            clean[k / 3 * 4 + k % 3] = dot(3, R + k / 3 * 4, D + k % 3 * 3); /* D is symmetric */
        }
    }
    const double *const x = clean, *const y = clean + 4;
    const double cross[3] = {x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]};
    return dot(3, cross, clean + 8) > 0.0;
}

/*
 * Compute the twist (hybrid axes) from a pose to another: motion of the origin [m], and rotation vector [rad]. The
 * rotation between them, D = R_to R_from^T, has sin(angle) n in D - D^T, cos(angle) in its trace; n is the unit axis.
 */
void compare_pose(const double *from, const double *to, double *twist)
{
    double D[9];
    for (int k = 0; k < 9; ++k) {
        D[k] = dot(3, to + k / 3 * 4, from + k % 3 * 4);
    }
    double axis[3] = {(D[7] - D[5]) / 2.0, (D[2] - D[6]) / 2.0, (D[3] - D[1]) / 2.0}; /* sin(angle) n */
    const double sine = norm(3, axis), angle = atan2(sine, (D[0] + D[4] + D[8] - 1.0) / 2.0);
    if (angle > 1.0 && sine < NO_SINE) { /* near half a turn D + 1 is 2 n n^T: n is its longest column */
        const int first = D[0] > D[4] ? 0 : 1, k = D[8] > D[4 * first] ? 2 : first;
        for (int i = 0; i < 3; ++i) {
            axis[i] = D[3 * i + k] + (i == k ? 1.0 : 0.0);
        }
    }
    const double size = norm(3, axis);
    for (int i = 0; i < 3; ++i) {
        twist[i] = to[4 * i + 3] - from[4 * i + 3];
        twist[3 + i] = size > 0.0 ? angle / size * axis[i] : 0.0;
    }
}

/* Compute the twists (6 each) from poses to as many others. */
void compare_poses(int count, const double *from, const double *to, double *twists)
{
    for (int k = 0; k < count; ++k) {
        compare_pose(from + 16 * k, to + 16 * k, twists + 6 * k);
    }
}

static const double NO_TURN = 1e-9; /* [rad] up to which a turn has no axis */

/*
 * Move a pose by a twist in base axes: its place by the translation, and turned about the place. By Rodrigues' formula
 * each column v of the rotation becomes v + a w x v + b w x (w x v), with the rotation vector w of length `angle`, and
 * a = sin(angle) / angle, b = (1 - cos(angle)) / angle^2 = 2 (sin(angle / 2) / angle)^2.
 */
void move_pose(const double *twist, double *pose)
{
    const double *const w = twist + 3, angle = norm(3, w);
    const double a = angle > NO_TURN ? sin(angle) / angle : 1.0;
    const double half = angle > NO_TURN ? sin(0.5 * angle) / angle : 0.5, b = 2.0 * half * half;
    for (int column = 0; column < 3; ++column) { /* w x (w x v) = w (w . v) - v angle^2 */
        const double v[3] = {pose[column], pose[4 + column], pose[8 + column]}, along = dot(3, w, v);
        for (int i = 0; i < 3; ++i) {
            const int j = (i + 1) % 3, k = (i + 2) % 3;
            const double cross = w[j] * v[k] - w[k] * v[j];
            pose[4 * i + column] = v[i] + a * cross + b * (w[i] * along - v[i] * angle * angle);
        }
    }
    for (int i = 0; i < 3; ++i) {
        pose[4 * i + 3] += twist[i];
    }
}
