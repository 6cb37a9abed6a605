/* How much damping a torque that is held for a sample time, and late, can bring. */
#include "shared.h"

/* Return whether a controller's configuration has the numbers that its damping is found from. */
int is_usable(double sample_time, int delay_samples, double damping_ratio, int joints, const double *motor_inertia)
{
    const int timed = sample_time > 0.0 && sample_time <= 1.0 && delay_samples >= 0;
    return timed && all_finite(&damping_ratio, 1) && all_finite(motor_inertia, joints);
}

/* Return the largest eigenvalue of M^-1 B [1/s] that is stable with the torque held for a sample time, and late. */
double most_damping(double sample_time, int delay_samples)
{
    return smaller(0.25, 0.75 / (1.0 + delay_samples)) / sample_time;
}

/*
 * Return the damping b [1/s] for a ratio zeta of a mode x'' = -l x - b x' with eigenvalue l [1/s^2], whose torque is
 * late by t = late [s]. To first order of t the mode is (1 - b t) x'' + (b - l t) x' + l x = 0, and has that ratio for
 * (b - l t)^2 = 4 zeta^2 l (1 - b t): b = sqrt(p^2 + 4 zeta^2 l - l^2 t^2) - p, with p = l t (2 zeta^2 - 1). With less
 * than l t the mode would grow.
 */
double mode_damping(double l, double late, double damping_ratio)
{
    const double zeta = damping_ratio, p = l * late * (2.0 * zeta * zeta - 1.0);
    const double square = p * p + 4.0 * zeta * zeta * l - l * l * late * late;
    return larger(sqrt(larger(square, 0.0)) - p, l * late);
}
