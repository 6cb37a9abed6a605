/* Commands: what is accepted, and why what is not is refused. */
#include "impedance.h"

static const double COMMAND_TOLERANCE = 1e-6; /* of a stiffness, over its largest entry: single precision */
static const double MOST_TRANSLATION = 5e3, MOST_ROTATION = 500.0; /* [N/m], [N m/rad] entries of a stiffness */
static const double MOST_POSTURE = 1e4;                            /* [N m/rad] */
static const double LATEST = 1e12; /* [s] a later time has lost its last digits */

/* Return a finding; outputs are finite. */
finding_t find(int reason, int entry, double seen, double limit)
{
    const finding_t found = {reason, ID(COMMAND_NONE), entry, fabs(seen) <= DBL_MAX ? seen : 0.0, limit};
    return found;
}

/* Return a refusal. */
static finding_t refuse(int reason, int command, int entry, double seen, double limit)
{
    finding_t found = find(reason, entry, seen, limit);
    found.command = command;
    return found;
}

/* Check that a call has a clock. */
finding_t check_clock(const input_t *in)
{
    const int by_time = in != NULL && in->clock == ID(CLOCK_TIME) && fabs(in->time) <= LATEST;
    const int timed = by_time || (in != NULL && in->clock == ID(CLOCK_COUNTER));
    return timed ? NOTHING : refuse(ID(REFUSAL_CLOCK), ID(COMMAND_CLOCK), NO_JOINT, 0.0, 0.0);
}

/* Check that the entries of a command lie between bounds; `reason` is why others are refused. */
static finding_t check_entries(const double *x, int count, double least, double most, int reason, int command)
{
    for (int k = 0; k < count; ++k) {
        if (!(fabs(x[k]) <= DBL_MAX)) {
            return refuse(ID(REFUSAL_NOT_FINITE), command, k, 0.0, most);
        }
        if (!(x[k] >= least && x[k] <= most)) {
            return refuse(reason, command, k, x[k], x[k] < least ? least : most);
        }
    }
    return NOTHING;
}

/* Accept a stiffness: symmetric, positive semidefinite, up to single precision. result: its symmetric part. */
static finding_t accept_stiffness(const double *K, double most, int command, int spring, double *result)
{
    const int first = 9 * spring;
    finding_t found = check_entries(K, 9, -most, most, ID(REFUSAL_STIFFNESS_LIMIT), command);
    double size = DBL_MIN;
    found.entry += found.reason != ID(REFUSAL_NONE) ? first : 0;
    for (int k = 0; found.reason == ID(REFUSAL_NONE) && k < 9; ++k) {
        result[k] = 0.5 * (K[k] + K[k % 3 * 3 + k / 3]);
        size = larger(size, fabs(K[k]));
    }
    const double allowed = COMMAND_TOLERANCE * size;
    for (int k = 1; found.reason == ID(REFUSAL_NONE) && k < 9; ++k) {
        const double apart = fabs(K[k] - K[k % 3 * 3 + k / 3]);
        if (apart > allowed) {
            found = refuse(ID(REFUSAL_ASYMMETRIC), command, first + k, apart, allowed);
        }
    }
    if (found.reason == ID(REFUSAL_NONE)) {
        const double least = smallest_eigenvalue(result);
        found = least >= -allowed ? found : refuse(ID(REFUSAL_INDEFINITE), command, first, least, -allowed);
    }
    return found;
}

/*
 * Accept q0; a continuous joint takes the turn nearest to the reference. In a limit zone or beyond the limit by up to
 * TOLERANCE it is followed to the zone, or to where the reference is already; limited: the first such joint.
 */
static finding_t accept_positions(const memory_t *m, const double *given, double *q0, int *limited)
{
    const config_t *const c = &m->config;
    const double *const r = m->reference.engaged ? m->reference.r : m->watch.q;
    for (int i = 0; i < N; ++i) {
        if (!(fabs(given[i]) <= FARTHEST)) {
            return refuse(ID(REFUSAL_NOT_FINITE), ID(COMMAND_Q0), i, given[i], FARTHEST);
        }
        const double wanted = nearest_turn(i, given[i], r[i]), low = c->lower_limit[i], high = c->upper_limit[i];
        if (beyond(c, i, wanted) > TOLERANCE) {
            return refuse(ID(REFUSAL_POSITION), ID(COMMAND_Q0), i, wanted, wanted > high ? high : low);
        }
        const double least = smaller(m->arm.zone[i], larger(r[i], low));
        q0[i] = clamp(wanted, least, larger(m->arm.zone[N + i], smaller(r[i], high)));
        *limited = *limited == NO_JOINT && q0[i] != wanted ? i : *limited;
    }
    return stiffgen_reaches(q0, m) ? NOTHING : refuse(ID(REFUSAL_LOOPS), ID(COMMAND_Q0), NO_JOINT, 0.0, 0.0);
}

/* Accept q0 and the stiffnesses: the first refusal counts. */
static finding_t accept_springs(const memory_t *m, const input_t *in, command_t *k)
{
    finding_t found = accept_positions(m, in->q0, k->q0, &k->limited);
    for (int t = 0; found.reason == ID(REFUSAL_NONE) && t < SPRINGS; ++t) {
        found = accept_stiffness(in->translation_stiffness + 9 * t, MOST_TRANSLATION, ID(COMMAND_TRANSLATION_STIFFNESS),
                                 t, k->stiffness.translation + 9 * t);
    }
    for (int t = 0; found.reason == ID(REFUSAL_NONE) && t < SPRINGS; ++t) {
        found = accept_stiffness(in->rotation_stiffness + 9 * t, MOST_ROTATION, ID(COMMAND_ROTATION_STIFFNESS), t,
                                 k->stiffness.rotation + 9 * t);
    }
    if (found.reason == ID(REFUSAL_NONE)) {
        found = check_entries(in->posture_stiffness, N, 0.0, MOST_POSTURE, ID(REFUSAL_STIFFNESS_LIMIT),
                              ID(COMMAND_POSTURE_STIFFNESS));
    }
    memcpy(k->stiffness.posture, in->posture_stiffness, sizeof k->stiffness.posture);
    return found;
}

/* Accept the wrenches that tips and pairs are to exert: finite, at most heaviest_wrench. pressing: there is one. */
static finding_t accept_wrenches(const config_t *c, const double *wrench, int *pressing)
{
    finding_t found = NOTHING;
    *pressing = 0;
    for (int k = 0; found.reason == ID(REFUSAL_NONE) && k < 2 * TWISTS; ++k) { /* force, moment of each in turn */
        const double *const part = wrench + 3 * k, most = c->heaviest_wrench[k % 2] * (1.0 + ROUNDED);
        found = check_entries(part, 3, -most, most, ID(REFUSAL_WRENCH), ID(COMMAND_WRENCH_COMMAND));
        const double size = found.reason == ID(REFUSAL_NONE) ? norm(3, part) : 0.0;
        found.entry += found.reason != ID(REFUSAL_NONE) ? 3 * k : 0;
        if (size > most) {
            found = refuse(ID(REFUSAL_WRENCH), ID(COMMAND_WRENCH_COMMAND), 3 * k, size, most);
        }
        *pressing |= size > 0.0;
    }
    *pressing = *pressing && found.reason == ID(REFUSAL_NONE);
    return found;
}

/* Accept the acceleration of a plan: at most SHAPED times that of the reference. planned: there is one. */
static finding_t accept_acceleration(const config_t *c, const double *acceleration, int *planned)
{
    *planned = 0;
    for (int i = 0; i < N; ++i) {
        const double most = SHAPED * SPEED * c->velocity_limit[i] / c->ramp_time;
        finding_t found = check_entries(acceleration + i, 1, -most, most, ID(REFUSAL_ACCELERATION),
                                        ID(COMMAND_ACCELERATION));
        if (found.reason != ID(REFUSAL_NONE)) {
            *planned = 0;
            found.entry = i;
            return found;
        }
        *planned |= acceleration[i] != 0.0;
    }
    return NOTHING;
}

/* Accept a command: springs as a whole, wrench and acceleration each by itself. The first refusal is reported. */
void accept_command(const memory_t *m, const input_t *in, command_t *k)
{
    k->limited = NO_JOINT;
    k->shaped = in->shaped != 0;
    k->refusal = accept_springs(m, in, k);
    k->accepted = k->refusal.reason == ID(REFUSAL_NONE);
    const finding_t wrench = accept_wrenches(&m->config, in->wrench_command, &k->pressing);
    const finding_t acceleration = accept_acceleration(&m->config, in->acceleration, &k->planned);
    k->wrench = in->wrench_command;
    k->acceleration = in->acceleration;
    k->pressing = k->pressing && k->accepted;
    k->planned = k->planned && k->accepted && k->shaped;
    k->limited = k->accepted ? k->limited : NO_JOINT;
    if (k->accepted) {
        k->refusal = wrench.reason != ID(REFUSAL_NONE) ? wrench : acceleration;
    }
}
