/* Torque: springs, feed-forward, damping and limit avoidance, within the reserve and all limits. */
#include "impedance.h"

/* Move a torque one step towards zero at the rate limit. */
void step_towards_zero(const double *last, const double *rate, double *torque)
{
    for (int i = 0; i < N; ++i) {
        torque[i] = last[i] - clamp(last[i], -rate[i], rate[i]);
    }
}

/*
 * Limit the torque, the last guard: finite, within the effort limit (a lowered one comes down at the rate limit) and
 * the rate limit.
 */
void limit_torque(step_t *s, const double *last)
{
    for (int i = 0; i < N; ++i) {
        const double rate = s->m->rate[i], limit = s->c->effort_limit[i], offset = s->m->offset[i];
        /* bounds of the own torque: the caller's offset has its part of the limit first, and 0 is always allowed */
        const double least = smaller(smaller(-limit - offset, 0.0), last[i] + rate);
        const double most = larger(larger(limit - offset, 0.0), last[i] - rate);
        const double wanted = fabs(s->out->torque[i]) <= DBL_MAX ? s->out->torque[i] : 0.0;
        const double possible = clamp(wanted, least, most);
        const double reached = clamp(possible, last[i] - rate, last[i] + rate);
        s->status |= possible != wanted ? (uint32_t)ID(STATUS_SATURATED) : 0u;
        s->status |= reached != possible ? (uint32_t)ID(STATUS_RATE_LIMITED) : 0u;
        s->out->torque[i] = reached;
    }
}

/*
 * Try a torque, limit it, and compute its reserve. springs: share of springs, limit avoidance and commanded wrench; at
 * 0 the torque falls towards zero. damping: share of damping, plan and Coriolis forces, which have none before springs
 * is 1. Return whether the available energy covers the torque.
 */
static int try_torque(step_t *s, const double *last, double springs, double damping)
{
    output_t *const out = s->out;
    double falling[N], parts[3];
    step_towards_zero(last, s->m->rate, falling);
    for (int i = 0; i < N; ++i) {
        const double rate = s->m->rate[i];
        const double pull = out->elastic_torque[i] + out->limit_torque[i] + out->feedforward_torque[i];
        if (springs < 1.0) {
            out->torque[i] = falling[i] + springs * (clamp(pull, last[i] - rate, last[i] + rate) - falling[i]);
        } else {
            out->torque[i] = pull + damping * (out->damping_torque[i] + s->carried[i] + s->motor_damping[i]);
        }
    }
    limit_torque(s, last);
    s->m->reserve = compute_reserve(s, s->m->hold, s->m->call_gap, out->torque, parts);
    return s->m->reserve <= available_energy(s->m);
}

/*
 * Reduce a torque that is not covered to a share in 1/32: of damping, plan and Coriolis forces, if springs and wrench
 * without them are covered, else of springs and wrench alone. feed, the reference's share of damping and plan, is
 * reduced with them.
 */
static void reduce_torque(step_t *s, const double *last, double *feed)
{
    memory_t *const m = s->m;
    double springs = 0.0, damping = 0.0, step = 0.5;
    double *const share = try_torque(s, last, 1.0, 0.0) ? &damping : &springs;
    if (share == &damping) {
        springs = 1.0;
    }
    for (int round = 0; round < 5; ++round) { /* bisection: 2^5 = 32 */
        *share += step;
        if (!try_torque(s, last, springs, damping)) {
            *share -= step;
        }
        step *= 0.5;
    }
    if (!try_torque(s, last, springs, damping)) {
        /* after a long gap only a torque that is not held again may be covered */
        m->hold = 1;
        try_torque(s, last, springs, damping);
    }
    s->status |= ID(STATUS_RESERVE);
    if (springs < 1.0 && m->tank + s->lack < TANK_FLOOR * s->tank_initial) {
        latch_fault(m, ID(REASON_RESERVE), NO_JOINT, m->reserve, available_energy(m));
    }
    for (int i = 0; i < N; ++i) {
        s->out->damping_torque[i] *= damping;
        s->carried[i] *= damping;
        feed[i] *= damping;
    }
}

/*
 * Compute torque pull = -dU/dq and tangent of the springs at the last known position, unscaled. Return the energy of
 * the tips' springs.
 */
static double pull_springs(step_t *s, double *pull)
{
    const memory_t *const m = s->m;
    output_t *const out = s->out;
    const double tips =
        stiffgen_spring(m->q, m, m->equilibrium, m->translation_stiffness, m->rotation_stiffness,
                        find_spring_limits(m), out->spring_wrench, pull, out->joint_stiffness);
    for (int i = 0; i < N; ++i) {
        pull[i] += m->posture_stiffness[i] * (m->posture[i] - m->q[i]);
        out->joint_stiffness[i * (N + 1)] += m->posture_stiffness[i] + s->limit_slope[i];
    }
    return tips;
}

/*
 * Compute the reference's velocity, within its limits: of the posture, or of the equilibrium that moves by poses. It is
 * 0 where the equilibrium was not moved in this step.
 */
static void compute_reference_velocity(step_t *s, int moved)
{
    const double *const limits = s->c->reference_velocity_limit;
    double *const reference = s->out->reference_velocity;
    double twists[TIP_ROWS] = {0.0}, excess = 1.0;
    if (moved && !s->m->joined) {
        (void)compare_poses(s->old_equilibrium, s->m->equilibrium, twists);
        for (int k = 0; k < TIP_ROWS; ++k) {
            twists[k] /= s->c->sample_time;
        }
        follow_twists(s, twists, reference);
        return;
    }
    for (int i = 0; i < N; ++i) {
        reference[i] = moved ? s->m->posture_velocity[i] : 0.0;
        excess = larger(excess, fabs(reference[i]) / limits[i]);
    }
    for (int i = 0; i < N; ++i) {
        reference[i] /= excess;
    }
}

/*
 * Compute the reference's share of the torque, feed = B dr + M ddr, whose work the engagement pays. Where too little is
 * left, that work must not be done: the damper holds the arm as if the reference stood, and feed is 0.
 */
static void feed_reference(step_t *s, double *feed)
{
    output_t *const out = s->out;
    double damper[N];
    multiply_vector(out->damping, out->reference_velocity, damper);
    memcpy(feed, damper, sizeof damper);
    add_scaled(N, 1.0, s->carried, feed);
    if (worst_feed_work(s->m, feed, s->m->call_gap) > s->m->engagement) {
        memset(out->reference_velocity, 0, sizeof out->reference_velocity);
        memset(out->reference_acceleration, 0, sizeof out->reference_acceleration);
        add_scaled(N, -1.0, damper, out->damping_torque);
        memset(s->carried, 0, sizeof s->carried);
        memset(feed, 0, sizeof damper);
        s->status |= ID(STATUS_GOVERNOR);
    }
}

/*
 * Compute the torque at the last known position; moved: the governor has moved the equilibrium in this step. The
 * velocity is smoothed behind design_damping, whose B says how much, and before all that uses it. feed_reference reads
 * carried while it has the plan's M ddr alone: the engagement pays for this, the tank for the Coriolis forces.
 */
void compute_torque(step_t *s, const double *last, int moved)
{
    const config_t *const c = s->c;
    memory_t *const m = s->m;
    output_t *const out = s->out;
    m->hold = m->calls;
    double pull[N], slip[N], feed[N];
    compute_inertia(c, m, m->q, out->mass_matrix);
    const double tips = pull_springs(s, pull), energy = add_posture_energy(m, m->q, m->posture, tips);
    const double cap = design_damping(s);
    learn_friction(s, last);
    if (m->engaged && !s->started) {
        vary_scale(s, pull, energy, cap);
    }
    smooth_velocity(s);
    compute_reference_velocity(s, moved);
    follow_plan(s, moved);
    for (int i = 0; i < N; ++i) {
        slip[i] = out->reference_velocity[i] - s->velocity[i];
        out->elastic_torque[i] = m->scale * pull[i];
    }
    multiply_vector(out->damping, slip, out->damping_torque);
    brake_fast_joints(s);
    for (int k = 0; k < 6 * TIPS; ++k) {
        out->spring_wrench[k] *= m->scale;
    }
    note_load(s, m->scale * larger(tips, 0.0));
    press_tips(s);
    feed_reference(s, feed);
    compensate_coriolis(s);
    plan_gains(s);
    if (m->fault == ID(FAULT_DISSIPATION)) { /* no torque at all */
        memset(out->damping_torque, 0, sizeof out->damping_torque);
        (void)try_torque(s, last, 0.0, 0.0);
    } else if (!try_torque(s, last, 1.0, 1.0)) {
        reduce_torque(s, last, feed);
    }
    shift_history(m, s->transit, feed);
    add_scaled(N, 1.0, s->carried, out->feedforward_torque);
    report_force(s);
}

/*
 * Take the caller's torque out of the last one: the energy account is about the controller's own. A torque in force at
 * the start is the caller's as far as it has the sign of `torque_offset` and is no larger, so that gravity counts once.
 */
void separate_torque_offset(step_t *s, double *last, int refused)
{
    memory_t *const m = s->m;
    const int starts = !refused && !m->known && m->fault == ID(FAULT_NONE) && s->input->sample_valid;
    for (int i = 0; i < N; ++i) {
        if (starts && fabs(s->input->torque_offset[i]) <= DBL_MAX) {
            m->offset[i] = clamp(s->input->torque_offset[i], smaller(last[i], 0.0), larger(last[i], 0.0));
        }
        last[i] -= m->offset[i];
    }
}

/*
 * Add the caller's torque to the controller's own. The own torque goes first in the rate limit, since the reserve
 * counts on its fall; the caller's goes first in the effort limit (limit_torque). Without a position the caller's
 * stays. It goes to zero with a configuration that is refused, and where nothing brakes the arm. last: the own torque
 * of the last call.
 */
void add_torque_offset(step_t *s, const double *last, int refused)
{
    memory_t *const m = s->m;
    const int ends = refused || m->fault == ID(FAULT_DISSIPATION);
    for (int i = 0; i < N; ++i) {
        const double own = s->out->torque[i], change = own - last[i], before = last[i] + m->offset[i];
        double wanted = ends ? 0.0 : m->offset[i];
        if (!ends && (s->believed || s->located) && fabs(s->input->torque_offset[i]) <= DBL_MAX) {
            wanted = s->input->torque_offset[i];
        }
        /* both changes together stay within the rate limit, at which a lowered effort limit is reached, too */
        const double moved = clamp(wanted - m->offset[i], -m->rate[i] - change, m->rate[i] - change);
        const double most = refused ? s->effort[i] : larger(s->c->effort_limit[i], fabs(before) - m->rate[i]);
        const double total = clamp(own + m->offset[i] + moved, -most, most);
        m->offset[i] = total - own;
        const int reached = fabs(m->offset[i] - wanted) <= ROUNDED * larger(1.0, fabs(wanted));
        s->out->offset_torque[i] = m->offset[i];
        s->out->torque[i] = total;
        s->status |= reached ? 0u : (uint32_t)ID(STATUS_OFFSET_LIMITED);
    }
}
