/* Samples: whether a measurement is believed. */
#include "impedance.h"

/* A standstill is judged from this share of the velocity limit on, over the motion of this many samples. */
static const double FROZEN_SHARE = 0.02, FROZEN_SAMPLES = 20.0;
static const double FROZEN_TRAVEL = 4e-3; /* [rad] or [m] predicted motion of a joint that stands still: no less */
/* Share of the effort limit over which the torque ranges at most while a position is the same to the last bit; coarsest
 * resolution [rad] or [m] of positions that show it. */
static const double STILL_RANGE = 0.03, FINE_QUANTUM = 1e-6;
enum { FROZEN_POSITION = 1, FROZEN_VELOCITY = 2 };
enum { HALVES = 2, SKIPPED = 1000 }; /* halves of a sample; most calls that are counted as skipped at once */
/* Motion that dq and q may disagree by in a sample: share of the velocity limit, share of the motion itself. */
static const double DISAGREED_LIMIT = 0.5, DISAGREED_MOTION = 0.3;
/* Velocity limits that a dq may have: a faster one is no measurement. */
static const double FASTEST = 1e3;

/*
 * Count missing samples, in halves (m->absent), so that the count stays an integer: a missing sample is two halves, and
 * one that is there (periods 0) takes one back. Faults are loss_limit samples in a row, more than one of three for
 * long, and missed_limit calls in a row.
 */
static void count_missing(step_t *s, int periods, int reason)
{
    memory_t *const m = s->m;
    const int most = s->c->loss_limit > m->calls ? s->c->loss_limit : m->calls;
    const int halves = m->absent + (periods > 0 ? HALVES * periods : -1);
    const int calls = reason == ID(REASON_SKIPPED) ? periods : 0; /* in a row, without a step */
    m->absent = clamp_count(halves, HALVES * most);
    if (m->known && calls >= m->calls) {
        latch_fault(m, reason, NO_JOINT, calls, m->calls);
    } else if (m->known && halves >= HALVES * most) {
        latch_fault(m, reason, NO_JOINT, (double)halves / (double)HALVES, most);
    }
}

/*
 * Track a value that may stand still. From a window after its last change on, sum how far the motions of q and dq
 * differ; up to `allowed` per sample is noise, resolution and bias of dq, which therefore do not add up at rest. Return
 * the sum's absolute value.
 */
static double sum_still(int changed, double window, double differs, double allowed, double *age, double *sum)
{
    *age = changed ? 0.0 : *age + 1.0;
    const double next = *sum + differs;
    *sum = *age > window ? next - clamp(next, -allowed, allowed) : 0.0;
    return fabs(*sum);
}

/*
 * Find whether q or dq of joint i stands still while the other moves. differs: motion by dq less the change of q; seen,
 * limit: the sum and what it may be. Return FROZEN_POSITION, FROZEN_VELOCITY, both as bits, or 0.
 */
static int check_frozen(step_t *s, int i, double differs, double elapsed, double *seen, double *limit)
{
    const config_t *const c = s->c;
    memory_t *const m = s->m;
    const double q = s->q[i], dq = s->input->dq[i], window = c->frozen_window;
    const double drift = larger(FROZEN_SHARE * m->velocity_limit[i], c->velocity_noise), allowed = drift * elapsed;
    const int q_changed = !m->known || q != m->still_q[i], dq_changed = !m->known || dq != m->still_dq[i];
    const double q_sum = sum_still(q_changed, window, differs, allowed, &m->q_age[i], &m->moved_q[i]);
    const double dq_sum = sum_still(dq_changed, window, differs, allowed, &m->dq_age[i], &m->moved_dq[i]);
    m->still_q[i] = q;
    m->still_dq[i] = dq;
    *limit = larger(4.0 * c->position_quantum, drift * FROZEN_SAMPLES * c->sample_time);
    *seen = larger(q_sum, dq_sum);
    return (q_sum > *limit ? FROZEN_POSITION : 0) | (dq_sum > *limit ? FROZEN_VELOCITY : 0);
}

/* Return whether the sample repeats the last state, which state_period allows for this long. */
static int repeats_state(step_t *s)
{
    memory_t *const m = s->m;
    int same = m->known && m->fault == ID(FAULT_NONE);
    for (int i = 0; i < N; ++i) {
        same = same && s->q[i] == m->still_q[i] && s->input->dq[i] == m->still_dq[i];
    }
    m->state_age = clamp_count(m->state_age + 1, LONGEST);
    /* a state that has lasted for state_period counts as a new one, so that an arm may stand still */
    same = same && m->state_age * s->c->sample_time < (1.0 - ROUNDED) * s->c->state_period;
    m->state_age = same ? m->state_age : 0;
    return same;
}

/* Note what is wrong with a sample: joint, the number that was seen, and its limit. */
static void note_finding(step_t *s, int joint, double seen, double limit)
{
    s->joint = joint;
    s->seen = seen;
    s->limit = limit;
}

/* Check the sample counter, and bridge the calls that are missing. Return REASON_NONE or REASON_STALE. */
static int check_counter(step_t *s, const double *last)
{
    memory_t *const m = s->m;
    const uint32_t counter = s->input->counter;
    /* sample times that are missing besides those of the gap; unsigned, as the counter wraps */
    const int32_t ahead = (int32_t)(counter - m->counter - (uint32_t)m->gap - 1u);
    m->regular = counter == m->seen_counter + 1u ? clamp_count(m->regular + 1, 3) : 0;
    m->seen_counter = counter;
    /* an old sample; but in a fault a counter that advances regularly again is believed, wherever it stands */
    if (ahead < 0 && (m->fault == ID(FAULT_NONE) || m->regular < 3)) {
        note_finding(s, NO_JOINT, 1.0 + ahead, 1.0);
        return ID(REASON_STALE);
    }
    if (ahead > 0) {
        s->status |= ID(STATUS_MISSED);
        bridge_missing_calls(s, last, ahead);
        count_missing(s, clamp_count(ahead, SKIPPED), ID(REASON_SKIPPED));
    }
    s->timed = ahead >= 0;
    m->gap_calls = ahead >= 0 ? 0 : m->gap_calls;
    return ID(REASON_NONE);
}

/*
 * Check one joint's q and dq, and choose the velocity to use: if one of the two is wrong the other's, or, where it is
 * open which, the smaller one if they agree in sign. Damping with too small a velocity puts no energy in.
 *
 * motion: change of q since the last known position; measured: its velocity; far: motion at the velocity limit;
 * differs: motion by dq less that of q; apart: what q and dq of different times may differ by. Of jump, standstill
 * and mismatch the first that is found counts.
 */
static int check_joint(step_t *s, int i)
{
    const config_t *const c = s->c;
    memory_t *const m = s->m;
    const double q = s->q[i], dq = s->input->dq[i], elapsed = c->sample_time * (1 + m->gap);
    const double motion = m->known ? q - m->q[i] : dq * elapsed;
    const double far = m->velocity_limit[i] * elapsed, measured = motion / elapsed, quanta = 2.0 * c->position_quantum;
    const double noise = NOISE_RANGE * c->velocity_noise * elapsed, differs = dq * elapsed - motion;
    const double apart = c->state_period * smaller(fabs(dq), fabs(measured));
    const double allowed = larger(DISAGREED_LIMIT * far, DISAGREED_MOTION * fabs(motion)) + quanta + noise + apart;
    double still, still_limit;
    int stuck = check_frozen(s, i, differs, elapsed, &still, &still_limit);
    const int disagree = fabs(differs) > allowed;
    const double farthest = larger(FROZEN_TRAVEL, 4.0 * c->position_quantum);
    const double widest = STILL_RANGE * c->effort_limit[i];
    const int held_exactly = s->range[i] > widest && c->position_quantum <= FINE_QUANTUM;
    if (held_exactly || s->travel[i] > farthest) {
        stuck = FROZEN_POSITION; /* the position is not believed, nor the velocity that follows from it */
        still = held_exactly ? s->range[i] : s->travel[i];
        still_limit = held_exactly ? widest : farthest;
        s->located = 0;
    }
    /* An arm that is too fast must be braked: q and dq that agree are believed at any speed that follows from the last
     * one, and in a fault at any speed. */
    const int fault = m->fault != ID(FAULT_NONE), follows = fabs(motion - m->dq[i] * elapsed) <= far + quanta;
    const double range = 2.0 * far + quanta + apart;
    const double locatable = fault || (follows && !disagree) ? 10.0 * far + quanta : range;
    s->velocity[i] = dq;
    s->condemned[i] = !m->known && distance_beyond(c, i, q) > c->position_tolerance;
    if ((disagree || !fault) && fabs(motion) > locatable) {
        s->located = 0;
        note_finding(s, i, fabs(motion), locatable);
    }
    if (disagree && fabs(motion) > range) {
        s->velocity[i] = 0.0;
        s->jumped = s->condemned[i] = 1;
        return ID(REASON_JUMP);
    }
    if (stuck != 0) {
        note_finding(s, i, still, still_limit);
        s->condemned[i] = (stuck & FROZEN_POSITION) != 0;
        s->velocity[i] = stuck == FROZEN_VELOCITY ? measured : dq;
        return ID(REASON_FROZEN);
    }
    if (disagree) {
        note_finding(s, i, fabs(differs) / elapsed, allowed / elapsed);
        const double slower = fabs(measured) < fabs(dq) ? measured : dq;
        s->velocity[i] = measured * dq <= 0.0 ? 0.0 : slower;
        return ID(REASON_MISMATCH);
    }
    return ID(REASON_NONE);
}

/*
 * Check a sample: REASON_NONE, or why it is not believed. A sample whose position alone is believed still serves in a
 * fault (located).
 */
static int check_sample(step_t *s, const double *last)
{
    memory_t *const m = s->m;
    const input_t *const in = s->input;
    int reason = ID(REASON_NONE);
    for (int i = 0; i < N; ++i) {
        if (!(fabs(in->q[i]) <= FARTHEST && fabs(in->dq[i]) <= FASTEST * m->velocity_limit[i])) {
            const double wrong = fabs(in->q[i]) <= FARTHEST ? in->dq[i] : in->q[i];
            note_finding(s, i, fabs(wrong) <= DBL_MAX ? wrong : 0.0, 0.0); /* outputs are finite */
            return ID(REASON_NOT_FINITE);
        }
    }
    if (m->known && check_counter(s, last) != ID(REASON_NONE)) {
        return ID(REASON_STALE);
    }
    s->located = 1; /* until a joint's check finds otherwise */
    if (s->c->velocity_source == ID(VELOCITY_SOURCE_DIFFERENCED)) {
        predict_standstills(s, last, s->c->sample_time * (1 + m->gap));
    }
    for (int i = 0; i < N; ++i) {
        const int found = check_joint(s, i);
        reason = found != ID(REASON_NONE) ? found : reason;
    }
    if (!s->located) {
        return reason == ID(REASON_FROZEN) ? reason : ID(REASON_JUMP);
    }
    if (!stiffgen_follow(s->q, m)) {
        s->located = 0;
        note_finding(s, NO_JOINT, 0.0, 0.0);
        return ID(REASON_LOOPS);
    }
    return reason;
}

/* Check the measured wrench: one that is too large or not finite counts as none. */
static void check_wrench(step_t *s)
{
    int good = s->input->wrench_valid == 1;
    for (int t = 0; good && t < TIPS; ++t) {
        const double *const wrench = s->input->wrench + 6 * t;
        good = norm(3, wrench) <= s->c->force_limit && norm(3, wrench + 3) <= s->c->moment_limit;
    }
    if (good) {
        memcpy(s->out->wrench, s->input->wrench, sizeof s->out->wrench);
    } else if (s->input->wrench_valid == 1) {
        s->status |= ID(STATUS_WRENCH_REFUSED);
    }
}

/* Check the environment's torque on the joints: one that is not finite counts as none. */
static void check_external(step_t *s)
{
    s->has_external = s->input->external_valid == 1;
    for (int i = 0; i < N; ++i) {
        s->has_external = s->has_external && fabs(s->input->external_torque[i]) <= DBL_MAX;
    }
}

/* Observe a sample: is there one, and is it believed? Two bad samples of three are a fault. */
void observe_sample(step_t *s, const double *last)
{
    memory_t *const m = s->m;
    int reason = ID(REASON_MISSED);
    for (int i = 0; s->input->sample_valid == 1 && i < N; ++i) {
        s->q[i] = m->known ? nearest_turn(s, i, s->input->q[i], m->q[i]) : s->input->q[i];
    }
    if (s->input->sample_valid == 1 && repeats_state(s)) {
        /* no new sample, and none that is missing: the torque is held */
        s->status |= ID(STATUS_REPEATED);
        check_counter(s, last);
        return;
    }
    if (s->input->sample_valid == 1) {
        check_wrench(s);
        check_external(s);
        reason = check_sample(s, last);
        m->bad = ((m->bad << 1) | (reason != ID(REASON_NONE))) & 7; /* the last three samples, a bit each */
        if (reason != ID(REASON_NONE) && (m->bad & (m->bad - 1)) != 0) { /* more than one bit is set */
            latch_fault(m, reason, s->joint, s->seen, s->limit);
        }
    }
    s->believed = reason == ID(REASON_NONE);
    if (reason == ID(REASON_MISSED)) {
        s->status |= ID(STATUS_MISSED);
    } else if (!s->believed) {
        s->status |= ID(STATUS_BAD_SAMPLE);
    }
    count_missing(s, !s->believed, reason); /* one sample time is missing, or none */
}
