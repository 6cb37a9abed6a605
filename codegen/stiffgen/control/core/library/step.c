/* A step: the phases in their order. Their results become the memory; nothing else writes it. */
#include "impedance.h"

static const double RESUME_TIME = 0.1;     /* [s] of good samples after which a fault that resumes ends */
static const double ROUNDED_ENERGY = 1e-9; /* [J] that an account which balances may lack */
enum { TRUSTED = 2 };                      /* good samples that a reset waits for */

/* Results of the phases, for the report. */
typedef struct {
    command_t command;
    law_t law;
    torque_t torque;
    uint32_t status;
} phases_t;

/* Return the fault after a finding; the first one stays, but one that leaves no torque takes its place. */
static fault_t latch(const fault_t *before, const finding_t *found)
{
    const int worse = has_no_torque(found->reason) && !has_no_torque(before->reason);
    fault_t next = *before;
    if (found->reason != ID(REASON_NONE) && (before->reason == ID(REASON_NONE) || worse)) {
        next.reason = found->reason;
        next.joint = found->entry;
        next.seen = found->seen;
        next.limit = found->limit;
        next.time = 0.0;
        next.reset = 0;
    }
    return next;
}

/* Note a finding: the fault that follows, and good samples are counted from here on. */
static void note(memory_t *m, const finding_t *found)
{
    m->fault = latch(&m->fault, found);
    m->watch.good = found->reason != ID(REASON_NONE) ? 0 : m->watch.good;
}

/* End a fault that is to be reset, or ends by itself, once samples are good and the springs are released or hold. */
static void end_fault(memory_t *m)
{
    const int resumes = fault_of_reason(m->fault.reason) == ID(FAULT_COMMUNICATION) &&
                        m->config.communication_reaction == ID(COMMUNICATION_REACTION_RESUME) &&
                        m->watch.good * m->config.sample_time >= RESUME_TIME;
    const int free_of_springs = !m->reference.engaged || holds_in_fault(m);
    const int ends = (m->fault.reset || resumes) && m->watch.good > TRUSTED && free_of_springs;
    if (m->fault.reason != ID(REASON_NONE) && ends) {
        memset(&m->fault, 0, sizeof m->fault);
        m->fault.joint = NO_JOINT;
        calm(&m->watch);
    }
}

/* End the reference's motion. */
static void stop_reference(reference_t *f)
{
    memset(f->dr, 0, sizeof f->dr);
    memset(f->trend, 0, sizeof f->trend);
}

/* Settle the reference at the arm, where the springs store nothing. A command that is accepted engages them. */
static void settle(memory_t *m, const command_t *k)
{
    reference_t *const f = &m->reference;
    memcpy(f->r, m->watch.q, sizeof f->r);
    memcpy(f->wanted, m->watch.q, sizeof f->wanted);
    stop_reference(f);
    stiffgen_poses(m->watch.q, m, f->equilibrium);
    f->scale = f->press = 0.0;
    f->engaged = 0;
    account_springs(&m->account, m, 0.0);
    if (k->accepted && m->fault.reason == ID(REASON_NONE)) {
        m->stiffness = k->stiffness;
        f->engaged = f->commanded = 1;
        f->scale = 1.0;
        account_engage(&m->account, m);
    }
}

/* Move the reference, then change the stiffness. Return the status. */
static uint32_t follow_command(memory_t *m, const command_t *k)
{
    reference_t *const f = &m->reference;
    move_t g;
    change_t next;
    govern(m, k, &g);
    account_move(&m->account, m, &g);
    memcpy(f->r, g.r, sizeof f->r);
    memcpy(f->dr, g.dr, sizeof f->dr);
    (void)mix(N, f->trend, g.dr, smaller(m->config.sample_time / TREND_TIME, 1.0), f->trend);
    memcpy(f->equilibrium, g.equilibrium, sizeof f->equilibrium);
    if (k->accepted) {
        memcpy(f->wanted, k->q0, sizeof f->wanted);
    }
    stiffen(m, k, &next);
    account_springs(&m->account, m, next.energy);
    m->stiffness = next.stiffness;
    return g.status | next.status;
}

/* Book what happened since the last believed sample, and take the sample's records. A first one begins the account. */
static void take_sample(memory_t *m, const sample_t *s)
{
    double unused[N];
    stiffgen_adopt(s->joints, &m->arm);
    if (!m->watch.known) {
        place_zones(m, s->q, &m->arm);
        account_start(&m->account, m, zone_energy(m, s->q, unused, unused));
    } else {
        const reference_t *const f = &m->reference;
        const int stores = f->scale != 0.0;
        const double U = stores ? spring_energy(m, s->q, f->r, f->equilibrium, &m->stiffness) : 0.0;
        account_interval(&m->account, m, s->q, f->scale * U, zone_energy(m, s->q, unused, unused));
        m->watch = s->watch;
    }
    m->watch.known = 1;
}

/*
 * Step with a believed sample, whose findings are noted.
 *
 *   springs    fault                   what is done                                           mode at the end
 *   no         none                    settle; a command that is accepted engages             START or ACTIVE
 *   no         any                     settle; a reset that is granted engages as above       FOLLOW, ACTIVE
 *   yes        none                    move the reference, change stiffness and scale         ACTIVE
 *   yes        communication, to hold  the reference stands still; a reset that is granted    HOLD or ACTIVE
 *   yes        dissipation, shaking    settle: no torque at all                               LIMP
 *   yes        any other               let the scale fall, settle at 0                        RELEASE, FOLLOW
 */
static void step_with_sample(memory_t *m, phases_t *p)
{
    p->status |= p->command.refusal.reason != ID(REFUSAL_NONE) ? (uint32_t)ID(STATUS_COMMAND_REFUSED) : 0u;
    p->status |= p->command.limited != NO_JOINT ? (uint32_t)ID(STATUS_COMMAND_LIMITED) : 0u;
    const int holds = holds_in_fault(m);
    if (m->fault.reason != ID(REASON_NONE)) {
        m->reference.engaged &= (holds || m->reference.scale != 0.0) && !has_no_torque(m->fault.reason);
        end_fault(m);
    }
    if (!m->reference.engaged) {
        settle(m, &p->command);
    } else if (m->fault.reason == ID(REASON_NONE) && !holds) {
        p->status |= follow_command(m, &p->command);
    } else {
        stop_reference(&m->reference);
    }
    find_law(m, &p->command, &p->law);
    m->reference.press = p->law.press;
    p->status |= p->law.status;
    if (m->reference.engaged) {
        const scale_t next = vary_scale(m, &p->law);
        account_springs(&m->account, m, next.scale * p->law.energy);
        m->reference.scale = next.scale;
        p->status |= next.status;
    }
    guard(m, &p->law, &p->torque);
}

/* Step without a believed sample: hold the torque for as many calls as are covered, then let it fall. */
static void step_without_sample(memory_t *m, torque_t *t)
{
    let_fall(m, t);
    if (m->watch.known && m->fault.reason == ID(REASON_NONE) && m->watch.missed < m->account.hold) {
        memcpy(t->own, m->account.history, sizeof t->own);
        memcpy(t->aim, t->own, sizeof t->aim);
        t->hold = m->account.hold;
        t->reserve = reserve(m, t->own, t->hold - m->watch.missed);
    }
    if (m->fault.reason != ID(REASON_NONE)) {
        m->reference.engaged &= holds_in_fault(m);
        m->reference.scale = 0.0;
        account_release(&m->account);
    }
}

/*
 * Add the caller's torque: the own one has the rate limit first, the caller's the effort limit. The sum goes straight
 * to where both lead: own torque that was the caller's before a start anew falls as his rises. Return the status.
 */
static uint32_t add_offset(memory_t *m, const double *offset, const double *aim, const double *last, double *total)
{
    const config_t *const c = &m->config;
    uint32_t status = 0u;
    for (int i = 0; i < N; ++i) {
        const double own = m->account.history[i], rate = c->torque_rate_limit[i] * c->sample_time;
        const double most = 2.0 * c->effort_limit[i]; /* turns the own torque round */
        const double given = offset != NULL && fabs(offset[i]) <= DBL_MAX ? offset[i] : m->caller.offset[i];
        const double wanted = has_no_torque(m->fault.reason) ? 0.0 : clamp(given, -most, most);
        const double near = clamp(aim[i] + wanted, last[i] - rate, last[i] + rate);
        const double left = clamp(near, -c->effort_limit[i], c->effort_limit[i]) - own;
        m->caller.offset[i] = fabs(left) > NO_TORQUE ? left : 0.0;
        total[i] = own + m->caller.offset[i];
        status |= fabs(left - wanted) > NO_TORQUE ? (uint32_t)ID(STATUS_OFFSET_LIMITED) : 0u;
    }
    return status;
}

/* Return the mode of the step. */
static int find_mode(const memory_t *m)
{
    if (m->fault.reason == ID(REASON_NONE)) {
        return m->reference.engaged ? ID(MODE_ACTIVE) : ID(MODE_START);
    }
    if (!m->watch.known || has_no_torque(m->fault.reason)) {
        return ID(MODE_LIMP);
    }
    if (!m->reference.engaged) {
        return ID(MODE_FOLLOW);
    }
    return holds_in_fault(m) ? ID(MODE_HOLD) : ID(MODE_RELEASE);
}

/* Report a step: what the memory holds, and what the phases found. */
static void report(const memory_t *m, const phases_t *p, output_t *out)
{
    const finding_t *const r = &p->command.refusal;
    const int lacks = m->watch.known && available(&m->account) < -ROUNDED_ENERGY;
    report_memory(m, out);
    out->status = p->status | p->torque.status | (lacks ? (uint32_t)ID(STATUS_TANK_DEFICIT) : 0u);
    out->status |= m->fault.reason != ID(REASON_NONE) ? (uint32_t)ID(STATUS_FAULT) : 0u;
    out->mode = find_mode(m);
    out->fault = fault_of_reason(m->fault.reason);
    out->refusal = r->reason;
    out->refusal_command = r->command;
    out->refusal_entry = r->entry;
    out->refusal_seen = r->seen;
    out->refusal_limit = r->limit;
    out->limited_joint = p->command.limited;
    out->stored = m->account.springs + m->account.zones;
    out->reserve = p->torque.reserve;
    out->stiffness_share = p->law.cap;
    memcpy(out->own_torque, p->torque.own, sizeof out->own_torque);
    memcpy(out->damping_torque, p->law.damper, sizeof out->damping_torque);
    memcpy(out->limit_torque, p->law.zone, sizeof out->limit_torque);
    memcpy(out->feedforward_torque, p->law.feedforward, sizeof out->feedforward_torque);
}

/*
 * Step without a memory to go on from: it was never initialised, or overwritten. A torque in force moves to zero at its
 * rate limit; without one, the output keeps its zeros. The memory is cleared: it may be no state.
 */
static int step_without_memory(state_t *state, output_t *out)
{
    double last[N], rate[N], effort[N];
    const int stored = vote(state->torque, last) & vote(state->rate, rate) & vote(state->effort, effort);
    memset(&state->memory, 0, sizeof state->memory);
    for (int i = 0; stored && i < N; ++i) {
        const double fallen = last[i] - clamp(last[i], -fabs(rate[i]), fabs(rate[i]));
        out->torque[i] = clamp(fallen, -fabs(effort[i]), fabs(effort[i]));
    }
    if (stored) {
        store_copies(state->torque, out->torque);
    }
    return ID(E_NOT_INITIALISED);
}

/* Return whether a sample may be used: a first one within the limits, while no fault waits but that of a lost clock. */
static int may_use(memory_t *m, const sample_t *s)
{
    if (!s->good || m->watch.known) {
        return s->good;
    }
    const int brakes = fault_of_reason(m->fault.reason) == ID(FAULT_COMMUNICATION); /* until the reset, by damping */
    m->watch = s->watch;
    note(m, &s->limit);
    if (s->limit.reason == ID(REASON_NONE)) {
        end_fault(m);
    }
    return m->fault.reason == ID(REASON_NONE) ||
           (brakes && s->limit.reason == ID(REASON_NONE) && m->watch.good > TRUSTED);
}

/*
 * Pass the time of a call, and take the input's sample and command. Return whether the sample is used. (The sample's
 * scratch ends here, before that of the law begins: the two share the stack.)
 */
static int take_input(memory_t *m, const input_t *in, phases_t *p)
{
    sample_t s;
    believe(m, in, &s);
    p->status = s.status;
    account_time(&m->account, &m->config, s.periods);
    m->fault.time += m->config.sample_time * s.periods;
    const int usable = may_use(m, &s);
    if (usable) {
        take_sample(m, &s);
        accept_command(m, in, &p->command);
        note(m, &s.lost);
        note(m, &s.limit);
        note(m, &s.unstable);
    } else {
        m->watch = s.watch;
        note(m, &s.lost);
    }
    return usable;
}

/* Do the step of a memory that is believed. Without an input there is no sample and no clock. */
static void do_step(memory_t *m, const input_t *in, const double *last, output_t *out)
{
    phases_t p;
    memset(&p, 0, sizeof p);
    p.command.limited = NO_JOINT;
    p.law.cap = 1.0;
    p.command.refusal = check_clock(in);
    const int usable = take_input(m, in, &p);
    if (usable) {
        step_with_sample(m, &p);
    } else {
        step_without_sample(m, &p.torque);
    }
    account_torque(&m->account, &p.torque);
    note(m, &p.torque.finding);
    p.status |= add_offset(m, usable ? in->torque_offset : NULL, p.torque.aim, last, out->torque);
    report(m, &p, out);
}

/* Guard the torque that leaves the step, whatever the memory holds: finite, and within the effort limit. */
static void guard_output(const double *effort, double *torque)
{
    for (int i = 0; i < N; ++i) {
        const double most = fabs(effort[i]); /* NaN fails every comparison, and becomes 0 */
        torque[i] = fabs(torque[i]) <= DBL_MAX ? clamp(torque[i], -most, most) : 0.0;
    }
}

int step(state_t *state, const input_t *in, output_t *out)
{
    double last[N], effort[N];
    if (out == NULL) {
        return ID(E_NULL);
    }
    memset(out, 0, sizeof *out);
    out->status = (uint32_t)ID(STATUS_FAULT);
    out->mode = ID(MODE_LIMP);
    out->fault = ID(FAULT_MEMORY);
    out->reason = ID(REASON_STATE);
    out->fault_joint = out->refusal_entry = out->limited_joint = NO_JOINT;
    if (state == NULL) {
        return ID(E_NULL);
    }
    if (!is_believable(state) || !vote(state->torque, last) || !vote(state->effort, effort)) {
        return step_without_memory(state, out);
    }
    do_step(&state->memory, in, last, out);
    guard_output(effort, out->torque);
    store_copies(state->torque, out->torque);
    state->checksum = compute_checksum(state);
    return in != NULL ? ID(OK) : ID(E_NULL);
}
