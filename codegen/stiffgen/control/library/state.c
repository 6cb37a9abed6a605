/* Configuration and state: checks, checksum, start, reset, faults. */
#include "impedance.h"

/* Return whether all entries lie between the bounds (both allowed). */
int integers_within(const int *x, size_t count, int least, int most)
{
    for (size_t i = 0; i < count; ++i) {
        if (x[i] < least || x[i] > most) {
            return 0;
        }
    }
    return 1;
}

/* Check a configuration: OK, or the error of the first field that is refused. */
int validate(const config_t *c)
{
    const int error = check_fields(c);
    if (error != ID(OK)) {
        return error;
    }
    for (int i = 0; i < N; ++i) {
        if (!(c->upper_limit[i] - c->lower_limit[i] > 2.0 * c->limit_zone)) {
            return ID(E_POSITION_LIMITS);
        }
    }
    if (c->actuation == ID(ACTUATION_GAINS) && c->delay_samples > 0) {
        return ID(E_ACTUATION);
    }
    if (c->state_period > c->missed_limit * c->sample_time * (1.0 + ROUNDED)) {
        return ID(E_STATE_PERIOD);
    }
    return c->spring == ID(SPRING_BOUNDED) && !stiffgen_has_bounded_spring() ? ID(E_BOUNDED_SPRING) : ID(OK);
}

/* Rotate the bits of a sum, and add word k of the memory: two values of the word never have the same result. */
static uint64_t add_word(uint64_t sum, const memory_t *memory, size_t k)
{
    uint64_t word;
    memcpy(&word, (const char *)memory + k * sizeof word, sizeof word);
    return ((sum << 23) | (sum >> 41)) + word;
}

/* Compute the checksum of the memory; any single changed word changes it. */
uint64_t compute_checksum(const state_t *state)
{
    const memory_t *const m = &state->memory;
    const size_t count = sizeof *m / sizeof(uint64_t);
    uint64_t a = 0x9e3779b97f4a7c15u, b = 0xc2b2ae3d27d4eb4fu, c = 0x165667b19e3779f9u, d = 0x27d4eb2f165667c5u;
    for (size_t block = 0; block < count / 8; ++block) { /* four sums: the processor adds to all at once */
        const size_t k = 8 * block;
        a = add_word(add_word(a, m, k), m, k + 4);
        b = add_word(add_word(b, m, k + 1), m, k + 5);
        c = add_word(add_word(c, m, k + 2), m, k + 6);
        d = add_word(add_word(d, m, k + 3), m, k + 7);
    }
    const size_t left = count % 8;
    for (size_t k = 0; k < left; ++k) {
        a = add_word(a, m, count - 1 - k);
    }
    return a + 3u * b + 5u * c + 7u * d;
}

/* Masks of the copies: memory that was never initialised, or overwritten by a pattern, has no two copies that agree. */
static const uint64_t MASKS[3] = {0x9e3779b97f4a7c15u, 0xc2b2ae3d27d4eb4fu, 0x165667b19e3779f9u};

/*
 * Read numbers of three copies each; two that agree decide. Return whether all were stored by store_copies and are
 * finite; those that were not become 0.
 */
int vote(const uint64_t *copies, double *result)
{
    int all = 1;
    for (int i = 0; i < N; ++i) {
        const uint64_t a = copies[i] ^ MASKS[0], b = copies[N + i] ^ MASKS[1], c = copies[2 * N + i] ^ MASKS[2];
        const uint64_t agreed = a == b ? a : c;
        memcpy(result + i, &agreed, sizeof agreed);
        if ((a != b && b != c && a != c) || !(fabs(result[i]) <= DBL_MAX)) {
            result[i] = 0.0;
            all = 0;
        }
    }
    return all;
}

/* Store numbers in three copies, each under its own mask. */
void store_copies(uint64_t *copies, const double *values)
{
    for (int i = 0; i < N; ++i) {
        uint64_t word;
        memcpy(&word, values + i, sizeof word);
        copies[i] = word ^ MASKS[0];
        copies[N + i] = word ^ MASKS[1];
        copies[2 * N + i] = word ^ MASKS[2];
    }
}

/*
 * Supply the work that a torque in force can put out: it is in transit for the delay, acts until the first call, and
 * falls at each call from then on. The account begins with the first sample: book_interval takes out of the tank what
 * can have left the port by then.
 */
static void supply_torque(const config_t *c, state_t *state, const double *torque)
{
    memory_t *const m = &state->memory;
    double work = 0.0;
    for (int i = 0; i < N; ++i) {
        const double size = fabs(torque[i]), calls = 1.0 + 0.5 * size / m->rate[i]; /* of the whole torque, until 0 */
        work += m->velocity_limit[i] * c->sample_time * size * (c->delay_samples + m->call_gap * calls);
        for (int k = 0; k < MOST_DELAY; ++k) {
            m->older[k * N + i] = torque[i];
        }
    }
    m->reserve = work;
    m->tank += work;
    m->supplied += work;
    m->energy_supplied = m->supplied;
    store_copies(state->torque, torque);
}

/* Start the memory anew: no sample seen, a tank with its initial energy, and a torque in force. */
void start_memory(const config_t *c, state_t *state, const double *torque)
{
    memory_t *const m = &state->memory;
    memset(m, 0, sizeof *m);
    place_no_tools(m->tool_pose);
    stiffgen_home(m);
    for (int i = 0; i < N; ++i) {
        m->rate[i] = c->torque_rate_limit[i] * c->sample_time;
    }
    store_copies(state->rate, m->rate);
    store_copies(state->effort, c->effort_limit);
    memcpy(m->velocity_limit, c->velocity_limit, sizeof m->velocity_limit);
    m->sized_tank = c->tank_initial > 0.0 ? 0.0 : size_tank(c, m);
    m->tank = m->supplied = m->energy_supplied = larger(c->tank_initial, m->sized_tank);
    m->calls = m->hold = c->missed_limit;
    m->fault_joint = NO_JOINT;
    m->stiffness_share = 1.0;
    m->call_gap = limit_call_gap(c, c->missed_limit);
    m->ready = READY;
    supply_torque(c, state, torque);
}

/* Prepare a state; torque is the one in force, or NULL for zero. */
int initialise(const config_t *c, state_t *state, const double *torque)
{
    if (c == NULL || state == NULL) {
        return ID(E_NULL);
    }
    memset(state, 0, sizeof *state);
    const int error = validate(c);
    if (error != ID(OK)) {
        return error;
    }
    for (int i = 0; torque != NULL && i < N; ++i) {
        if (!(fabs(torque[i]) <= c->effort_limit[i])) {
            return ID(E_TORQUE);
        }
    }
    const double none[N] = {0.0};
    start_memory(c, state, torque != NULL ? torque : none);
    if (c->stiffness_cap == ID(STIFFNESS_CAP_REFUSE) && halves_stiffness(c, &state->memory, state->scratch)) {
        memset(state, 0, sizeof *state);
        return ID(E_STIFFNESS);
    }
    state->checksum = compute_checksum(state);
    return ID(OK);
}

/* Return whether the memory is what the last call left: mark, checksum, and every integer in its range. */
int is_believable(const state_t *state)
{
    const memory_t *const m = &state->memory;
    return m->ready == READY && fits_memory(m) && state->checksum == compute_checksum(state);
}

/* Ask for the end of a fault; the next steps with good samples grant it. */
int request_reset(state_t *state)
{
    if (state == NULL) {
        return ID(E_NULL);
    }
    if (!is_believable(state)) {
        return ID(E_NOT_INITIALISED);
    }
    state->memory.reset = 1;
    state->checksum = compute_checksum(state);
    return ID(OK);
}

/*
 * Latch a fault; the first one stays. joint: where, or NO_JOINT; seen, limit: the number that was seen, and what it may
 * be.
 */
void latch_fault(memory_t *m, int reason, int joint, double seen, double limit)
{
    if (m->fault == ID(FAULT_NONE)) {
        m->fault = fault_of_reason(reason);
        m->reason = reason;
        m->fault_joint = joint;
        m->fault_seen = seen;
        m->fault_limit = limit;
        m->fault_time = 0.0;
        m->reset = 0;
    }
    m->good_time = 0.0;
}

/* Return whether a latched communication fault is to be held: the springs stay, and the equilibrium stands still. */
int holds_in_fault(const step_t *s)
{
    return s->m->fault == ID(FAULT_COMMUNICATION) &&
           s->c->communication_reaction != ID(COMMUNICATION_REACTION_RELEASE);
}
