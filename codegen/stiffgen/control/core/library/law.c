/* The law: torque of springs, zones and damping at the believed sample. */
#include "impedance.h"

/* Damping that is designed: eigenvalues of M^-1 B, the share of the joints alone, and (M^-1)_ii. */
typedef struct {
    double joint, most, largest, softness[N];
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
 * Damp the modes of Kq v = l M v: B = L f(C) L^T + d I with M = L L^T, C = L^-1 Kq L^-T; joints that are faster than
 * SPEED of their limits share the rest of the damping as a brake. inverse: L^-1; K: Kq, overwritten; slip: velocity of
 * the reference less the arm's.
 */
static void damp(const memory_t *m, const double *inverse, double *K, const double *slip, law_t *w)
{
    const config_t *const c = &m->config;
    double y[N];
    modes_t modes;
    design_t d;
    design_each_joint(c, inverse, &d);
    form_pencil(inverse, K);
    find_modes(K, &modes);
    w->cap = find_cap(c, &modes);
    w->status |= w->cap < 1.0 ? (uint32_t)ID(STATUS_STIFFNESS_CAPPED) : 0u;
    multiply_upper(inverse, slip, y);
    to_modes(&modes, K, y);
    damp_modes(c, &modes, w->cap, &d, y);
    from_modes(&modes, K, y);
    multiply_lower(inverse, y, w->damper);
    int fast = 0;
    for (int i = 0; i < N; ++i) {
        fast += fabs(m->watch.dq[i]) > SPEED * c->velocity_limit[i];
    }
    for (int i = 0; i < N; ++i) {
        const double dq = m->watch.dq[i], limit = SPEED * c->velocity_limit[i], excess = dq - clamp(dq, -limit, limit);
        const double brake = (d.most - d.largest) / d.softness[i];
        w->damper[i] += d.joint * slip[i] - (excess != 0.0 ? brake * excess / fast : 0.0);
    }
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
