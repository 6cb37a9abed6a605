/* Samples: what time it is, and whether a measurement is believed. */
#include "impedance.h"

/* Motion that dq and q may disagree by in a sample: share of the velocity limit, share of the motion itself. */
static const double DISAGREED_LIMIT = 0.5, DISAGREED_MOTION = 0.3;
static const double FASTEST = 1e3;   /* velocity limits that a dq may have: a faster one is no measurement */
static const double JUMP = 10.0;     /* velocity limits from which on a change of q is none */
static const double RESTING = 0.02;  /* share of the velocity limit that q and dq may differ by for long */
static const double SAME = 1e-15;    /* relative change of q that is a toggling last bit */
static const double FINE = 1e-6;     /* [rad] or [m] coarsest resolution that shows how far a joint gives way */
static const double STILL_TIME = 0.02, STILL_RANGE = 0.03; /* [s]; share of the effort limit: then q is frozen */
enum { WINDOW = 20 }; /* samples for which a value may stand still before it is judged */
enum { LOST_SAMPLES = 10 }; /* samples in a row that are a communication fault */

/*
 * Count the sample times since the last call by a clock; 0 where it stands still. A call that is early counts as the
 * next sample, and the clock's lead is carried on.
 */
static int count_time(double time, double sample_time, watch_t *w)
{
    const double elapsed = (time - w->time) / sample_time;
    const double lead = smaller(w->lead + elapsed, LONGEST), ahead = larger(floor(lead + 0.5), 1.0);
    if (!(elapsed > 0.0)) {
        return 0;
    }
    w->lead = larger(lead - ahead, -1.0);
    return (int)ahead;
}

/* Count the sample times since the last call by the clock that is in use; 0 for another one. */
static int count_periods(const config_t *c, const input_t *in, watch_t *w)
{
    if (w->seen != in->clock) {
        return w->seen == 0; /* the first call */
    }
    if (in->clock == ID(CLOCK_TIME)) {
        return count_time(in->time, c->sample_time, w);
    }
    const int32_t ahead = (int32_t)(in->counter - w->counter); /* unsigned, as the counter wraps */
    return ahead < LONGEST ? ahead : LONGEST;
}

/*
 * Count the sample times since the last call; 0 where the clock stands still, goes back, changes its kind, or is not
 * given. While no account is kept each call counts one, and a clock that begins anew counts from the call after.
 */
static int read_clock(const config_t *c, const input_t *in, watch_t *w)
{
    if (in == NULL || check_clock(in).reason != ID(REFUSAL_NONE)) {
        return 0;
    }
    const int same = w->seen == in->clock, periods = count_periods(c, in, w);
    if (periods > 0 || !w->known) {
        w->seen = in->clock == ID(CLOCK_TIME) ? ID(CLOCK_TIME) : ID(CLOCK_COUNTER);
        w->counter = in->counter;
        w->time = in->clock == ID(CLOCK_TIME) ? in->time : 0.0;
        w->lead = same && periods > 0 ? w->lead : 0.0;
    }
    if (periods <= 0) {
        return 0;
    }
    return w->known ? periods : 1;
}

/*
 * Sum in watch.moved the difference of the motions of q and dq [rad or m] while one of them stands still, and return
 * its size. Up to `allowed` per sample is noise, resolution or bias of dq, which therefore does not add up at rest.
 */
static double sum_difference(const watch_t *before, int i, double T, double differs, double allowed, sample_t *s)
{
    watch_t *const w = &s->watch;
    const double same = SAME * fabs(s->q[i]); /* and a velocity that differs by this in a sample follows from it */
    const int q_changed = fabs(s->q[i] - before->q[i]) > same;
    const int dq_changed = fabs(s->dq[i] - before->dq[i]) * T > 4.0 * same;
    w->q_age[i] = q_changed ? 0 : count_up(before->q_age[i], 1);
    w->dq_age[i] = dq_changed ? 0 : count_up(before->dq_age[i], 1);
    const double sum = before->moved[i] + differs;
    const int still = w->q_age[i] > WINDOW || w->dq_age[i] > WINDOW;
    w->moved[i] = still ? sum - clamp(sum, -allowed, allowed) : 0.0;
    return fabs(w->moved[i]);
}

/*
 * Widen the range of torques [N m] under which neither q nor dq changed a bit, and return its width; 0 until that has
 * lasted for STILL_TIME. A sound encoder shows how far a joint gives way even under friction, in a clamp or at a stop;
 * a frozen one does not, nor a velocity that follows from it. In a fault, when brakes may hold the joint, it is empty.
 */
static double widen_still_range(const memory_t *m, int i, watch_t *w)
{
    const double acting = m->account.history[i] + m->caller.offset[i];
    const int begins = w->q_age[i] <= 1 || m->fault.reason != ID(REASON_NONE);
    w->still_least[i] = begins ? acting : smaller(w->still_least[i], acting);
    w->still_most[i] = begins ? acting : larger(w->still_most[i], acting);
    const int age = w->q_age[i] < w->dq_age[i] ? w->q_age[i] : w->dq_age[i];
    const int long_enough = age * m->config.sample_time >= (1.0 - ROUNDED) * STILL_TIME;
    return long_enough ? w->still_most[i] - w->still_least[i] : 0.0;
}

/* Find a joint whose q and dq move apart by more than drift and resolution, or hold still to the bit under a torque. */
static finding_t find_frozen(const memory_t *m, int i, double differs, double elapsed, sample_t *s)
{
    const config_t *const c = &m->config;
    const double drift = larger(RESTING * c->velocity_limit[i], c->velocity_noise);
    const double limit = larger(4.0 * c->position_quantum, drift * WINDOW * c->sample_time);
    const double moved = sum_difference(&m->watch, i, c->sample_time, differs, drift * elapsed, s);
    const double range = widen_still_range(m, i, &s->watch), widest = STILL_RANGE * c->effort_limit[i];
    if (moved > limit) {
        return find(ID(REASON_FROZEN), i, moved, limit);
    }
    const int frozen = range > widest && c->position_quantum <= FINE;
    return frozen ? find(ID(REASON_FROZEN), i, range, widest) : NOTHING;
}

/* Check joint i: numbers, then q and dq against each other and the last position. q is on the turn nearest to it. */
static finding_t check_joint(const memory_t *m, const input_t *in, int i, sample_t *s)
{
    const config_t *const c = &m->config;
    const double limit = c->velocity_limit[i], dq = in->dq[i];
    if (!(fabs(in->q[i]) <= FARTHEST && fabs(dq) <= FASTEST * limit)) {
        return find(ID(REASON_NOT_FINITE), i, fabs(in->q[i]) <= FARTHEST ? dq : in->q[i], 0.0);
    }
    s->dq[i] = dq;
    s->q[i] = m->watch.known ? nearest_turn(i, in->q[i], m->watch.q[i]) : in->q[i];
    if (!m->watch.known) {
        return NOTHING;
    }
    const double elapsed = c->sample_time * (m->account.gap + s->periods), moved = s->q[i] - m->watch.q[i];
    const double far = limit * elapsed, quanta = 2.0 * c->position_quantum, differs = dq * elapsed - moved;
    const double noise = NOISE_RANGE * c->velocity_noise * elapsed;
    const double allowed = larger(DISAGREED_LIMIT * far, DISAGREED_MOTION * fabs(moved)) + quanta + noise;
    const finding_t frozen = find_frozen(m, i, differs, elapsed, s);
    if (fabs(moved) > JUMP * far + quanta) {
        return find(ID(REASON_JUMP), i, fabs(moved), JUMP * far + quanta);
    }
    if (fabs(differs) > allowed) {
        return find(ID(REASON_MISMATCH), i, fabs(differs) / elapsed, allowed / elapsed);
    }
    return frozen;
}

/* Check a sample: why it is not believed, or REASON_NONE. */
static finding_t check_sample(const memory_t *m, const input_t *in, sample_t *s)
{
    finding_t found = NOTHING;
    for (int i = 0; found.reason == ID(REASON_NONE) && i < N; ++i) {
        found = check_joint(m, in, i, s);
    }
    if (found.reason == ID(REASON_NONE) && !stiffgen_follow(s->q, m, s->joints)) {
        return find(ID(REASON_LOOPS), NO_JOINT, 0.0, 0.0);
    }
    return found;
}

/*
 * Judge what is missing. Two bad samples of three lose the position, and a clock that stands still while the torque
 * would fall loses the time: the account then ends, the torque goes to zero, and a reset begins anew.
 */
static finding_t judge_losses(const memory_t *m, const sample_t *s, finding_t found)
{
    const config_t *const c = &m->config;
    const int calls = c->missed_limit * call_gap(c);
    if (found.reason != ID(REASON_NONE) && (s->watch.bad & (s->watch.bad - 1)) != 0) { /* more than one bit is set */
        return found;
    }
    if (m->watch.known && s->periods == 0 && s->watch.missed >= m->account.hold) {
        return find(ID(REASON_CLOCK), NO_JOINT, 0.0, 0.0);
    }
    if (m->watch.known && s->periods > calls) {
        return find(ID(REASON_SKIPPED), NO_JOINT, s->periods, calls);
    }
    if (m->watch.known && s->watch.missed >= LOST_SAMPLES) {
        return find(ID(REASON_MISSED), NO_JOINT, s->watch.missed, LOST_SAMPLES);
    }
    return NOTHING;
}

/* Judge time and sample of a call, and watch what the believed ones say of the arm. */
void believe(const memory_t *m, const input_t *in, sample_t *s)
{
    watch_t *const w = &s->watch;
    finding_t found = NOTHING;
    memset(s, 0, sizeof *s);
    s->watch = m->watch;
    s->limit = s->unstable = found;
    s->status = (uint32_t)ID(STATUS_MISSED);
    s->periods = read_clock(&m->config, in, w);
    const int there = s->periods > 0 && in->sample_valid == 1;
    if (there) {
        const watch_t timed = *w;
        found = check_sample(m, in, s);
        if (found.reason != ID(REASON_NONE)) { /* what is not believed leaves no records */
            *w = timed;
        }
        w->bad = ((w->bad << 1) | (found.reason != ID(REASON_NONE))) & 7; /* the last three samples, a bit each */
        s->status = found.reason != ID(REASON_NONE) ? (uint32_t)ID(STATUS_BAD_SAMPLE) : 0u;
    }
    s->good = there && found.reason == ID(REASON_NONE);
    w->missed = s->good ? 0 : count_up(w->missed, 1);
    w->good = s->good ? count_up(w->good, 1) : 0;
    s->lost = judge_losses(m, s, found);
    if (s->lost.reason == ID(REASON_CLOCK) || fault_of_reason(s->lost.reason) == ID(FAULT_SENSOR)) {
        w->known = 0;
    }
    if (s->good) {
        memcpy(w->q, s->q, sizeof w->q);
        memcpy(w->dq, s->dq, sizeof w->dq);
        watch_limits(m, s);
        watch_shaking(m, s);
    }
}
