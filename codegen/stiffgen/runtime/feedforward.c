/* Feed-forward: a wrench that the tips are to exert. */
#include "impedance.h"

/* Return whether numbers are all zero; NaN is not. */
static int are_zero(int count, const double *x)
{
    int zero = 1;
    for (int i = 0; i < count; ++i) {
        zero = zero && x[i] == 0.0;
    }
    return zero;
}

/* Accept the commanded wrenches: finite, and no larger than heaviest_wrench. The paper's law takes none. */
static int accept_wrench(const step_t *s)
{
    const double *const heaviest = s->c->heaviest_wrench;
    int good = s->c->law == ID(LAW_POTENTIAL);
    for (int t = 0; t < TIPS; ++t) {
        const double *const wrench = s->input->wrench_command + 6 * t;
        good = good && norm(3, wrench) <= heaviest[0] && norm(3, wrench + 3) <= heaviest[1];
    }
    return good;
}

/* Accept the feed-forward of an accepted command. What is refused counts as not given. */
void accept_feedforward(step_t *s)
{
    const int pressing = !are_zero(6 * TIPS, s->input->wrench_command);
    s->pressing = pressing && accept_wrench(s);
    s->status |= pressing && !s->pressing ? (uint32_t)ID(STATUS_FEEDFORWARD_REFUSED) : 0u;
    s->pressing = s->pressing && s->commanded;
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
 * Return the largest share of the torque press, beside springs and limit avoidance, that tank, effort limits and reserve
 * allow. The reserve is convex in the share, so a share is allowed below each one that is.
 */
static double share_wrench(const step_t *s, const double *press)
{
    const memory_t *const m = s->m;
    double share = fade_with_tank(s), base[N], torque[N], parts[3];
    for (int i = 0; i < N; ++i) {
        base[i] = s->out->elastic_torque[i] + s->out->limit_torque[i];
        const double other = base[i] + m->offset[i], size = fabs(press[i]);
        const double room = s->c->effort_limit[i] - (press[i] > 0.0 ? other : -other);
        share = size > 1e-9 ? fmin(share, fmax(room, 0.0) / size) : share;
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
    double J[6 * N * TIPS], press[N] = {0.0};
    if (!s->pressing || !m->engaged || m->fault != ID(FAULT_NONE)) {
        m->press_share = 0.0;
        return;
    }
    robot_jacobians(m->q, m->tool_pose, J);
    for (int k = 0; k < 6 * TIPS; ++k) {
        add_scaled(N, s->input->wrench_command[k], J + k * N, press);
    }
    const double share = share_wrench(s, press);
    s->status |= share < 1.0 ? (uint32_t)ID(STATUS_FEEDFORWARD_LIMITED) : 0u;
    m->press_share = fmin(share, m->press_share + s->c->sample_time / SCALE_TIME);
    add_scaled(N, m->press_share, press, s->out->feedforward_torque);
    add_scaled(6 * TIPS, m->press_share, s->input->wrench_command, s->out->wrench_command);
}
