/* Checks of proposals: what is refused, and the numbers that say why. */
#include "policy.h"

static const double POSE_TOLERANCE = 1e-3; /* what R^T R may differ from 1 by: single precision and drift */
static const double TOLERANCE = 1e-6;      /* of a stiffness, over its largest entry: single precision */
static const double ROUNDED = 1e-9;        /* share by which numbers differ that are the same but for rounding */

/* Return a refusal; a number that is not finite counts as 0. */
refusal_t refuse(int code, int entry, double seen, double limit)
{
    const refusal_t r = {code, entry, fabs(seen) <= DBL_MAX ? seen : 0.0, limit};
    return r;
}

/* Return a refusal of nothing. */
refusal_t accept(void) { return refuse(ACCEPTED, WHOLE, 0.0, 0.0); }

/* Check that `count` numbers from x[first] on are finite, and no larger than `most`; else refuse them for `code`. */
static refusal_t check_numbers(const double *x, int first, int count, double most, int code)
{
    for (int k = first; k < first + count; ++k) {
        if (!(fabs(x[k]) <= smaller(most, DBL_MAX))) {
            return refuse(fabs(x[k]) <= DBL_MAX ? code : ID(POLICY_REFUSED_NOT_FINITE), k, x[k], most);
        }
    }
    return accept();
}

/* Check that a matrix is a pose: R^T R = 1 up to POSE_TOLERANCE, right-handed, last row 0 0 0 1. first: its index. */
static refusal_t check_pose(const double *P, int first)
{
    /* of the rotation: -1 for a mirrored one, whose R^T R is right */
    const double det = P[0] * (P[5] * P[10] - P[6] * P[9]) - P[1] * (P[4] * P[10] - P[6] * P[8]) +
                       P[2] * (P[4] * P[9] - P[5] * P[8]);
    int entry = 0;
    const double off = rotation_error(P, &entry);
    if (off > POSE_TOLERANCE) {
        return refuse(ID(POLICY_REFUSED_POSE), first + entry, off, POSE_TOLERANCE);
    }
    for (int i = 12; i < 16; ++i) {
        if (fabs(P[i] - (i == 15 ? 1.0 : 0.0)) > 0.0) {
            return refuse(ID(POLICY_REFUSED_POSE), first + i, P[i], i == 15 ? 1.0 : 0.0);
        }
    }
    return det > 0.0 ? accept() : refuse(ID(POLICY_REFUSED_POSE), first, det, 1.0);
}

/* Check the poses of all tips, and that their origins are within reach. */
refusal_t check_poses(const config_t *c, const double *poses)
{
    refusal_t found = check_numbers(poses, 0, 16 * TIPS, FARTHEST, ID(POLICY_REFUSED_POSE));
    for (int t = 0; found.code == ACCEPTED && t < TIPS; ++t) {
        const double *const P = poses + 16 * t, place[3] = {P[3], P[7], P[11]}, far = norm(3, place);
        found = check_pose(P, 16 * t);
        if (found.code == ACCEPTED && far > c->reach) {
            found = refuse(ID(POLICY_REFUSED_REACH), 16 * t + 3, far, c->reach);
        }
    }
    return found;
}

/* Check stiffnesses (3 x 3) of all tips: symmetric, positive semidefinite. symmetric: their symmetric parts. */
refusal_t check_stiffness(const double *stiffness, double most, double *symmetric)
{
    refusal_t found = check_numbers(stiffness, 0, 9 * TIPS, most, ID(POLICY_REFUSED_STIFFNESS));
    for (int t = 0; found.code == ACCEPTED && t < TIPS; ++t) {
        const double *const K = stiffness + 9 * t;
        double *const S = symmetric + 9 * t, size = DBL_MIN;
        for (int k = 0; k < 9; ++k) {
            S[k] = 0.5 * (K[k] + K[k % 3 * 3 + k / 3]);
            size = larger(size, fabs(K[k]));
        }
        const double allowed = TOLERANCE * size, least = smallest_eigenvalue(S);
        found = least < -allowed ? refuse(ID(POLICY_REFUSED_INDEFINITE), 9 * t, least, -allowed) : found;
        for (int k = 0; k < 9; ++k) {
            const double apart = 2.0 * fabs(K[k] - S[k]);
            found = apart > allowed ? refuse(ID(POLICY_REFUSED_ASYMMETRIC), 9 * t + k, apart, allowed) : found;
        }
    }
    return found;
}

/* Check the wrenches of all tips: force and moment no larger than heaviest_wrench. */
refusal_t check_wrench(const config_t *c, const double *wrench)
{
    refusal_t found = accept();
    for (int k = 0; found.code == ACCEPTED && k < 2 * TIPS; ++k) {
        const double *const x = wrench + 3 * k, most = c->heaviest_wrench[k % 2] * (1.0 + ROUNDED);
        found = check_numbers(wrench, 3 * k, 3, most, ID(POLICY_REFUSED_WRENCH));
        const double size = found.code == ACCEPTED ? norm(3, x) : 0.0;
        found = size > most ? refuse(ID(POLICY_REFUSED_WRENCH), 3 * k, size, most) : found;
    }
    return found;
}
