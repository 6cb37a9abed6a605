/*
 * Step: observe the sample, book the interval that ended (s), check for faults, move the equilibrium (p), vary the
 * stiffness (v), design the damping, vary the scale (v), choose a torque that is covered and within its limits.
 */
#include "impedance.h"

static const double RESUME_TIME = 0.1;    /* [s] of good samples after which a communication fault resets itself */
static const double FAR_TOO_FAST = 1.5; /* velocity limits from which on a speed that rises shows that nothing brakes */
static const double ROUNDED_ENERGY = 1e-9; /* [J] of the account that is rounding: its totals are below 1e5 J */

/* Remember position and velocity of a sample. */
static void remember_sample(step_t *s)
{
    memory_t *const m = s->m;
    memcpy(m->q, s->q, sizeof m->q);
    memcpy(m->measured_q, s->input->q, sizeof m->measured_q);
    s->has_jacobians = 0;
    memcpy(m->dq, s->velocity, sizeof m->dq);
    /* before the gap is cleared: velocities from before a gap are no part of a mean */
    m->recent_count = m->gap > 0 ? 1 : clamp_count(m->recent_count + 1, RECENT);
    memmove(m->recent + N, m->recent, (RECENT - 1) * N * sizeof(double));
    memcpy(m->recent, s->velocity, N * sizeof(double));
    m->counter = s->input->counter;
    m->gap = m->missed = 0;
}

/* Latch a fault for a joint that is beyond its position limit by more than position_tolerance. */
static void check_positions(step_t *s)
{
    const config_t *const c = s->c;
    for (int i = 0; i < N; ++i) {
        if (distance_beyond(c, i, s->q[i]) > c->position_tolerance) {
            const double edge = s->q[i] > c->upper_limit[i] ? c->upper_limit[i] : c->lower_limit[i];
            latch_fault(s->m, ID(REASON_POSITION), i, s->q[i], edge);
        }
    }
}

/*
 * Latch a fault where nothing brakes an arm that is too fast: its largest speed, as a share of the joint's limit, has
 * risen RISES times since it is above it, in a fault or far above. The sign or the order of joints may be wrong: then
 * the damping drives, and only an arm without torque is safe. The fault takes the place of another.
 */
static void check_dissipation(step_t *s, int joint, double share, double limit)
{
    memory_t *const m = s->m;
    m->rises = share > 1.0 ? clamp_count(m->rises + (share > m->fastest), RISES) : 0;
    m->fastest = share > 1.0 ? larger(m->fastest, share) : 0.0;
    if (m->rises == RISES && (m->fault != ID(FAULT_NONE) || share > FAR_TOO_FAST) &&
        m->fault != ID(FAULT_DISSIPATION)) {
        m->fault = ID(FAULT_NONE);
        latch_fault(m, ID(REASON_DISSIPATION), joint, fabs(s->velocity[joint]), limit);
    }
}

/*
 * Latch a fault for a speed that is above its limit for longer than overspeed_time: a bump may drive a joint beyond it
 * for a moment, which is braked. A velocity limit that the configuration lowers comes into force here.
 */
static void check_speeds(step_t *s)
{
    const config_t *const c = s->c;
    memory_t *const m = s->m;
    int first_fast = NO_JOINT, fastest = 0;
    double most = 0.0, most_limit = 0.0;
    for (int i = 0; i < N; ++i) {
        const double speed = fabs(s->velocity[i]);
        const double limit = smaller(c->velocity_limit[i], m->velocity_limit[i]);
        const double share = speed / (limit + NOISE_RANGE * c->velocity_noise);
        fastest = share > most ? i : fastest;
        most_limit = share > most ? limit : most_limit;
        most = larger(share, most);
        if (speed > limit + NOISE_RANGE * c->velocity_noise) {
            first_fast = first_fast == NO_JOINT ? i : first_fast;
            s->status |= ID(STATUS_OVERSPEED);
        }
        /* a lowered limit bounds what is believed only once the arm is known to be below it */
        if (s->believed && speed <= c->velocity_limit[i]) {
            m->velocity_limit[i] = limit;
        }
    }
    m->fast = first_fast == NO_JOINT ? 0 : clamp_count(m->fast + 1, LONGEST);
    if (first_fast != NO_JOINT && m->fast * c->sample_time > c->overspeed_time * (1.0 + ROUNDED)) {
        const double limit = smaller(c->velocity_limit[first_fast], m->velocity_limit[first_fast]);
        latch_fault(m, ID(REASON_OVERSPEED), first_fast, fabs(s->velocity[first_fast]), limit);
    }
    check_dissipation(s, fastest, most, most_limit);
}

/* Check position and speed against their limits, and the spring against the one in force. The first fault stays. */
static void check_limits(step_t *s)
{
    const config_t *const c = s->c;
    memory_t *const m = s->m;
    check_positions(s);
    check_speeds(s);
    if (m->engaged && c->spring != m->spring) {
        latch_fault(m, ID(REASON_CHANGED), NO_JOINT, 0.0, 0.0);
    }
}

/*
 * End a fault that is to be reset, after two good samples. A fault that is held ends once the available energy covers
 * the torque over missing samples again.
 */
static void end_fault(step_t *s, const double *last)
{
    const config_t *const c = s->c;
    memory_t *const m = s->m;
    m->good_time = s->believed ? m->good_time + c->sample_time : 0.0;
    const int resumes = m->fault == ID(FAULT_COMMUNICATION) &&
                        c->communication_reaction == ID(COMMUNICATION_REACTION_RESUME) && m->good_time >= RESUME_TIME;
    if (m->fault != ID(FAULT_NONE) && (m->reset || resumes) && m->good_time > c->sample_time) {
        double parts[3];
        if (m->engaged && sum_reserve(s, m->calls, m->call_gap, last, parts) > available_energy(m)) {
            return; /* the fault stays until a later sample */
        }
        m->fault = ID(FAULT_NONE);
        m->reason = ID(REASON_NONE);
        m->fault_joint = NO_JOINT;
        m->fault_seen = m->fault_limit = 0.0;
        m->reset = m->absent = m->bad = m->doubted = 0;
    }
}

/*
 * Set the limit avoidance where the account begins. It leaves out joints whose position is not believed (condemned): it
 * would drive the arm by what is wrong, and nothing of its energy counts. A first position beyond a limit may be one in
 * other units (doubted), as no later one.
 */
static void begin_limits(step_t *s, const double *q)
{
    memory_t *const m = s->m;
    int condemned = 0;
    if (!m->known) {
        measure_inertia(s, q);
        adopt_limits(s, q);
    }
    for (int i = 0; i < N; ++i) {
        double *const a = m->avoidance + 4 * i;
        condemned |= s->condemned[i];
        a[2] = s->condemned[i] ? 0.0 : a[2]; /* stiffness */
        a[3] = s->condemned[i] ? 0.0 : a[3]; /* largest torque */
    }
    m->doubted |= condemned && !m->known;
    s->status |= condemned ? (uint32_t)ID(STATUS_BAD_SAMPLE) : 0u;
}

/*
 * Step with a believed sample, or, in a fault, with one whose position is believed. The fault is the one after this
 * sample's checks, the scale that of the last step. "Follow" settles the springs at the arm, where they store nothing.
 *
 *   engaged  fault                   scale  what is done                                        mode at the end
 *   no       none                    0      follow; a command that is accepted engages          START or ACTIVE
 *   no       any                     0      follow; a reset that is granted engages as above    FOLLOW, START, ACTIVE
 *   yes      none                    any    move the equilibrium, vary stiffness and scale      ACTIVE
 *   yes      communication, to hold  any    hold the equilibrium; a reset that is granted ends  HOLD or ACTIVE
 *   yes      any other               > 0    let the scale fall (vary_scale)                     RELEASE
 *   yes      any other               0      disengage, then as in the second row                FOLLOW, START, ACTIVE
 *
 * A fault that is found only in compute_torque (RESERVE) acts from the next step on.
 */
static void step_with_sample(step_t *s, const double *last)
{
    memory_t *const m = s->m;
    int moved = 0;
    if (!m->known || s->jumped) {
        begin_limits(s, s->q);
    }
    /* gap and last position are read before remember_sample replaces them */
    s->elapsed = s->c->sample_time * (1 + m->gap);
    book_interval(s, s->q);
    remember_sample(s);
    s->commanded = s->believed && accept_command(s);
    s->status |= s->commanded ? 0u : (uint32_t)ID(STATUS_COMMAND_REFUSED);
    accept_feedforward(s);
    check_limits(s); /* may latch a fault: m->fault counts from here on */
    s->budget = m->tank - TANK_FLOOR * s->tank_initial;
    adopt_raised_limits(s, last);
    if (m->fault == ID(FAULT_NONE)) {
        adopt_limits(s, s->q);
    } else {
        drop_limits(s, s->q);
        m->engaged = m->engaged && (m->scale != 0.0 || holds_in_fault(s));
    }
    if (!m->engaged) {
        end_fault(s, last);
        settle_springs(s);
    } else if (holds_in_fault(s)) {
        memset(m->posture_velocity, 0, sizeof m->posture_velocity);
        memset(m->equilibrium_velocity, 0, sizeof m->equilibrium_velocity);
        end_fault(s, last);
    } else if (m->fault == ID(FAULT_NONE)) {
        m->reset = 0;
        memcpy(s->old_equilibrium, m->equilibrium, sizeof s->old_equilibrium);
        move_equilibrium(s);
        vary_stiffness(s);
        moved = 1;
    }
    compute_torque(s, last, moved);
    pay_engagement(s); /* last, since compute_torque may find a fault: then nothing is paid */
}

/*
 * Release the springs at once: the scale falls to 0, and without a position there is no torque to fall with it. This is
 * a change of stiffness that costs -elastic_energy: the account books it as such, and the tank receives it, so that
 * their sum, which covers the torques in transit, stays. The tank's maximum waits for the next booking, since there may
 * be no configuration.
 */
static void release_springs(memory_t *m)
{
    m->stiffness_total -= m->elastic_energy;
    m->tank += m->elastic_energy;
    m->elastic_energy = m->scale = 0.0;
}

/*
 * Step without a believed sample: hold the torque for as many calls as the reserve covers, then move it to zero at the
 * rate limit. In a fault it moves at once, and the springs are released.
 */
static void step_without_sample(step_t *s, const double *last)
{
    memory_t *const m = s->m;
    const double no_feed[N] = {0.0};
    m->missed = clamp_count(m->missed + 1, LONGEST);
    if (!s->timed) {
        note_untimed_call(s, last);
    }
    bridge_gap(s, 1);
    if (m->known && m->fault == ID(FAULT_NONE)) {
        memcpy(s->out->torque, last, N * sizeof(double));
        if (m->missed >= m->hold) {
            step_towards_zero(last, m->rate, s->out->torque);
            fade_gains(m);
        }
        limit_torque(s, last);
    } else { /* there may be no configuration */
        release_springs(m);
        m->good_time = 0.0;
        step_towards_zero(last, m->rate, s->out->torque);
        fade_gains(m);
    }
    shift_history(m, s->transit, no_feed);
}

/* Take what the configuration says of time and limits, and observe the sample. */
static void start_step(step_t *s, state_t *state, const double *last)
{
    memory_t *const m = s->m;
    for (int i = 0; i < N; ++i) {
        m->rate[i] = s->c->torque_rate_limit[i] * s->c->sample_time;
    }
    store_copies(state->rate, m->rate);
    m->delay = s->c->delay_samples;
    m->sample_time = s->c->sample_time;
    m->fault_time += s->c->sample_time;
    find_energies(s);
    observe_sample(s, last);
}

/* Return the mode of the step. */
static int find_mode(const step_t *s)
{
    if (s->m->fault == ID(FAULT_NONE)) {
        return s->m->engaged ? ID(MODE_ACTIVE) : ID(MODE_START);
    }
    if (!s->m->engaged) {
        return ID(MODE_FOLLOW);
    }
    return s->held ? ID(MODE_HOLD) : ID(MODE_RELEASE);
}

/* Report mode, status and the memory's part of the output. */
static void report_step(const step_t *s)
{
    memory_t *const m = s->m;
    output_t *const out = s->out;
    m->energy_supplied = larger(m->energy_supplied, m->supplied);
    report_memory(m, out);
    memcpy(out->velocity, s->velocity, sizeof out->velocity);
    out->status = s->status;
    out->stiffness_share = m->stiffness_share * m->scale;
    out->tank_initial = s->tank_initial;
    out->engagement_limit = s->engagement_limit;
    out->energy_limit = s->energy_limit;
    out->refusal = s->refusal.code;
    out->refusal_argument = s->refusal.command;
    out->refusal_entry = s->refusal.entry;
    out->limited_joint = s->limited;
    out->refusal_seen = s->refusal.seen;
    out->refusal_limit = s->refusal.limit;
    out->mode = find_mode(s);
    out->status |= m->fault != ID(FAULT_NONE) ? (uint32_t)ID(STATUS_FAULT) : 0u;
    if (available_energy(m) < -ROUNDED_ENERGY) {
        out->status |= ID(STATUS_TANK_DEFICIT);
    }
}

/*
 * Read the torque in force and the most that it can be. Return whether both were stored by init or step: a state that
 * was never initialised has none, and its torque is 0.
 */
static int read_torque(step_t *s, const state_t *state, double *last)
{
    const int torque_stored = vote(state->torque, last), effort_stored = vote(state->effort, s->effort);
    for (int i = 0; i < N; ++i) {
        last[i] = torque_stored && effort_stored ? clamp(last[i], -s->effort[i], s->effort[i]) : 0.0;
    }
    memcpy(s->before, last, sizeof s->before);
    return torque_stored && effort_stored;
}

/*
 * Step without a memory to go on from: it was never initialised, or it was overwritten and there is no valid
 * configuration to start anew with. A torque in force moves to zero at the last valid rate limit; without one, or
 * without a rate, the output keeps its zeros. The memory is cleared: it may be no state. Return the error.
 */
static int step_without_memory(state_t *state, int stored, const double *last, int error, output_t *output)
{
    double rate[N];
    const int rate_known = vote(state->rate, rate);
    memset(&state->memory, 0, sizeof state->memory);
    if (stored && rate_known) {
        step_towards_zero(last, rate, output->torque); /* the gains are zero: tau_ff is all of it */
        memcpy(output->tau_ff, output->torque, sizeof output->tau_ff);
        store_copies(state->torque, output->torque);
    }
    return error != ID(OK) ? error : ID(E_NOT_INITIALISED);
}

/*
 * Guard the torque that leaves the step, whatever the memory holds: finite, and within the effort limit or on its way
 * down to a lowered one. Gains are finite and within their limits. refused: this call has no valid configuration, so
 * that the last effort limit stays in force, and gains have no limit.
 */
static void guard_torque(step_t *s, int refused)
{
    memory_t *const m = s->m;
    for (int i = 0; i < N; ++i) {
        const double torque = s->out->torque[i];
        double most = s->effort[i], kp_limit = DBL_MAX, kd_limit = DBL_MAX;
        if (!refused) {
            /* a limit that was lowered below the last torque is reached at the rate limit, without a jump */
            most = larger(s->c->effort_limit[i], fabs(s->before[i]));
            kp_limit = s->c->kp_limit[i];
            kd_limit = s->c->kd_limit[i];
        }
        /* NaN fails every comparison, and becomes 0 */
        s->out->torque[i] = fabs(torque) <= DBL_MAX ? clamp(torque, -most, most) : 0.0;
        m->kp[i] = m->kp[i] >= 0.0 ? smaller(m->kp[i], kp_limit) : 0.0;
        m->kd[i] = m->kd[i] >= 0.0 ? smaller(m->kd[i], kd_limit) : 0.0;
        if (!refused) { /* what the next call may find in force */
            s->effort[i] = larger(s->c->effort_limit[i], fabs(s->out->torque[i]));
        }
    }
}

/* Do one step. */
int step(const config_t *c, state_t *state, const input_t *input, output_t *output)
{
    if (output == NULL) {
        return ID(E_NULL);
    }
    memset(output, 0, sizeof *output);
    /* the report of a call that ends without a step; report_step overwrites it */
    output->status = (uint32_t)ID(STATUS_CONFIG) | (uint32_t)ID(STATUS_FAULT);
    output->mode = ID(MODE_FOLLOW);
    output->fault = ID(FAULT_CONFIGURATION);
    output->reason = ID(REASON_CONFIG);
    if (state == NULL) {
        return ID(E_NULL);
    }
    memory_t *const m = &state->memory;
    double last[N];
    step_t s;
    memset(&s, 0, sizeof s);
    s.c = c;
    s.m = m;
    s.scratch = state->scratch;
    s.modes = state->modes;
    s.input = input;
    s.out = output;
    s.refusal.entry = s.limited = output->refusal_entry = output->limited_joint = NO_JOINT;
    const int error = c == NULL || input == NULL ? ID(E_NULL) : validate(c), refused = error != ID(OK);
    const int stored = read_torque(&s, state, last);
    if (!stored || !is_believable(state)) {
        if (refused || !stored) {
            return step_without_memory(state, stored, last, error, output);
        }
        /* memory was overwritten: nothing is believed but the torque, which is stored three times */
        start_memory(c, state, last);
        m->unaccounted = 1;
        latch_fault(m, ID(REASON_STATE), NO_JOINT, 0.0, 0.0);
    }
    separate_torque_offset(&s, last, refused); /* `last` is the controller's own torque from here on */
    memcpy(s.transit, last, sizeof last);
    if (refused) {
        latch_fault(m, ID(REASON_CONFIG), NO_JOINT, 0.0, 0.0);
        s.status |= ID(STATUS_CONFIG);
    } else {
        start_step(&s, state, last);
    }
    if (s.believed || (s.located && m->known && m->fault != ID(FAULT_NONE))) {
        step_with_sample(&s, last);
    } else {
        step_without_sample(&s, last);
    }
    add_torque_offset(&s, last, refused);
    guard_torque(&s, refused);
    /* stored before report_gains: the account is about tau_ff, and out->torque then has what the motors apply */
    store_copies(state->torque, output->torque);
    store_copies(state->effort, s.effort);
    limit_gains(&s, refused);
    report_gains(&s, refused);
    s.held = !refused && holds_in_fault(&s);
    report_step(&s);
    state->checksum = compute_checksum(state);
    return error;
}
