/* Twists of the tips, in which lengths and angles count alike. */
#include "follow.h"

/* Let one radian of twists, or of columns of a Jacobian, count as much as RADIAN. */
static void weigh(int columns, double *rows)
{
    for (int r = 0; r < ROWS; ++r) {
        for (int i = 0; i < columns && r % 6 >= 3; ++i) {
            rows[r * columns + i] *= RADIAN;
        }
    }
}

/* Compute the twists [m] that lead the tips from poses to others. */
void compare_poses(const double *from, const double *to, double *twists)
{
    for (int t = 0; t < TIPS; ++t) {
        compare_pose(from + 16 * t, to + 16 * t, twists + 6 * t);
    }
    weigh(1, twists);
}

/* Compute the Jacobian of the twists. */
void weighed_jacobian(const double *q, const double *tool, double *J)
{
    stiffgen_jacobians(q, tool, J);
    weigh(N, J);
}

/* Compute the twists of velocities. */
void multiply(const double *J, const double *velocity, double *twists)
{
    for (int r = 0; r < ROWS; ++r) {
        twists[r] = dot(N, J + r * N, velocity);
    }
}

/* Return the tips' full speed [m/s] in row r of twists, of a translation or a rotation. */
double full_speed(const config_t *c, int r)
{
    return r % 6 < 3 ? c->tip_velocity_limit : RADIAN * c->tip_rotation_limit;
}

/* Return the time [s] that twists take at the tips' full speed; of velocities: their share of it. */
double way_of(const config_t *c, const double *twists)
{
    double most = 0.0;
    for (int r = 0; r < ROWS; r += 3) {
        most = larger(most, norm(3, twists + r) / full_speed(c, r));
    }
    return most;
}
