/* The guard: scale and torque that effort, rate and account allow. */
#include "impedance.h"

static const double RELEASE = 0.8;    /* share of the rate limit at which the springs' torque falls after a fault */
enum { ROUNDS = 6 };                  /* of a bisection */

/* Return whether a fault lets the springs hold the arm: the reference stands still until the reset. */
int holds_in_fault(const memory_t *m)
{
    return fault_of_reason(m->fault.reason) == ID(FAULT_COMMUNICATION) && m->watch.known &&
           m->config.communication_reaction != ID(COMMUNICATION_REACTION_RELEASE);
}

/* Return whether a fault leaves no torque, nor the caller's: damping would drive the arm. */
int has_no_torque(int reason) { return fault_of_reason(reason) >= ID(FAULT_DISSIPATION); }

/* Return the scale that effort limits allow beside the other torques; after a fault how far it may fall: fall. */
static double scale_within_bounds(const memory_t *m, const law_t *w, double *fall)
{
    const config_t *const c = &m->config;
    double most = w->cap;
    *fall = 2.0;
    for (int i = 0; i < N; ++i) {
        const double size = fabs(w->pull[i]), side = w->pull[i] > 0.0 ? 1.0 : -1.0;
        const double other = w->zone[i] + w->feedforward[i] + m->caller.offset[i];
        if (size > NO_TORQUE) {
            most = smaller(most, larger(c->effort_limit[i] - side * other, 0.0) / size);
            *fall = smaller(*fall, RELEASE * c->torque_rate_limit[i] * c->sample_time / size);
        }
    }
    return most;
}

/* Vary the scale: what sample time, effort, reserve and tank allow; after a fault to 0 as the torque can follow. */
scale_t vary_scale(const memory_t *m, const law_t *w)
{
    double fall;
    scale_t next = {m->reference.scale, 0u};
    double target = scale_within_bounds(m, w, &fall);
    next.status |= target < w->cap ? (uint32_t)ID(STATUS_SATURATED) : 0u;
    const double covered = covered_share(m, w->pull, COVERED * available(&m->account));
    next.status |= covered < target ? (uint32_t)ID(STATUS_RESERVE) : 0u;
    target = smaller(target, covered);
    if (m->fault.reason != ID(REASON_NONE) && !holds_in_fault(m)) {
        target = smaller(target, larger(next.scale - fall, 0.0));
    }
    const double rise = target - next.scale, most = budget(m);
    double step = smaller(rise, m->config.sample_time / SCALE_TIME);
    if (step > 0.0 && step * w->energy > most) {
        step = (1.0 - ROUNDED) * most / w->energy;
        next.status |= (uint32_t)ID(STATUS_TANK_LIMITED);
    }
    next.scale = step == rise ? target : next.scale + step;
    return next;
}

/* Limit a wanted torque in effort (the caller's has its part first): aim; and in rate: own. NaN becomes 0. */
static uint32_t limit_torque(const memory_t *m, const double *wanted, double *aim, double *own)
{
    const config_t *const c = &m->config;
    uint32_t status = 0u;
    for (int i = 0; i < N; ++i) {
        const double last = m->account.history[i], rate = c->torque_rate_limit[i] * c->sample_time;
        const double most = c->effort_limit[i], offset = m->caller.offset[i];
        const double x = fabs(wanted[i]) <= DBL_MAX ? wanted[i] : 0.0;
        aim[i] = clamp(x, smaller(-most - offset, 0.0), larger(most - offset, 0.0));
        own[i] = clamp(aim[i], last - rate, last + rate);
        status |= aim[i] != x ? (uint32_t)ID(STATUS_SATURATED) : 0u;
        status |= own[i] != aim[i] ? (uint32_t)ID(STATUS_RATE_LIMITED) : 0u;
    }
    return status;
}

/* Let the torque fall to 0 at its rate limit. */
void let_fall(const memory_t *m, torque_t *t)
{
    static const double zero[N] = {0.0};
    (void)limit_torque(m, zero, t->aim, t->own);
    t->hold = 1;
    t->status = 0u;
    t->finding = NOTHING;
    t->reserve = reserve(m, t->own, 1.0);
}

/*
 * Cover a torque by the largest share of the way to it from one that falls to 0. The reserve is convex in the torque,
 * so the covered shares are an interval that begins at 0. Return the share.
 */
static double cover(const memory_t *m, const double *falling, double hold, double *torque)
{
    double trial[N], share = 0.0, step = 0.5;
    for (int round = 0; round < ROUNDS; ++round, step *= 0.5) {
        (void)mix(N, falling, torque, share + step, trial);
        share += reserve(m, trial, hold) <= available(&m->account) ? step : 0.0;
    }
    (void)mix(N, falling, torque, share, trial);
    memcpy(torque, trial, sizeof trial);
    return share;
}

/* Choose the torque: the sum of what is wanted within effort and rate, as far as tank and stored energy cover it. */
void guard(const memory_t *m, const law_t *w, torque_t *t)
{
    const double most = available(&m->account);
    double wanted[N];
    torque_t falling;
    for (int i = 0; i < N; ++i) {
        const int none = has_no_torque(m->fault.reason);
        wanted[i] = none ? 0.0 : m->reference.scale * w->pull[i] + w->zone[i] + w->damper[i] + w->feedforward[i];
    }
    t->hold = m->fault.reason != ID(REASON_NONE) ? 1 : m->config.missed_limit;
    t->status = limit_torque(m, wanted, t->aim, t->own);
    t->finding = NOTHING;
    t->reserve = reserve(m, t->own, t->hold);
    if (t->reserve <= most) {
        return;
    }
    let_fall(m, &falling);
    if (reserve(m, falling.own, t->hold) > most) { /* only a torque that is not held again is covered */
        t->hold = 1;
    }
    const double share = cover(m, falling.own, t->hold, t->own);
    memcpy(t->aim, t->own, sizeof t->aim);
    t->status |= (uint32_t)ID(STATUS_RESERVE);
    t->reserve = reserve(m, t->own, t->hold);
    if (share == 0.0 && m->account.tank < FLOOR * m->config.tank_initial) {
        t->finding = find(ID(REASON_RESERVE), NO_JOINT, t->reserve, most);
    }
}
