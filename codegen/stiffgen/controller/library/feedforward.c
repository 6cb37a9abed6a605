/* Feed-forward: a wrench that the tips are to exert, velocity and acceleration of a plan, Coriolis forces. */
#include "impedance.h"

/* Plan: [s] of a velocity limit that a velocity and the command's motion may disagree by, share of it that velocity and
 * acceleration may, [s] in which a disagreement fades, [s] that a command may stand still with a velocity, and sample
 * times of travel that the equilibrium may be behind. */
static const double PLAN_DRIFT = 0.05, PLAN_JUMP = 0.25, PLAN_MEMORY = 0.5, PLAN_STILL = 0.1, KEPT_UP = 2.0;

/* Return whether numbers are all zero; NaN is not. */
static int are_zero(int count, const double *x)
{
    int zero = 1;
    for (int i = 0; i < count; ++i) {
        zero = zero && x[i] == 0.0;
    }
    return zero;
}

/* Accept the commanded wrenches of all tips. */
static int accept_wrenches(step_t *s)
{
    int good = 1;
    for (int t = 0; t < TIPS; ++t) {
        good = good && accept_wrench(s->c, s->input->wrench_command + 6 * t, t, &s->refusal);
    }
    return good;
}

/*
 * Add to a drift what a plan states less what came of it; both fade with PLAN_MEMORY. Return whether the drift is at
 * most `most`.
 */
static int track_drift(double stated, double made, double elapsed, double most, double *drift)
{
    const double kept = larger(1.0 - elapsed / PLAN_MEMORY, 0.0);
    *drift = clamp(kept * *drift + stated - made, -2.0 * most, 2.0 * most);
    return fabs(*drift) <= most;
}

/* Track how far the velocity of the plan and the motion of the tips' equilibria disagree. Return whether they agree. */
static int track_tips(step_t *s, int *moves)
{
    memory_t *const m = s->m;
    const double *const J = find_jacobians(s);
    double twist[6] = {0.0};
    int agree = 1;
    for (int k = 0; k < 6 * TIPS; ++k) {
        const double most = PLAN_DRIFT * (k % 6 < 3 ? s->c->tip_velocity_limit : s->c->tip_rotation_limit);
        if (k % 6 == 0) {
            pose_difference(m->wanted_equilibrium + 16 * (k / 6), s->goal + 16 * (k / 6), twist);
        }
        const double stated = dot(N, J + k * N, s->input->velocity) * s->elapsed;
        agree &= track_drift(stated, twist[k % 6], s->elapsed, most, &m->tip_drift[k]);
        *moves |= twist[k % 6] != 0.0;
    }
    return agree;
}

/*
 * Track how far the velocity of the plan and the motion of its target disagree, and how long the target has been
 * standing still although the velocity is not zero. Return whether both are as a plan may be.
 */
static int track_target(step_t *s)
{
    const input_t *const in = s->input;
    memory_t *const m = s->m;
    const int by_pose = in->command == ID(COMMAND_EQUILIBRIUM);
    int agree = 1, moves = are_zero(N, in->velocity);
    for (int i = 0; i < N; ++i) {
        const double moved = s->q0[i] - m->wanted_posture[i], most = PLAN_DRIFT * s->c->velocity_limit[i];
        const double stated = by_pose ? moved : in->velocity[i] * s->elapsed;
        agree &= track_drift(stated, moved, s->elapsed, most, &m->posture_drift[i]);
        moves |= moved != 0.0;
    }
    if (by_pose) {
        agree &= track_tips(s, &moves);
    }
    m->plan_still = moves ? 0.0 : m->plan_still + s->elapsed;
    return agree && m->plan_still <= PLAN_STILL;
}

/*
 * Accept velocity and acceleration of a plan: within limits, and in agreement with the motion of the command. A
 * velocity that stays while the command stands still is stale, and so is an acceleration that the velocity does not
 * follow.
 */
static int accept_plan(step_t *s)
{
    const config_t *const c = s->c;
    memory_t *const m = s->m;
    const input_t *const in = s->input;
    const int accelerated = !are_zero(N, in->acceleration), begins = m->planning != in->command;
    int good = 1;
    for (int i = 0; i < N; ++i) {
        good = good && fabs(in->velocity[i]) <= c->reference_velocity_limit[i];
        good = good && fabs(in->acceleration[i]) <= c->reference_velocity_limit[i] / c->ramp_time;
    }
    if (!good) {
        return 0;
    }
    m->planning = in->command == ID(COMMAND_EQUILIBRIUM) ? ID(COMMAND_EQUILIBRIUM) : ID(COMMAND_POSITION);
    if (begins) {
        memset(m->posture_drift, 0, sizeof m->posture_drift);
        memset(m->tip_drift, 0, sizeof m->tip_drift);
        memset(m->velocity_drift, 0, sizeof m->velocity_drift);
        m->plan_still = 0.0;
    } else {
        good = track_target(s);
    }
    for (int i = 0; i < N; ++i) {
        const double most = PLAN_JUMP * c->velocity_limit[i], changed = in->velocity[i] - m->plan_velocity[i];
        const double stated = in->acceleration[i] * s->elapsed;
        m->velocity_drift[i] *= accelerated ? 1.0 : 0.0;
        if (accelerated && !begins) {
            good &= track_drift(stated, changed, s->elapsed, most, &m->velocity_drift[i]);
        }
    }
    memcpy(m->plan_velocity, in->velocity, sizeof m->plan_velocity);
    return good;
}

/* Accept the feed-forward of an accepted command. What is refused counts as not given. */
void accept_feedforward(step_t *s)
{
    const int pressing = !are_zero(6 * TIPS, s->input->wrench_command);
    const int planned = !are_zero(N, s->input->velocity) || !are_zero(N, s->input->acceleration);
    s->pressing = pressing && accept_wrenches(s);
    s->planned = planned && s->commanded && accept_plan(s);
    if ((pressing && !s->pressing) || (planned && s->commanded && !s->planned)) {
        s->status |= ID(STATUS_FEEDFORWARD_REFUSED);
    }
    s->m->planning = planned && s->commanded ? s->m->planning : 0;
    s->pressing = s->pressing && s->commanded;
}

/* Return whether the governor keeps up with the plan: the equilibrium is KEPT_UP sample times of travel behind. */
static int keeps_up(const step_t *s)
{
    const memory_t *const m = s->m;
    const double *const q0 = s->q0;
    double behind = HUGE_VAL;
    if (s->input->command == ID(COMMAND_EQUILIBRIUM)) {
        behind = travel_between(s->c, q0, q0, m->equilibrium, s->goal);
    } else if (m->joined) {
        behind = travel_between(s->c, m->posture, q0, m->equilibrium, NULL);
    }
    return behind <= KEPT_UP * s->c->sample_time;
}

/*
 * Take velocity and acceleration of the reference from the plan where the governor keeps up with it, and compute the
 * torque M ddr that carries the arm. Else the reference has the governor's velocity and no acceleration.
 */
void follow_plan(step_t *s, int moved)
{
    if (!s->planned) {
        return;
    }
    s->planned = moved && keeps_up(s);
    if (!s->planned) {
        s->status |= ID(STATUS_FEEDFORWARD_LIMITED);
        return;
    }
    memcpy(s->out->reference_velocity, s->input->velocity, sizeof s->out->reference_velocity);
    memcpy(s->out->reference_acceleration, s->input->acceleration, sizeof s->out->reference_acceleration);
    multiply_vector(s->out->mass_matrix, s->input->acceleration, s->carried);
}

/*
 * Return the share of the feed-forward that the tank pays for: all of it from 3/4 of the initial energy on, none below
 * one half. The other half stays with the springs.
 */
static double fade_with_tank(const step_t *s)
{
    return clamp(4.0 * s->m->tank / s->tank_initial - 2.0, 0.0, 1.0);
}

/*
 * Return the share of the wrenches that the speed of the tips allows: where contact is lost, a tip must not run away.
 * All of it up to half of tip_velocity_limit and tip_rotation_limit along the wrench, none from the limits on.
 */
static double fade_with_speed(const step_t *s, const double *J)
{
    double most = 0.0;
    for (int k = 0; k < 2 * TIPS; ++k) {
        const double *const part = s->input->wrench_command + 3 * k, size = norm(3, part);
        const double limit = k % 2 == 0 ? s->c->tip_velocity_limit : s->c->tip_rotation_limit;
        double power = 0.0;
        for (int i = 0; i < 3; ++i) {
            power += part[i] * dot(N, J + (3 * k + i) * N, s->velocity);
        }
        most = size > 0.0 ? larger(most, power / (size * limit)) : most;
    }
    return clamp(2.0 - 2.0 * most, 0.0, 1.0);
}

/*
 * Return the largest share of the torque press, up to `most`, beside springs and limit avoidance, that effort limits
 * and reserve allow. The reserve is convex in the share, so a share is allowed below each one that is.
 */
static double share_wrench(const step_t *s, const double *press, double most)
{
    const memory_t *const m = s->m;
    double share = most, base[N], torque[N], parts[3];
    for (int i = 0; i < N; ++i) {
        base[i] = s->out->elastic_torque[i] + s->out->limit_torque[i];
        const double other = base[i] + m->offset[i], size = fabs(press[i]);
        const double room = s->c->effort_limit[i] - (press[i] > 0.0 ? other : -other);
        share = size > NO_TORQUE ? smaller(share, larger(room, 0.0) / size) : share;
    }
    double trial = share, step = 0.5 * share, covered = 0.0;
    for (int round = 0; round < 12 && covered < share; ++round) {
        memcpy(torque, base, sizeof torque);
        add_scaled(N, trial, press, torque);
        const int enough = compute_reserve(s, m->calls, m->call_gap, torque, parts) <= COVERED * available_energy(m);
        covered = enough ? trial : covered;
        trial += enough ? step : -step;
        step *= 0.5;
    }
    return covered;
}

/*
 * Add the torque J^T F of the commanded wrenches F. It begins with no share of the wrench, and falls back to none
 * where no wrench is accepted; the torque follows at its rate limit.
 */
void press_tips(step_t *s)
{
    memory_t *const m = s->m;
    double press[N] = {0.0};
    if (!s->pressing || !m->engaged || m->fault != ID(FAULT_NONE)) {
        m->press_share = 0.0;
        return;
    }
    const double *const J = find_jacobians(s);
    for (int k = 0; k < 6 * TIPS; ++k) {
        add_scaled(N, s->input->wrench_command[k], J + k * N, press);
    }
    const double share = share_wrench(s, press, smaller(fade_with_tank(s), fade_with_speed(s, J)));
    s->status |= share < 1.0 ? (uint32_t)ID(STATUS_FEEDFORWARD_LIMITED) : 0u;
    m->press_share = smaller(share, m->press_share + s->c->sample_time / SCALE_TIME);
    add_scaled(N, m->press_share, press, s->out->feedforward_torque);
    add_scaled(6 * TIPS, m->press_share, s->input->wrench_command, s->out->wrench_command);
}

/*
 * Add the Coriolis and centrifugal forces C(q, dq) dq at the velocity of the damping, so that the arm moves as if its
 * inertia did not change on the way. They do work on the way from one inertia to another: the tank pays, as for
 * wrenches.
 */
void compensate_coriolis(step_t *s)
{
    double forces[N];
    if (s->c->coriolis == ID(CORIOLIS_ON) && s->m->engaged && s->m->fault == ID(FAULT_NONE)) {
        stiffgen_coriolis(s->m->q, s->m, s->velocity, forces);
        add_scaled(N, fade_with_tank(s), forces, s->carried);
    }
}
