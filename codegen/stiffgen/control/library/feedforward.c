/* Feed-forward: a wrench that the tips are to exert, velocity and acceleration of a plan, Coriolis forces. */
#include "impedance.h"

static const double KEPT_UP = 2.0; /* sample times of travel that the equilibrium may be behind a plan */

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

/* Return whether velocity and acceleration of a plan are within their limits. */
static int accept_plan(const config_t *c, const input_t *in)
{
    int good = 1;
    for (int i = 0; i < N; ++i) {
        good = good && fabs(in->velocity[i]) <= c->reference_velocity_limit[i];
        good = good && fabs(in->acceleration[i]) <= c->reference_velocity_limit[i] / c->ramp_time;
    }
    return good;
}

/* Accept the feed-forward of an accepted command. What is refused counts as not given. */
void accept_feedforward(step_t *s)
{
    const int pressing = !are_zero(6 * TIPS, s->input->wrench_command);
    const int planned = !are_zero(N, s->input->velocity) || !are_zero(N, s->input->acceleration);
    const int good_wrenches = pressing && accept_wrenches(s); /* also beside a refused command: the status tells */
    s->pressing = good_wrenches && s->commanded;
    s->planned = planned && s->commanded && accept_plan(s->c, s->input);
    if ((pressing && !good_wrenches) || (planned && s->commanded && !s->planned)) {
        s->status |= ID(STATUS_FEEDFORWARD_REFUSED);
    }
}

/* Return whether the governor keeps up with the plan: the equilibrium is KEPT_UP sample times of travel behind. */
static int keeps_up(const step_t *s)
{
    const memory_t *const m = s->m;
    const double *const q0 = s->q0;
    double behind = HUGE_VAL, away[TIP_ROWS] = {0.0};
    if (s->input->command == ID(COMMAND_EQUILIBRIUM)) {
        (void)compare_poses(m->equilibrium, s->goal, away);
        behind = travel_between(s->c, q0, q0, away);
    } else if (m->joined) {
        behind = travel_between(s->c, m->posture, q0, away);
    }
    return behind <= KEPT_UP * s->c->sample_time;
}

/*
 * Take velocity and acceleration of the reference from the plan where the equilibrium moves and keeps up with it, and
 * compute the torque M ddr that carries the arm. Else the reference has the governor's velocity and no acceleration: a
 * command that is repeated, as by a planner that died, soon has the equilibrium at rest.
 */
void follow_plan(step_t *s, int moved)
{
    if (!s->planned) {
        return;
    }
    s->planned = moved && (s->status & (uint32_t)ID(STATUS_MOVING)) != 0u && keeps_up(s);
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
    for (int k = 0; k < 2 * TIPS; ++k) { /* force and moment of a tip in turn */
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
        const double room = s->c->effort_limit[i] - (press[i] > 0.0 ? other : -other); /* in press's direction */
        share = size > NO_TORQUE ? smaller(share, larger(room, 0.0) / size) : share;
    }
    double trial = share, step = 0.5 * share, covered = 0.0;
    for (int round = 0; round < 12 && covered < share; ++round) { /* bisection, the whole share first */
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
