/* Moves of a pose by a twist: translation, then rotation vector, in base axes. */
#include "settle.h"

static const double NO_TURN = 1e-9; /* [rad] up to which a turn has no axis */

/* Move a pose by a twist: its place by the translation, and turned about the place. */
void move_pose(const double *twist, double *pose)
{
    const double *const w = twist + 3, angle = norm(3, w);
    const double a = angle > NO_TURN ? sin(angle) / angle : 1.0;
    const double half = angle > NO_TURN ? sin(0.5 * angle) / angle : 0.5, b = 2.0 * half * half;
    for (int column = 0; column < 3; ++column) { /* v + a w x v + b w x (w x v) */
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
