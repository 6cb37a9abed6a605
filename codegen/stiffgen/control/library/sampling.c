/* Sampling: the largest stiffness and damping that sample time, delay and the smoothed velocity allow. */
#include "impedance.h"

/* Largest eigenvalue of M^-1 B T. With differenced velocity, a double integrator is unstable from M^-1 B T = 2.0, 0.83,
 * 0.53, 0.40, 0.32, 0.26 on at a delay of 0 to 5 samples: the damping has at most 0.475 of it, which is
 * DELAYED_DAMPING / (1 + delay) from 2 samples on. */
static const double LARGEST_DAMPING = 0.25, DELAYED_DAMPING = 0.75;
static const double LARGEST_STIFFNESS = 0.0625; /* largest eigenvalue of M^-1 K T^2 (1 + 2 delay) */
static const double LEAST_RATIO = 0.25; /* damping ratio that the largest damping leaves to the stiffest mode */

/* Return the delay [s] of the smoothed velocity: of the low pass, and of the mean. */
double find_velocity_delay(const config_t *c, const memory_t *m)
{
    return c->velocity_filter_time + 0.5 * m->averaged * c->sample_time;
}

/* Return the largest eigenvalue of M^-1 B that sample time, delay and the smoothed velocity allow [1/s]. */
double largest_damping(const config_t *c, const memory_t *m)
{
    const double share = fmin(LARGEST_DAMPING, DELAYED_DAMPING / (1.0 + c->delay_samples));
    return share / (c->sample_time + find_velocity_delay(c, m));
}

/*
 * Return the largest eigenvalue of M^-1 K that sample time, delay and the smoothed velocity allow [1/s^2]: stiffness
 * alone keeps the loop stable up to LARGEST_STIFFNESS, and the largest damping b, of which l late is lost, has to leave
 * the damping ratio LEAST_RATIO. l is the square of the root of l late + 2 LEAST_RATIO sqrt(l) = b.
 */
double largest_eigenvalue(const config_t *c, const memory_t *m)
{
    const double T = c->sample_time, late = (c->delay_samples + 0.5) * T, b = largest_damping(c, m);
    const double root = (sqrt(LEAST_RATIO * LEAST_RATIO + late * b) - LEAST_RATIO) / late;
    return smaller(LARGEST_STIFFNESS / (T * T * (1.0 + 2.0 * c->delay_samples)), root * root);
}
