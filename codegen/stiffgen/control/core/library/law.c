/* The law: torque of springs, zones and damping at the believed sample. */
#include "impedance.h"

/* Designed damping. */
typedef struct {
    double joint;       /* [N m s/rad] each joint's own */
    double most;        /* [1/s] largest eigenvalue of M^-1 B that the delay allows, less the joints' share */
    double largest;     /* [1/s] largest that a mode has */
    double softness[N]; /* (M^-1)_ii */
} design_t;

/* Compute (M^-1)_ii = |L^-1 e_i|^2, and from their sum what the joints' own damping leaves to the modes. */
static void design_each_joint(const config_t *c, const double *inverse, design_t *d)
{
    const double most = most_damping(c->sample_time, c->delay_samples);
    double trace = 0.0;
    for (int i = 0; i < N; ++i) {
        d->softness[i] = 0.0;
        for (int k = i; k < N; ++k) {
            d->softness[i] += inverse[k * N + i] * inverse[k * N + i];
        }
        trace += d->softness[i];
    }
    d->joint = smaller(JOINT_DAMPING, 0.5 * most / trace);
    d->most = most - d->joint * trace;
    d->largest = 0.0;
}

/* Damp y, parts of a velocity in the modes: an unstable mode as if it were stable. */
static void damp_modes(const config_t *c, const modes_t *modes, double cap, design_t *d, double *y)
{
    const double late = (c->delay_samples + 0.5) * c->sample_time;
    for (int k = 0; k < N; ++k) {
        const double b = clamp(mode_damping(fabs(modes->d[k]) * cap, late, c->damping_ratio), 0.0, d->most);
        y[k] *= b;
        d->largest = larger(d->largest, b);
    }
}

/* Return the scale at which the stiffest mode is one that sample time and delay allow. */
static double find_cap(const config_t *c, const modes_t *modes)
{
    const double most = most_eigenvalue(c);
    double stiffest = 0.0;
    for (int i = 0; i < N; ++i) {
        stiffest = larger(stiffest, modes->d[i]);
    }
    return stiffest > most ? most / stiffest : 1.0;
}

/*
 * Add each joint's own damping of the slip, and brake joints that are faster than SPEED of their velocity limits. The
 * brakes share the damping that the modes leave: an eigenvalue of M^-1 B rises by at most the sum of brake (M^-1)_ii.
 */
static void add_joint_damping(const memory_t *m, const design_t *d, const double *slip, double *damper)
{
    double excess[N]; /* velocity beyond SPEED of the limit */
    int fast = 0;     /* joints that have some */
    for (int i = 0; i < N; ++i) {
        const double limit = SPEED * m->config.velocity_limit[i];
        excess[i] = m->watch.dq[i] - clamp(m->watch.dq[i], -limit, limit);
        fast += excess[i] != 0.0;
    }
    for (int i = 0; i < N; ++i) {
        const double brake = (d->most - d->largest) / d->softness[i];
        damper[i] += d->joint * slip[i] - (excess[i] != 0.0 ? brake * excess[i] / fast : 0.0);
    }
}

/*
 * Damp the modes of Kq v = l M v: B = L f(C) L^T + d I with M = L L^T, C = L^-1 Kq L^-T. inverse: L^-1; K: Kq,
 * overwritten; slip: velocity of the reference less the arm's.
 */
static void damp(const memory_t *m, const double *inverse, double *K, const double *slip, law_t *w)
{
    double y[N]; /* slip, then damping torque, in the modes */
    modes_t modes;
    design_t d;
    design_each_joint(&m->config, inverse, &d);
    form_pencil(inverse, K);
    find_modes(K, &modes);
    w->cap = find_cap(&m->config, &modes);
    w->status |= w->cap < 1.0 ? (uint32_t)ID(STATUS_STIFFNESS_CAPPED) : 0u;
    multiply_upper(inverse, slip, y);
    to_modes(&modes, K, y);
    damp_modes(&m->config, &modes, w->cap, &d, y);
    from_modes(&modes, K, y);
    multiply_lower(inverse, y, w->damper);
    add_joint_damping(m, &d, slip, w->damper);
}

/* Compute the springs' torque with the posture spring's, their energy and tangent, the zones' torque, and the slip. */
static void pull(const memory_t *m, double *K, double *slip, law_t *w)
{
    const reference_t *const f = &m->reference;
    const stiffness_t *const s = &m->stiffness;
    double slope[N];
    w->energy = stiffgen_spring(m->watch.q, m, f->equilibrium, s->translation, s->rotation, w->pull, K);
    (void)zone_energy(m, m->watch.q, w->zone, slope);
    for (int i = 0; i < N; ++i) {
        const double away = f->r[i] - m->watch.q[i], k = s->posture[i];
        w->pull[i] += k * away;
        w->energy += 0.5 * k * away * away;
        K[i * (N + 1)] += k + slope[i];
        slip[i] = f->dr[i] - m->watch.dq[i];
        w->status |= slope[i] > 0.0 ? (uint32_t)ID(STATUS_JOINT_LIMIT) : 0u;
    }
}

/* Compute the wanted torques. Without a positive mass matrix every joint is damped alike. */
void find_law(const memory_t *m, const command_t *k, law_t *w)
{
    double M[NN], K[NN], slip[N];
    w->status = 0u;
    w->cap = 1.0;
    pull(m, K, slip, w);
    mass_with_motors(m, m->watch.q, M);
    const int positive = factorise(M);
    if (positive) {
        invert_triangle(M);
        damp(m, M, K, slip, w);
    } else {
        w->status |= (uint32_t)ID(STATUS_MASS_MATRIX);
        for (int i = 0; i < N; ++i) {
            w->damper[i] = JOINT_DAMPING * slip[i];
        }
    }
    feed_forward(m, k, positive ? M : NULL, w);
}
