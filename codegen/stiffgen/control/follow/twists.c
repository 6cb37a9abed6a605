/* Twists of the tips, in which lengths and angles count alike: six rows per tip, translation before rotation. */
#include "follow.h"

int is_rotation(int row) { return row % 6 >= 3; }

/* Let one radian count as much as RADIAN, in twists (one column) or in a Jacobian. */
static void weigh(int columns, double *rows)
{
    for (int r = 0; r < ROWS; ++r) {
        for (int i = 0; i < columns && is_rotation(r); ++i) {
            rows[r * columns + i] *= RADIAN;
        }
    }
}

/* Compute the twists [m] that lead the tips from poses to others. */
void weighed_twists(const double *from, const double *to, double *twists)
{
    compare_poses(TIPS, from, to, twists);
    weigh(1, twists);
}

/* Compute the Jacobian of the twists. */
void weighed_jacobian(const double *q, const double *tool, double *J)
{
    stiffgen_jacobians(q, tool, J);
    weigh(N, J);
}

/* Compute the twists J velocity. */
void multiply(const double *J, const double *velocity, double *twists)
{
    for (int r = 0; r < ROWS; ++r) {
        twists[r] = dot(N, J + r * N, velocity);
    }
}

/* Return the full speed [m/s] of the translation or rotation that a row of twists belongs to. */
double full_speed(const config_t *c, int row)
{
    return is_rotation(row) ? RADIAN * c->tip_rotation_limit : c->tip_velocity_limit;
}

/* Return twists over full speed, the largest of all tips' parts: ways [m] take this time [s], velocities this share. */
double over_full_speed(const config_t *c, const double *twists)
{
    double most = 0.0;
    for (int r = 0; r < ROWS; r += 3) {
        most = larger(most, norm(3, twists + r) / full_speed(c, r));
    }
    return most;
}
