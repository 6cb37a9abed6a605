/* Watches: position and speed limits, damping that does not brake, and joints that shake. */
#include "impedance.h"

static const double OVERSPEED_TIME = 0.2; /* [s] for which a joint may be beyond its velocity limit, as after a bump */
static const double OUT_OF_CONTROL = 1.5; /* velocity limits from which on rising speed is no bump */
static const double STRONG = 0.7;         /* share of the effort limit that brakes in vain: no bump, either */
static const double SHAKING_PERIOD = 0.04; /* [s] longest half of a swing that is shaking */
static const double SHAKING_SPEED = 0.24;  /* share of the velocity limit, peak to peak, that is shaking */
static const double LASTING = 0.7;         /* share of the swing before that a swing which does not decay has */
enum { RISES = 10, SWINGS = 12, MOST_SWINGS = 30 };

/* Find a joint that is beyond its position limit by more than the tolerance. */
static finding_t find_beyond(const config_t *c, const double *q)
{
    for (int i = 0; i < N; ++i) {
        if (beyond(c, i, q[i]) > TOLERANCE) {
            return find(ID(REASON_POSITION), i, q[i], q[i] > c->upper_limit[i] ? c->upper_limit[i] : c->lower_limit[i]);
        }
    }
    return NOTHING;
}

/* Return the joint that is fastest over its limit, with its speed over it. */
static int find_fastest(const config_t *c, const double *dq, double *most)
{
    int fastest = 0;
    *most = 0.0;
    for (int i = 0; i < N; ++i) {
        const double share = fabs(dq[i]) / (c->velocity_limit[i] + NOISE_RANGE * c->velocity_noise);
        fastest = share > *most ? i : fastest;
        *most = larger(share, *most);
    }
    return fastest;
}

/*
 * Watch positions and speeds. Damping brakes a joint beyond its velocity limit; if its speed still rises, in a fault,
 * far above the limit, or against a strong brake, the law drives the arm: sign or order of the joints is wrong.
 */
void watch_limits(const memory_t *m, sample_t *s)
{
    const config_t *const c = &m->config;
    watch_t *const w = &s->watch;
    double most;
    const int joint = find_fastest(c, s->dq, &most), is_fast = most > 1.0;
    const double speed = fabs(s->dq[joint]), limit = c->velocity_limit[joint];
    s->limit = find_beyond(c, s->q);
    s->status |= is_fast ? (uint32_t)ID(STATUS_OVERSPEED) : 0u;
    w->fast = is_fast ? count_up(w->fast, 1) : 0;
    w->rises = is_fast ? count_up(w->rises, most > w->fastest) : 0;
    w->fastest = is_fast ? larger(w->fastest, most) : 0.0;
    const double brake = s->dq[joint] > 0.0 ? -m->account.history[joint] : m->account.history[joint];
    const int no_bump = most > OUT_OF_CONTROL || brake > STRONG * c->effort_limit[joint];
    if (w->rises >= RISES && (m->fault.reason != ID(REASON_NONE) || no_bump)) {
        s->unstable = find(ID(REASON_DISSIPATION), joint, speed, limit);
    }
    const int too_long = w->fast * c->sample_time > OVERSPEED_TIME * (1.0 + ROUNDED);
    if (too_long && s->limit.reason == ID(REASON_NONE)) {
        s->limit = find(ID(REASON_OVERSPEED), joint, speed, limit);
    }
}

/* Begin to watch joint i anew; a swing keeps its direction. */
static void begin_swing(int i, double dq, watch_t *w)
{
    w->swings[i] %= 2;
    w->peak[i] = w->last_peak[i] = dq;
    w->swing[i] = 0.0;
    w->since[i] = 0;
}

/*
 * Watch for shaking: a joint speed that swings to and fro faster than SHAKING_PERIOD, without decay. Damping ends every
 * swing of an arm; one that goes on is driven by the controller, whose torque acts later than declared.
 */
void watch_shaking(const memory_t *m, sample_t *s)
{
    const config_t *const c = &m->config;
    watch_t *const w = &s->watch;
    for (int i = 0; i < N; ++i) {
        const double dq = s->dq[i], least = larger(SHAKING_SPEED * c->velocity_limit[i], 8.0 * c->velocity_noise);
        const double turned = fabs(dq - w->peak[i]), side = w->swings[i] % 2 != 0 ? -1.0 : 1.0;
        w->since[i] = count_up(w->since[i], s->periods);
        if (w->since[i] * c->sample_time > SHAKING_PERIOD) {
            begin_swing(i, dq, w);
        } else if (side * (dq - w->peak[i]) > 0.0) { /* the swing goes on */
            w->peak[i] = dq;
        } else if (turned > least) { /* it has turned round */
            const double whole = fabs(w->peak[i] - w->last_peak[i]);
            const int lasts = whole > LASTING * w->swing[i];
            const int swings = lasts ? w->swings[i] + 1 : 1 - w->swings[i] % 2;
            w->swings[i] = swings > MOST_SWINGS ? swings - 2 : swings;
            w->swing[i] = whole;
            w->last_peak[i] = w->peak[i];
            w->peak[i] = dq;
            w->since[i] = 0;
        }
        if (w->swings[i] >= SWINGS && s->unstable.reason == ID(REASON_NONE)) {
            s->unstable = find(ID(REASON_SHAKING), i, w->swing[i], least);
        }
    }
}

/* Calm the watches after the end of a fault: what led to it counts no more. */
void calm(watch_t *w)
{
    w->fast = w->rises = w->bad = 0;
    w->fastest = 0.0;
    for (int i = 0; i < N; ++i) {
        w->swings[i] %= 2;
        w->moved[i] = 0.0;
    }
}
