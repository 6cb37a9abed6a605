/* Energies of springs and limit zones, and what sample time and delay allow of stiffness and damping. */
#include "impedance.h"

static const double ZONE = 0.1; /* [rad] or [m] width of a limit zone, or this share of a short range */

/* Energy of springs at a position, with their reference and stiffness, at scale 1. */
double spring_energy(const memory_t *m, const double *q, const double *r, const double *poses, const stiffness_t *K)
{
    double twice = 0.0;
    for (int i = 0; i < N; ++i) {
        const double away = q[i] - r[i];
        twice += K->posture[i] * away * away;
    }
    return stiffgen_spring_energy(q, m, poses, K->translation, K->rotation) + 0.5 * twice;
}

/* Energy of the zones inside the joint limits; pull and slope of each. A zone pulls with at most the effort limit. */
double zone_energy(const memory_t *m, const double *q, double *pull, double *slope)
{
    const double *const lower = m->arm.zone, *const upper = lower + N, *const stiffness = upper + N;
    double energy = 0.0;
    for (int i = 0; i < N; ++i) {
        const double depth = q[i] - clamp(q[i], lower[i], upper[i]), most = m->config.effort_limit[i];
        const double force = stiffness[i] * depth;
        const int linear = fabs(force) > most;
        pull[i] = -clamp(force, -most, most);
        slope[i] = depth != 0.0 && !linear ? stiffness[i] : 0.0;
        energy += linear ? most * (fabs(depth) - 0.5 * most / stiffness[i]) : 0.5 * force * depth;
    }
    return energy;
}

/* Return the largest eigenvalue of M^-1 K [1/s^2] that sample time and delay allow beside this damping. */
double most_eigenvalue(const config_t *c)
{
    const double T = c->sample_time, late = (c->delay_samples + 0.5) * T, b = most_damping(T, c->delay_samples);
    const double root = (sqrt(0.0625 + late * b) - 0.25) / late;
    return smaller(0.0625 / (T * T * (1.0 + 2.0 * c->delay_samples)), root * root);
}

/* Return how far q is beyond the limits of joint i; negative between them. */
double beyond(const config_t *c, int i, double q)
{
    return larger(c->lower_limit[i] - q, q - c->upper_limit[i]);
}

/* Return q of a continuous joint on the turn that is nearest to another position. */
double nearest_turn(int i, double q, double other)
{
    return stiffgen_turns(i) ? q + TURN * floor((other - q) / TURN + 0.5) : q;
}

/* Compute the mass matrix with the motors' inertia. */
void mass_with_motors(const memory_t *m, const double *q, double *M)
{
    stiffgen_mass_matrix(q, m, M);
    for (int i = 0; i < N; ++i) {
        M[i * (N + 1)] += m->config.motor_inertia[i];
    }
}

/* Return the inertia of joint i beside any motion of the others: 1 / (sum over j of |(M^-1)_ij|). inverse: L^-1. */
static double free_inertia(const double *inverse, int i)
{
    double sum = 0.0;
    for (int j = 0; j < N; ++j) {
        double entry = 0.0;
        for (int k = i > j ? i : j; k < N; ++k) {
            entry += inverse[k * N + i] * inverse[k * N + j];
        }
        sum += fabs(entry);
    }
    return 1.0 / sum;
}

/* Place the limit zones: their stiffness is what rate limit, damping and sample time follow, by the inertia at q. */
void place_zones(const memory_t *m, const double *q, arm_t *arm)
{
    const config_t *const c = &m->config;
    double M[NN];
    mass_with_motors(m, q, M);
    const int positive = factorise(M);
    if (positive) {
        invert_triangle(M);
    }
    for (int i = 0; i < N; ++i) {
        const double rate = c->torque_rate_limit[i], range = c->upper_limit[i] - c->lower_limit[i];
        const double width = smaller(ZONE, ZONE * range), share = rate / (2.0 * width);
        const double inertia = positive ? free_inertia(M, i) : c->motor_inertia[i];
        const double damped = smaller(c->effort_limit[i], 0.5 * most_eigenvalue(c) * inertia);
        arm->zone[i] = c->lower_limit[i] + width;
        arm->zone[N + i] = c->upper_limit[i] - width;
        arm->zone[2 * N + i] = smaller(smaller(damped, rate / c->velocity_limit[i]), cbrt(inertia * share * share));
    }
}
