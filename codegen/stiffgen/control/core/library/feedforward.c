/*
 * Feed-forward: a wrench that the tips are to exert, the acceleration of a plan, friction, Coriolis forces. The tank
 * pays.
 */
#include "impedance.h"

static const double COVERING = 0.35; /* of the available energy; springs and damping have the remainder */
static const double SLOW = 0.02;     /* [rad/s] or [m/s] of the reference from which on friction has its full size */
static const double AHEAD = 0.09;    /* [s] for which a braking reference is looked ahead: the arm is behind it */

/*
 * Return the share of the wrenches that the speed of the tips allows: where contact is lost, a tip must not run away.
 * All up to half of tip_velocity_limit along the wrench, none from the limit on.
 */
static double fade_with_speed(const memory_t *m, const double *wrench, const double *J)
{
    double most = 0.0;
    for (int k = 0; k < 2 * TWISTS; ++k) { /* force, moment of each in turn */
        const double *const part = wrench + 3 * k, size = norm(3, part);
        double power = 0.0;
        for (int i = 0; i < 3; ++i) {
            power += part[i] * dot(N, J + (3 * k + i) * N, m->watch.dq);
        }
        most = size > 0.0 ? larger(most, power / (size * m->config.tip_velocity_limit[k % 2])) : most;
    }
    return clamp(2.0 - 2.0 * most, 0.0, 1.0);
}

/* Add the torque J^T F of the commanded wrenches F, by a share that rises from 0 when they begin. */
static void press_tips(const memory_t *m, const command_t *k, double paid, law_t *w)
{
    double J[6 * N * TWISTS];
    stiffgen_jacobians(m->watch.q, m, J);
    const double share = paid * fade_with_speed(m, k->wrench, J);
    w->press = smaller(share, m->reference.press + m->config.sample_time / SCALE_TIME);
    w->status |= share < 1.0 ? (uint32_t)ID(STATUS_FEEDFORWARD_LIMITED) : 0u;
    for (int row = 0; row < 6 * TWISTS; ++row) {
        add_scaled(N, w->press * k->wrench[row], J + row * N, w->feedforward);
    }
}

/* Add the torque M ddr of a plan's acceleration while the reference moves: one that died is not followed. */
static void carry(const memory_t *m, const command_t *k, double paid, const double *inverse, law_t *w)
{
    double half[N], torque[N];
    const int moves = relative_speed(&m->config, m->reference.dr) > 0.0;
    w->status |= !moves || paid < 1.0 ? (uint32_t)ID(STATUS_FEEDFORWARD_LIMITED) : 0u;
    multiply_upper(inverse, k->acceleration, half);
    multiply_lower(inverse, half, torque);
    add_scaled(N, moves ? paid : 0.0, torque, w->feedforward);
}

/*
 * Return the part of a joint's friction that is fed forward, from -1 to 1: by the reference's velocity, at rest 0
 * whatever dq does. It ends before the reference does, by the velocity that a braking one will have after AHEAD: an arm
 * that is behind would be carried beyond q0 (by 4.0 mm, so by 2.6).
 */
static double side_of_friction(const reference_t *f, int i)
{
    const double dr = f->dr[i], later = dr + AHEAD / TREND_TIME * (dr - f->trend[i]);
    return clamp(clamp(later, smaller(dr, 0.0), larger(dr, 0.0)) / SLOW, -1.0, 1.0);
}

/* Compute the feed-forward torque of springs in force, without a fault. inverse: L^-1 with M = L L^T, or NULL. */
void feed_forward(const memory_t *m, const command_t *k, const double *inverse, law_t *w)
{
    memset(w->feedforward, 0, sizeof w->feedforward);
    w->press = 0.0;
    if (!m->reference.engaged || m->fault.reason != ID(REASON_NONE)) {
        return;
    }
    /* the tank pays for all from 3/4 of its initial energy on, for none below 1/2 */
    const double paid = clamp(4.0 * m->account.tank / m->config.tank_initial - 2.0, 0.0, 1.0);
    if (k->pressing) {
        press_tips(m, k, paid, w);
    }
    if (k->planned && inverse != NULL) {
        carry(m, k, paid, inverse, w);
    }
    if (m->config.coriolis == ID(CORIOLIS_ON)) {
        double forces[N];
        stiffgen_coriolis(m->watch.q, m, m->watch.dq, forces);
        add_scaled(N, paid, forces, w->feedforward);
    }
    for (int i = 0; i < N; ++i) {
        w->feedforward[i] += paid * m->config.coulomb_friction[i] * side_of_friction(&m->reference, i);
    }
    const double share = covered_share(m, w->feedforward, COVERING * available(&m->account));
    for (int i = 0; i < N && share < 1.0; ++i) {
        w->feedforward[i] *= share;
    }
    w->press *= share;
    w->status |= share < 1.0 ? (uint32_t)ID(STATUS_FEEDFORWARD_LIMITED) : 0u;
}
