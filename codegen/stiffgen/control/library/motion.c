/* Motion: whether a joint that stands still can do so under the torque that acts, for velocities that are differences
 * of the positions. */
#include "impedance.h"

/* Friction that slides with F holds up to 1.5 F, and a sixth more. Before a joint has moved for FRICTION_TIME its
 * friction is a share of the effort limit, and never less than another. */
static const double FRICTION_RANGE = 1.75, UNKNOWN_FRICTION = 0.03, LEAST_FRICTION = 0.005;
static const double FRICTION_TIME = 0.25, FRICTION_MEMORY = 2.0; /* [s] of motion; [s] of its mean */
static const double HELD_BEFORE = 1.25; /* torque that was held before explains so many times itself */
static const double STOPPED_BY = 0.3; /* share of a joint's momentum that a torque from outside has taken */
static const double GIVES_WAY = 0.05; /* share of the effort limit that no contact holds to the last bit */
static const double HARDEST = 5e4, COARSE = 1e-5; /* [N m/rad] hardest contact; [rad] quantum that is not declared */
static const double REST_MEMORY = 1.0; /* [s] in which predicted motion fades: noise does not add up */
static const double LEAST_QUANTUM = 1e-7; /* [rad] or [m] up to which a position is the same */
static const double LOAD_TIME = 0.02; /* [s] low pass on the torque that is not explained */
static const double SLOW = 0.01; /* [rad/s] or [m/s] from which on a joint shows its friction */
static const double STILL_TIME = 0.02; /* [s] for which a position may be the same to the last bit under any torque */

/* Return the controller's torque on joint i in the interval that ends now. */
static double find_own_torque(const memory_t *m, const double *last, int i)
{
    return m->delay == 0 ? last[i] : m->older[(m->delay - 1) * N + i];
}

/* Return the torque of the environment on joint i; 0 if it is not known. */
static double find_external(const step_t *s, int i)
{
    return s->has_external ? s->input->external_torque[i] : 0.0;
}

/*
 * Return what is left of a torque beside the environment's: that one can cancel it down to 0, but neither add to it nor
 * turn its sign.
 */
static double explain(double torque, double external)
{
    return torque + clamp(external, smaller(-torque, 0.0), larger(-torque, 0.0));
}

/* Return the torque that both of two readings agree on: the smaller one, or 0 if their signs differ. */
static double agree(double a, double b)
{
    return clamp(a, smaller(b, 0.0), larger(b, 0.0));
}

/* Return whether joint i has moved for long enough to show its friction. */
static int knows_friction(const memory_t *m, int i)
{
    return m->moving_time[i] >= FRICTION_TIME;
}

/*
 * Return the torque that friction may hold on joint i: what it has been seen to hold, what the joint's motion has
 * shown, or before any motion a share of the effort limit.
 */
static double find_held_torque(const step_t *s, int i)
{
    const memory_t *const m = s->m;
    const double effort = s->c->effort_limit[i], shown = FRICTION_RANGE * m->friction[i];
    const double least = knows_friction(m, i) ? LEAST_FRICTION : UNKNOWN_FRICTION;
    return larger(larger(least * effort, shown), HELD_BEFORE * m->held_torque[i]);
}

/* Begin a standstill of joint i at its position, or between it and the one before; speed: with which it came. */
static void begin_standstill(step_t *s, int i, double own, double speed)
{
    memory_t *const m = s->m;
    m->rest_other[i] = m->rest_q[i];
    m->rest_q[i] = s->q[i];
    m->rest_torque[i] = own;
    m->rest_external[i] = find_external(s, i);
    /* What is left of the unexplained torque without the friction of this motion is a load that stays. */
    const double friction = m->dq[i] != 0.0 ? copysign(m->friction[i], m->dq[i]) : 0.0;
    m->rest_load[i] = knows_friction(m, i) ? m->unexplained[i] + friction : 0.0;
    m->rest_speed[i] = speed;
    m->rest_change[i] = m->rest_travel[i] = m->alone_speed[i] = m->alone_travel[i] = 0.0;
}

/*
 * Return whether joint i stands still: its position is one of two values (one bit may toggle) up to position_quantum.
 * At a third value the standstill ends, and another one begins.
 */
static int stands_still(step_t *s, int i, double own, double elapsed)
{
    memory_t *const m = s->m;
    const double q = s->q[i], quantum = larger(s->c->position_quantum, LEAST_QUANTUM);
    if (!m->known || m->reset) {
        begin_standstill(s, i, own, 0.0);
        return 0;
    }
    if (fabs(q - m->rest_q[i]) <= quantum || fabs(q - m->rest_other[i]) <= quantum) {
        return 1;
    }
    /* it moves after all, so that friction has held the torque of the standstill; before rest_change begins anew */
    if (m->fault == ID(FAULT_NONE)) {
        m->held_torque[i] = larger(m->held_torque[i], m->rest_change[i]);
    }
    /* One change of a coarse position, or of a velocity that is filtered, is not yet a speed. */
    const double measured = (q - m->still_q[i]) / elapsed, filtered = m->dq[i];
    const double least = smaller(fabs(measured), fabs(filtered));
    begin_standstill(s, i, own, measured * filtered > 0.0 ? copysign(least, measured) : 0.0);
    return 0;
}

/* Return whether two positions are the same to the last bit, but for one bit that may differ. */
static int is_same(double a, double b)
{
    uint64_t bits_a, bits_b;
    memcpy(&bits_a, &a, sizeof a);
    memcpy(&bits_b, &b, sizeof b);
    const uint64_t differ = bits_a ^ bits_b;
    return (differ & (differ - 1u)) == 0u; /* no bit is set, or one */
}

/*
 * Return the range of the controller's torque for which joint i's position has been the same to the last bit (one bit
 * may toggle); 0 until that has lasted for STILL_TIME. A sound encoder shows how far a joint gives way even under
 * friction, in a clamp or at a stop; a frozen one does not. In another fault the torque falls while brakes may hold.
 */
static double find_still_range(step_t *s, int i, double own, double elapsed)
{
    memory_t *const m = s->m;
    const double q = s->q[i], longest = larger(STILL_TIME, 2.0 * s->c->state_period);
    const int judged = m->fault == ID(FAULT_NONE) || m->reason == ID(REASON_FROZEN);
    const int same = q == m->still_value[i] || (q == m->still_other[i] && is_same(q, m->still_value[i]));
    if (!m->known || m->reset || !judged || !same) {
        m->still_other[i] = m->still_value[i];
        m->still_value[i] = q;
        m->still_time[i] = 0.0;
        m->still_least[i] = m->still_most[i] = own;
        return 0.0;
    }
    m->still_time[i] = smaller(m->still_time[i] + elapsed, longest);
    m->still_least[i] = smaller(m->still_least[i], own);
    m->still_most[i] = larger(m->still_most[i], own);
    return m->still_time[i] < (1.0 - ROUNDED) * longest ? 0.0 : m->still_most[i] - m->still_least[i];
}

/*
 * Predict the motion of a joint that stands still, from the change of its torque, friction and inertia alone: no signal
 * of the position enters. Predicted motion fades, so that noise does not add up.
 */
static void predict_motion(double torque, double held, double inertia, double elapsed, double *speed, double *travel)
{
    const double friction = held * elapsed / inertia, push = *speed + torque * elapsed / inertia; /* speeds */
    *speed = push - clamp(push, -friction, friction); /* friction slows it down, and never reverses it */
    *travel += *speed * elapsed - *travel * elapsed / (elapsed + REST_MEMORY);
}

/*
 * Predict for each joint that stands still how far the torque must have moved it. What the environment is said to hold
 * counts, but not to the last bit while the arm moves: every contact gives way (alone), the hardest by a quantum.
 */
void predict_standstills(step_t *s, const double *last, double elapsed)
{
    memory_t *const m = s->m;
    int moves = 0;
    for (int i = 0; i < N; ++i) {
        moves |= fabs(s->q[i] - m->still_q[i]) > SLOW * elapsed;
    }
    for (int i = 0; i < N; ++i) {
        const double own = find_own_torque(m, last, i), effort = s->c->effort_limit[i];
        const double quantum = larger(s->c->position_quantum, COARSE);
        s->travel[i] = 0.0;
        s->range[i] = find_still_range(s, i, own, elapsed);
        s->stands[i] = stands_still(s, i, own, elapsed);
        if (!s->stands[i] || !(m->mass[i] > 0.0)) {
            continue;
        }
        const double acting = own + m->rest_load[i], change = own - m->rest_torque[i];
        const double external = find_external(s, i), external_change = external - m->rest_external[i];
        const double held = find_held_torque(s, i);
        /* What acts now must move the joint, and so must what has changed since the joint stood still. */
        const double left = agree(explain(acting, external), explain(change, external_change));
        if (fabs(external_change) * elapsed > STOPPED_BY * m->mass[i] * fabs(m->rest_speed[i])) {
            m->rest_speed[i] = 0.0; /* it was stopped from outside */
        }
        m->rest_change[i] = larger(m->rest_change[i], fabs(left));
        predict_motion(left, held, m->mass[i], elapsed, &m->rest_speed[i], &m->rest_travel[i]);
        if (moves) {
            const double held_alone = larger(held, smaller(GIVES_WAY * effort, HARDEST * quantum));
            predict_motion(agree(acting, change), held_alone, m->mass[i], elapsed, &m->alone_speed[i],
                           &m->alone_travel[i]);
        }
        s->travel[i] = larger(fabs(m->rest_travel[i]), fabs(m->alone_travel[i]));
    }
}

/*
 * Fit dry + viscous friction, |unexplained| = F + D |dq|, to the motion of joint i: only F holds a joint that stands
 * still. share: of this sample in the means.
 */
static void learn_dry_friction(memory_t *m, int i, double share)
{
    const double torque = fabs(m->unexplained[i]), speed = fabs(m->dq[i]);
    m->mean_torque[i] += share * (torque - m->mean_torque[i]);
    m->mean_speed[i] += share * (speed - m->mean_speed[i]);
    m->mean_square[i] += share * (speed * speed - m->mean_square[i]);
    m->mean_power[i] += share * (torque * speed - m->mean_power[i]);
    /* covariance and variance of a least-squares line */
    const double variance = m->mean_square[i] - m->mean_speed[i] * m->mean_speed[i];
    const double covariance = m->mean_power[i] - m->mean_torque[i] * m->mean_speed[i];
    const int rises = covariance > 0.0 && variance > ROUNDED * m->mean_square[i];
    const double viscous = rises ? covariance / variance * m->mean_speed[i] : 0.0;
    m->friction[i] = larger(m->mean_torque[i] - viscous, 0.0);
}

/*
 * Learn from the motion of each joint which torque the mass matrix does not explain: friction, viscous or dry, and a
 * load that is not measured.
 */
void learn_friction(step_t *s, const double *last)
{
    memory_t *const m = s->m;
    if (s->c->velocity_source != ID(VELOCITY_SOURCE_DIFFERENCED)) {
        return;
    }
    double momentum[N];
    const double T = s->elapsed, low_pass_share = T / (T + LOAD_TIME);
    const double quantum_speed = larger(s->c->position_quantum, LEAST_QUANTUM) / T;
    multiply_vector(s->out->mass_matrix, m->dq, momentum);
    for (int i = 0; i < N; ++i) {
        /* rate of momentum = own + external + unexplained torque */
        const double own = find_own_torque(m, last, i), rate = (momentum[i] - m->momentum[i]) / T;
        const double unexplained_now = explain(rate - own, -find_external(s, i));
        /* A bit that toggles has a velocity, too, but is no motion. */
        const int moves = !s->stands[i] && fabs(m->dq[i]) > larger(4.0 * quantum_speed, SLOW);
        if (s->believed && m->mass[i] > 0.0) {
            m->unexplained[i] += low_pass_share * (unexplained_now - m->unexplained[i]);
        }
        if (moves && s->believed && m->fault == ID(FAULT_NONE)) {
            /* The mean over the motion, which forgets what is older than FRICTION_MEMORY. */
            m->moving_time[i] = smaller(m->moving_time[i] + T, FRICTION_MEMORY);
            learn_dry_friction(m, i, T / m->moving_time[i]);
        }
        /* for the next interval */
        m->momentum[i] = momentum[i];
        m->mass[i] = s->out->mass_matrix[i * (N + 1)];
    }
}
