/*
 * The account: one purse of tank and stored energy A, which covers the most work R of the torques under way. The
 * functions account_ are the only ones that write it. docs/energy.md has the proof.
 */
#include "impedance.h"

/* Return what tank and stored energy have together. */
double available(const account_t *a) { return a->tank + a->springs + a->zones; }

/* Return the sample times from one call to the next, at most. */
int call_gap(const config_t *c) { return c->call_gap_limit < c->missed_limit ? c->call_gap_limit : c->missed_limit; }

/* Return the farthest that joint i is taken to move in a sample time: the velocity limit's motion, or what it does. */
static double farthest(const config_t *c, const double *dq, int i)
{
    return larger(c->velocity_limit[i], fabs(dq[i])) * c->sample_time;
}

/*
 * Sum the most work that a torque can put out, whatever the environment does: those under way once, the torque itself
 * for `hold` calls, and then falling at the rate limit; a call comes every call_gap sample times.
 */
static double worst_work(const account_t *a, const config_t *c, const double *dq, const double *torque, double hold)
{
    const double gap = call_gap(c);
    double sum = 0.0;
    for (int i = 0; i < N; ++i) {
        const double size = fabs(torque[i]), rate = c->torque_rate_limit[i] * c->sample_time;
        double work = gap * size * (hold + 0.5 * size / rate);
        for (int k = 1; k <= c->delay_samples; ++k) {
            work += fabs(a->history[k * N + i]);
        }
        sum += farthest(c, dq, i) * work;
    }
    return sum;
}

/* Return the reserve R that a torque needs. */
double reserve(const memory_t *m, const double *torque, double hold)
{
    return worst_work(&m->account, &m->config, m->watch.dq, torque, hold);
}

/* Return the largest l, at most 1, for which l times a torque needs a reserve of at most `most`: l a + l^2 b. */
double covered_share(const memory_t *m, const double *torque, double most)
{
    static const double nothing[N] = {0.0};
    const config_t *const c = &m->config;
    const double gap = call_gap(c), left = most - reserve(m, nothing, 0.0);
    double a = 0.0, b = 0.0;
    for (int i = 0; i < N; ++i) {
        const double size = fabs(torque[i]), far = farthest(c, m->watch.dq, i);
        a += far * gap * c->missed_limit * size;
        b += far * gap * 0.5 * size * size / (c->torque_rate_limit[i] * c->sample_time);
    }
    if (a + b <= left) {
        return 1.0;
    }
    return left > 0.0 ? 2.0 * left / (a + sqrt(a * a + 4.0 * b * left)) : 0.0;
}

/* Return what moves, stiffness and scale may cost: the tank above its floor. */
double budget(const memory_t *m) { return larger(m->account.tank - FLOOR * m->config.tank_initial, 0.0); }

/* Pay an income (a cost, where negative) into the tank; what a full one cannot hold, and no torque needs, is lost. */
static void account_pay(account_t *a, const memory_t *m, double income)
{
    const double before = a->tank, after = before + income, full = m->config.tank_initial;
    if (after > full && income > 0.0) {
        const double needed = worst_work(a, &m->config, m->watch.dq, a->history, a->hold);
        a->tank = smaller(after, larger(larger(full, needed), before));
    } else {
        a->tank = after;
    }
}

/* Open the account at init: a torque in force has been in transit, and its reserve is supplied. */
void account_open(account_t *a, const config_t *c, const double *torque)
{
    static const double at_rest[N] = {0.0};
    for (int k = 0; k < DELAYS; ++k) {
        memcpy(a->history + k * N, torque, N * sizeof *torque);
    }
    a->hold = 1;
    a->supplied = worst_work(a, c, at_rest, torque, 1.0);
}

/* Pass sample times: sum the torques that acted in them. Those beyond the delay are alike. */
void account_time(account_t *a, const config_t *c, int periods)
{
    const double *const acting = a->history + c->delay_samples * N;
    for (int k = 0; k <= DELAYS && k < periods; ++k) {
        const int count = k == DELAYS ? periods - k : 1;
        for (int i = 0; i < N; ++i) {
            const double before = a->gap == 0 ? acting[i] : a->gap_torque[i];
            a->gap_change[i] = (a->gap == 0 ? 0.0 : a->gap_change[i]) + fabs(acting[i] - before) * a->gap;
            a->gap_total[i] = (a->gap == 0 ? 0.0 : a->gap_total[i]) + fabs(acting[i]) * count;
            a->gap_torque[i] = acting[i];
        }
        a->gap = count_up(a->gap, count);
        memmove(a->history + N, a->history, (DELAYS - 1) * N * sizeof *a->history);
    }
}

/*
 * Book the torques' work since the last believed sample, and what springs and zones store at q. The work is the smaller
 * of two bounds: by the change of q and the changes of torque, or by the torques alone. A continuous joint that can
 * have passed half a turn leaves its turn open: then q says nothing.
 */
void account_interval(account_t *a, const memory_t *m, const double *q, double springs, double zones)
{
    const config_t *const c = &m->config;
    double changes = 0.0, most = 0.0;
    for (int i = 0; i < N; ++i) {
        const double moved = q[i] - m->watch.q[i];
        const double far = larger(c->velocity_limit[i] * c->sample_time, fabs(moved) / a->gap);
        const int open = stiffgen_turns(i) && far * a->gap >= 0.5 * TURN;
        changes += a->gap_torque[i] * moved + (open ? HUGE_VAL : a->gap_change[i] * far);
        most += a->gap_total[i] * far;
    }
    const double work = smaller(changes, most), rise = springs - a->springs + (zones - a->zones);
    a->springs = springs;
    a->zones = zones;
    a->gap = 0;
    account_pay(a, m, -work - rise);
}

/* Begin the account at a first sample: all that is in it now is supplied, and the reserve of the torque in force. */
void account_start(account_t *a, const memory_t *m, double zones)
{
    a->tank = m->config.tank_initial + worst_work(a, &m->config, m->watch.dq, a->history, 1.0);
    a->springs = 0.0;
    a->zones = zones;
    a->supplied += a->tank + zones;
    a->gap = 0;
}

/* Fill the tank at a start of the springs. */
void account_engage(account_t *a, const memory_t *m)
{
    const double lack = larger(m->config.tank_initial - a->tank, 0.0);
    a->tank += lack;
    a->supplied += lack;
}

/* Book a move of the reference; its travel supplies what the tank lacks, at most the power of heaviest_wrench. */
void account_move(account_t *a, const memory_t *m, const move_t *g)
{
    const config_t *const c = &m->config;
    const double powers[2] = {c->heaviest_wrench[0] * c->tip_velocity_limit[0],
                              c->heaviest_wrench[1] * c->tip_velocity_limit[1]};
    a->springs += g->rise;
    account_pay(a, m, -g->rise);
    const double lack = clamp(c->tank_initial - a->tank, 0.0, GOVERNOR * norm(2, powers) * g->travel);
    a->tank += lack;
    a->supplied += lack;
}

/* Book a change of stiffness or scale after which the springs store `springs`. */
void account_springs(account_t *a, const memory_t *m, double springs)
{
    const double rise = springs - a->springs;
    a->springs = springs;
    account_pay(a, m, -rise);
}

/* Release the springs without a sample: the tank's maximum waits until the work since the last one is booked. */
void account_release(account_t *a)
{
    a->tank += a->springs;
    a->springs = 0.0;
}

/* Book the torque that is put out from now on. */
void account_torque(account_t *a, const torque_t *t)
{
    memcpy(a->history, t->own, N * sizeof *a->history);
    a->hold = t->hold;
}
