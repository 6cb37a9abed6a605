/* Configuration and start. */
#include "impedance.h"

enum { POSTURES = 32 }; /* in which the tank is sized */

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
static int validate(const config_t *c)
{
    const int error = check_fields(c);
    for (int i = 0; error == ID(OK) && i < N; ++i) {
        if (!(c->lower_limit[i] < c->upper_limit[i])) {
            return ID(E_POSITION_LIMITS);
        }
    }
    return error == ID(OK) ? check_tools(c) : error;
}

/*
 * Return number k of joint i in [0, 1): bits of k and i, mixed until no relation is left (finaliser of MurmurHash3, A.
 * Appleby, public domain). Multiples of one number would keep the joints near a curve.
 */
double spread_joint(int k, int i)
{
    uint32_t bits = ((uint32_t)k << 8) + (uint32_t)i + 1u;
    bits = (bits ^ (bits >> 16)) * 0x85ebca6bu;
    bits = (bits ^ (bits >> 13)) * 0xc2b2ae35u;
    return (double)(bits ^ (bits >> 16)) / 4294967296.0; /* 2^32 */
}

/*
 * Return the most reserve of a tip's wrenches: heaviest_wrench along each axis. The worst wrench of all directions
 * needs at most 1.4 times as much (four arms); a search for it would take as long as a hundred steps.
 */
static double wrench_reserve(const memory_t *m, const double *J)
{
    const config_t *const c = &m->config;
    double torque[N], most = 0.0;
    for (int row = 0; row < 6; ++row) {
        for (int i = 0; i < N; ++i) {
            const double wanted = c->heaviest_wrench[row / 3] * J[row * N + i];
            torque[i] = clamp(wanted, -c->effort_limit[i], c->effort_limit[i]);
        }
        most = larger(reserve(m, torque, c->missed_limit), most); /* NaN is not */
    }
    return most;
}

/* Return the tank that covers heaviest_wrench at every tip in postures spread over the limits. */
static double size_tank(const memory_t *m)
{
    const config_t *const c = &m->config;
    double most = 0.0;
    for (int k = 0; k < POSTURES; ++k) {
        double q[N], J[6 * N * TWISTS], sum = 0.0;
        for (int i = 0; i < N; ++i) {
            const double low = larger(c->lower_limit[i], smaller(c->upper_limit[i], 0.5 * TURN) - TURN);
            const double high = smaller(c->upper_limit[i], low + TURN);
            q[i] = low + (high - low) * spread_joint(k + 1, i);
        }
        stiffgen_retract(m, q);
        stiffgen_jacobians(q, m, J);
        for (int t = 0; t < TIPS; ++t) {
            sum += wrench_reserve(m, J + 6 * N * t);
        }
        most = larger(sum, most);
    }
    return most / COVERED;
}

/* Prepare a state; torque is the one in force, or NULL for zero. */
int initialise(const config_t *c, state_t *state, const double *torque)
{
    static const double none[N] = {0.0};
    if (c == NULL || state == NULL) {
        return ID(E_NULL);
    }
    memory_t *const m = &state->memory;
    const double *const acting = torque != NULL ? torque : none;
    double rate[N];
    memset(state, 0, sizeof *state);
    const int error = validate(c);
    for (int i = 0; error == ID(OK) && i < N; ++i) {
        if (!(fabs(acting[i]) <= c->effort_limit[i])) {
            return ID(E_TORQUE);
        }
        rate[i] = c->torque_rate_limit[i] * c->sample_time;
    }
    if (error != ID(OK)) {
        return error;
    }
    m->config = *c;
    stiffgen_home(&m->arm);
    m->config.tank_initial = c->tank_initial > 0.0 ? c->tank_initial : size_tank(m);
    m->fault.joint = NO_JOINT;
    m->ready = READY;
    account_open(&m->account, &m->config, acting);
    store_copies(state->torque, acting);
    store_copies(state->rate, rate);
    store_copies(state->effort, c->effort_limit);
    state->checksum = compute_checksum(state);
    return ID(OK);
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
    state->memory.fault.reset = 1;
    state->checksum = compute_checksum(state);
    return ID(OK);
}
