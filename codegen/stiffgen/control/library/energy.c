/* Energy: stored in springs and limit avoidance, in the tank, and put out by torques in transit. */
#include "impedance.h"

static const double LIMIT_SHARE = 0.5; /* of largest_eigenvalue for the limit avoidance: the springs add theirs */

/* Return the limits of the springs in force: of every tip's force, then of the moments; NULL without limits. */
const double *find_spring_limits(const memory_t *m)
{
    return m->spring == ID(SPRING_BOUNDED) ? m->spring_limits : NULL;
}

/* Compute the energy of all tips' springs at q, unscaled. */
double compute_tip_energy(const memory_t *m, const double *q, const double *equilibrium)
{
    return stiffgen_spring_energy(q, m, equilibrium, m->translation_stiffness, m->rotation_stiffness,
                                  find_spring_limits(m));
}

/* Compute the energy of the tips' springs, which is given, and of the posture's spring, both unscaled. */
double add_posture_energy(const memory_t *m, const double *q, const double *posture, double tips)
{
    double twice = 0.0;
    for (int i = 0; i < N; ++i) {
        twice += m->posture_stiffness[i] * (q[i] - posture[i]) * (q[i] - posture[i]);
    }
    return tips + 0.5 * twice;
}

/* Compute the energy that the scaled springs store at q. */
double compute_stored_energy(const memory_t *m, const double *q)
{
    return m->scale * add_posture_energy(m, q, m->posture, compute_tip_energy(m, q, m->equilibrium));
}

/*
 * Evaluate one joint's limit avoidance a = (lower edge, upper edge, k, largest torque). Its energy is k d^2 / 2 at
 * depth d beyond an edge, and linear from where the torque is the largest. Results: the energy, its slope (pull) and
 * the slope's slope (stiffness).
 */
double evaluate_avoidance(const double *a, double q, double *pull, double *stiffness)
{
    const double k = a[2];
    double depth = 0.0;
    if (q > a[1]) {
        depth = q - a[1];
    } else if (q < a[0]) {
        depth = q - a[0];
    }
    *pull = clamp(k * depth, -a[3], a[3]);
    if (*pull == k * depth) { /* not clamped */
        *stiffness = depth != 0.0 ? k : 0.0;
        return 0.5 * k * depth * depth;
    }
    *stiffness = 0.0;
    return fabs(*pull) * (fabs(depth) - 0.5 * fabs(*pull) / k);
}

/* Return how far a position is beyond its limits; negative inside. */
double distance_beyond(const config_t *c, int i, double q)
{
    return larger(c->lower_limit[i] - q, q - c->upper_limit[i]);
}

/* Return whether the position of joint i counts modulo a turn: it has no limits, and cannot pass half a turn unseen. */
static int counts_modulo_turn(const step_t *s, int i)
{
    const config_t *const c = s->c;
    return stiffgen_turns(i) && c->continuous_joints == ID(CONTINUOUS_JOINTS_WRAPPED) &&
           smaller(-c->lower_limit[i], c->upper_limit[i]) > DBL_MAX &&
           s->m->velocity_limit[i] * c->sample_time < HALF_TURN;
}

/* Return the position of joint i that is nearest to another, of those that are whole turns apart. */
double nearest_turn(const step_t *s, int i, double q, double other)
{
    return counts_modulo_turn(s, i) ? q + 2.0 * HALF_TURN * floor((other - q) / (2.0 * HALF_TURN) + 0.5) : q;
}

/* Evaluate the limit avoidance of all joints: energy, torque, stiffness (limit_slope) and status. */
double evaluate_limits(step_t *s, const double *q)
{
    double energy = 0.0;
    for (int i = 0; i < N; ++i) {
        const double *const a = s->m->avoidance + 4 * i; /* a[0], a[1]: edges of the zones, inside the limits */
        double pull;
        energy += evaluate_avoidance(a, q[i], &pull, &s->limit_slope[i]);
        s->out->limit_torque[i] = 0.0 - pull; /* not -pull, which is -0.0 between the zones */
        s->status |= q[i] > a[1] || q[i] < a[0] ? (uint32_t)ID(STATUS_JOINT_LIMIT) : 0u;
    }
    return energy;
}

/*
 * Pay income into the tank. What a full tank cannot hold goes to the engagement: the sum of both bounds the work that
 * the controller puts out. Work that goes back there has not left the port: it is supplied no longer.
 */
void pay_into_tank(step_t *s, double income)
{
    memory_t *const m = s->m;
    const double full = larger(s->tank_initial, m->reserve);
    const double overflow = m->tank + income - full;
    m->tank += income;
    if (overflow > 0.0) {
        const double engagement = smaller(m->engagement + overflow, s->engagement_limit);
        m->tank = full;
        m->supplied -= larger(engagement - m->engagement, 0.0);
        m->engagement = engagement;
    }
}

/* Book the energy v of a change of stiffness, scale or limits, which raises `energy`. The tank pays. */
void book_stiffness(step_t *s, double *energy, double v)
{
    s->m->stiffness_total += v;
    *energy += v;
    s->budget -= v;
    pay_into_tank(s, -v);
}

/* Book the energy p of a move of the equilibrium. The engagement pays a cost; a gain goes to the tank. */
void book_reference(step_t *s, double p)
{
    s->m->reference_total += p;
    s->m->engagement -= larger(p, 0.0);
    s->m->supplied += larger(p, 0.0);
    pay_into_tank(s, larger(-p, 0.0));
}

/* Return the torque that acted in the interval that ends now; zero where its work is booked already. */
static const double *find_acting_torque(const step_t *s)
{
    return s->m->delay == 0 ? s->transit : s->m->older + (s->m->delay - 1) * N;
}

/* Return the sum of |torque| of joint i over the newest `count` torques before `last`. */
static double sum_older(const memory_t *m, int i, int count)
{
    double sum = 0.0;
    for (int k = 0; k < count; ++k) {
        sum += fabs(m->older[k * N + i]);
    }
    return sum;
}

/*
 * Start another interval: `last` is in transit now; feed is the reference's share of the torque that follows it, and
 * may be m->feed itself: the newest share then counts once more.
 */
void shift_history(memory_t *m, const double *last, const double *feed)
{
    memmove(m->older + N, m->older, (MOST_DELAY - 1) * N * sizeof(double));
    memcpy(m->older, last, N * sizeof(double));
    memmove(m->feed + N, m->feed, MOST_DELAY * N * sizeof(double));
    memmove(m->feed, feed, N * sizeof(double));
}

/*
 * Return the farthest that joint i is taken to move in a sample time where a torque is chosen. A velocity beyond the
 * limit, which may lie, makes the choice more careful; it books nothing (bound_gap_work).
 */
double farthest_motion(const memory_t *m, int i)
{
    return larger(m->velocity_limit[i], fabs(m->dq[i])) * m->sample_time;
}

/*
 * Bound the reference work of its shares of the torques in transit; the newest, feed, acts for the given number of
 * intervals.
 */
double worst_feed_work(const memory_t *m, const double *feed, int intervals)
{
    double sum = 0.0;
    for (int i = 0; i < N; ++i) {
        double size = intervals * fabs(feed[i]);
        for (int k = 0; k < m->delay; ++k) {
            size += fabs(m->feed[k * N + i]);
        }
        sum += farthest_motion(m, i) * size;
    }
    return sum;
}

/* Return the most sample times from one call to the next; a longer gap than missed_limit is a fault anyway. */
int limit_call_gap(const config_t *c, int missed)
{
    return c->call_gap_limit < missed ? c->call_gap_limit : missed;
}

/*
 * Sum the worst-case work of the torques in transit, whatever the environment does, until the last of them has gone to
 * zero at the rate limit. No joint is faster than its limit, a call comes every `gap` sample times, and the torque is
 * held for `hold` such calls without a sample. With l times the torque the sum is parts[0] + l parts[1] + l^2 parts[2].
 */
double sum_reserve(const step_t *s, double hold, int gap, const double *torque, double *parts)
{
    const memory_t *const m = s->m;
    parts[0] = parts[1] = parts[2] = 0.0;
    for (int i = 0; i < N; ++i) {
        const double size = fabs(torque[i]), far = farthest_motion(m, i);
        parts[0] += far * ((m->delay > 0 ? fabs(s->transit[i]) : 0.0) + sum_older(m, i, m->delay - 1));
        parts[1] += far * gap * hold * size;
        parts[2] += far * gap * 0.5 * size * (size / m->rate[i]);
    }
    return parts[0] + parts[1] + parts[2];
}

/* Compute the reserve, with the torque held for `calls` calls without a sample, and, in a fault, for one. */
double compute_reserve(const step_t *s, int calls, int gap, const double *torque, double *parts)
{
    return sum_reserve(s, s->m->fault != ID(FAULT_NONE) ? 1.0 : calls, gap, torque, parts);
}

/* Return the energy available to cover the torque. */
double available_energy(const memory_t *m)
{
    return m->tank + m->elastic_energy + m->limit_energy;
}

/*
 * Return the stiffness k of joint i's limit avoidance: the configured one, reduced to three bounds. With the width z of
 * the zone, the rate limit r of the torque, the velocity limit v and the inertia m = 1 / sum_j |(M^-1)_ij| of joint i,
 * which no motion of the other joints undercuts:
 *
 *     k v <= r                            the torque follows the spring
 *     2 sqrt(k m) (k z / m) <= r          the torque follows the damping 2 sqrt(k m) at the acceleration k z / m
 *     k <= s m                            s: LIMIT_SHARE of `eigenvalue`, that of largest_eigenvalue
 *
 * The third bound holds for every set of joints: no eigenvalue of M^-1 K exceeds the largest row sum of |K M^-1|.
 */
static double limit_stiffness(const step_t *s, int i, double eigenvalue)
{
    const config_t *const c = s->c;
    const double rate = c->torque_rate_limit[i], inertia = s->m->inertia[i];
    const double followed = rate / c->velocity_limit[i];
    const double share = rate / (2.0 * c->limit_zone), cube = inertia * share * share;
    const double sampled = LIMIT_SHARE * eigenvalue * inertia;
    const double most = smaller(smaller(c->limit_stiffness[i], sampled), followed);
    return most * most * most <= cube ? most : cbrt(cube); /* the damping's bound has the third power `cube` */
}

/*
 * Adopt the configured limit avoidance of each joint where the change costs no more at q than the tank's budget; else
 * the old one stays. The first sample's is free.
 */
void adopt_limits(step_t *s, const double *q)
{
    const config_t *const c = s->c;
    memory_t *const m = s->m;
    const double eigenvalue = largest_eigenvalue(c, m);
    int changed = 0;
    for (int i = 0; i < N; ++i) {
        double *const a = m->avoidance + 4 * i;
        const double wanted[4] = {c->lower_limit[i] + c->limit_zone, c->upper_limit[i] - c->limit_zone,
                                  limit_stiffness(s, i, eigenvalue), c->effort_limit[i]};
        if (memcmp(a, wanted, sizeof wanted) == 0) {
            continue;
        }
        if (m->known) {
            double pull, slope;
            const double before = evaluate_avoidance(a, q[i], &pull, &slope);
            const double v = evaluate_avoidance(wanted, q[i], &pull, &slope) - before;
            if (!(v <= larger(s->budget, 0.0))) { /* NaN is kept out, too */
                s->status |= ID(STATUS_LIMITS_KEPT);
                continue;
            }
            book_stiffness(s, &m->limit_energy, v);
        }
        memcpy(a, wanted, sizeof wanted);
        changed = 1;
    }
    if (changed) {
        evaluate_limits(s, q); /* torque and slope of the new one; its energy is booked */
    }
}

/*
 * Drop the limit avoidance of joints whose position a fault condemns; the tank receives what it has stored. The next
 * step without a fault adopts it again.
 */
void drop_limits(step_t *s, const double *q)
{
    memory_t *const m = s->m;
    int dropped = 0;
    for (int i = 0; i < N; ++i) {
        double *const a = m->avoidance + 4 * i;
        if (s->condemned[i] && a[2] > 0.0) {
            double pull, slope;
            book_stiffness(s, &m->limit_energy, -evaluate_avoidance(a, q[i], &pull, &slope));
            a[2] = a[3] = 0.0; /* stiffness and largest torque */
            dropped = 1;
        }
    }
    if (dropped) {
        evaluate_limits(s, q);
    }
}

/*
 * Return whether tank, stored energy and engagement cover the present torque under given limits of calls. Torques that
 * were in transit in a gap may be booked already, at the velocity limits in force then: they must have acted. The tank
 * then may hold what these limits need: springs that give way release into it, and a full one would lose their energy.
 */
static int covers_torque(const step_t *s, int calls, int gap, const double *last)
{
    memory_t *const m = s->m;
    double parts[3];
    const double reserve = sum_reserve(s, calls, gap, last, parts);
    if (m->recent_count <= m->delay || worst_feed_work(m, m->feed, gap) > larger(m->engagement, 0.0) ||
        reserve > available_energy(m)) {
        return 0;
    }
    m->reserve = larger(m->reserve, reserve);
    return 1;
}

/*
 * Adopt the limits under which a torque can put out more: a raised velocity_limit, missed_limit or call_gap_limit. One
 * rule for each, in a fault, too: it waits until the present torque is covered under it. Lower limits of calls come
 * into force at once; check_limits lowers those of velocity.
 */
void adopt_raised_limits(step_t *s, const double *last)
{
    const config_t *const c = s->c;
    memory_t *const m = s->m;
    int kept = 0;
    for (int i = 0; i < N; ++i) {
        const double before = m->velocity_limit[i]; /* covers_torque reads the memory's limit: try the raised one */
        m->velocity_limit[i] = larger(before, c->velocity_limit[i]);
        if (m->velocity_limit[i] > before && !covers_torque(s, m->calls, m->call_gap, last)) {
            m->velocity_limit[i] = before;
            kept = 1;
        }
    }
    if (c->missed_limit <= m->calls || covers_torque(s, c->missed_limit, m->call_gap, last)) {
        m->calls = c->missed_limit;
    }
    const int gap = limit_call_gap(c, m->calls);
    if (gap <= m->call_gap || covers_torque(s, m->calls, gap, last)) {
        m->call_gap = gap;
    }
    kept |= m->calls < c->missed_limit || m->call_gap < gap;
    s->status |= kept ? (uint32_t)ID(STATUS_LIMITS_KEPT) : 0u;
}

/*
 * Add intervals without a believed position to the gap. Two bounds on its work need: gap_change, each change of torque
 * times the intervals before it; gap_total, every torque times its own intervals.
 */
void bridge_gap(step_t *s, int periods)
{
    memory_t *const m = s->m;
    const double *const torque = find_acting_torque(s);
    for (int i = 0; i < N; ++i) { /* the gap is as long as it was before these intervals */
        const int begins = m->gap == 0;
        m->gap_change[i] = begins ? 0.0 : m->gap_change[i] + fabs(torque[i] - m->gap_torque[i]) * m->gap;
        m->gap_total[i] = (begins ? 0.0 : m->gap_total[i]) + fabs(torque[i]) * periods;
        m->gap_torque[i] = torque[i];
    }
    m->gap = clamp_count(m->gap + clamp_count(periods, LONGEST), LONGEST);
}

/*
 * Note a call whose sample does not tell the time: for how many periods the torque of the call before it was held shows
 * only later. Kept for that are the torques of the gap and in transit at the last timed call, and sum and maximum of
 * those held since.
 */
void note_untimed_call(step_t *s, const double *last)
{
    memory_t *const m = s->m;
    if (m->gap_calls == 0) {
        for (int i = 0; i < N; ++i) {
            m->gap_transit[i] = (m->gap > 0 ? m->gap_total[i] : 0.0) + sum_older(m, i, m->delay);
            m->gap_sum[i] = m->gap_largest[i] = 0.0;
        }
    }
    for (int i = 0; i < N; ++i) {
        m->gap_sum[i] += fabs(last[i]);
        m->gap_largest[i] = larger(m->gap_largest[i], fabs(last[i]));
    }
    m->gap_calls = clamp_count(m->gap_calls + 1, LONGEST);
}

/*
 * Bridge calls that were left out between two samples. If every call since the last timed one had a sample, the torque
 * of the last call was held. Else it is open which torque was held for how long: book the most that all of them can
 * do, those in transit once, and the others either for the calls that can be missing each, or, if that is less, the
 * largest for the whole gap. No work is left to book of torques that are still in transit then.
 */
void bridge_missing_calls(step_t *s, const double *last, int missing)
{
    memory_t *const m = s->m;
    const double nothing[N] = {0.0};
    if (m->gap_calls == 0) {
        for (int k = 0; k < missing && k <= MOST_DELAY; ++k) {
            bridge_gap(s, 1);
            shift_history(m, s->transit, m->feed);
        }
        /* further intervals are alike, as the history has the last torque alone by then: bridge them at once */
        bridge_gap(s, clamp_count(missing - MOST_DELAY - 1, LONGEST));
        return;
    }
    note_untimed_call(s, last);
    /* sample times that one of these torques was held at most, and all of them together */
    const double each = smaller(1.0 + missing, m->call_gap), all = (double)m->gap_calls + missing;
    double total[N];
    for (int i = 0; i < N; ++i) {
        total[i] = m->gap_transit[i] + smaller(each * m->gap_sum[i], all * m->gap_largest[i]);
    }
    /* `total` has all torques until now: none is in transit any more */
    memcpy(s->transit, nothing, sizeof nothing);
    memset(m->older, 0, sizeof m->older);
    memset(m->feed, 0, sizeof m->feed);
    bridge_gap(s, missing);
    for (int i = 0; i < N; ++i) {
        m->gap_change[i] = HUGE_VAL; /* no bound: only gap_total counts */
        m->gap_total[i] = total[i];
    }
}

/*
 * Bound the work [J] of the torques over a gap that ends with this motion: the better one of its two bounds. A joint
 * has moved no farther than at its velocity limit, for which the torques were chosen, or than the positions say. dq
 * does not count: it may lie, and no more may be booked than was reserved.
 */
static double bound_gap_work(step_t *s, const double *motion)
{
    memory_t *const m = s->m;
    bridge_gap(s, 1); /* the interval that ends now */
    double by_changes = dot(N, m->gap_torque, motion), most = 0.0;
    for (int i = 0; i < N; ++i) {
        const double far = larger(m->velocity_limit[i] * m->sample_time, fabs(motion[i]) / m->gap);
        /* after a long gap it is open by how many turns a continuous joint has moved */
        const int open = counts_modulo_turn(s, i) && far * m->gap >= HALF_TURN;
        by_changes += open ? HUGE_VAL : m->gap_change[i] * far;
        most += m->gap_total[i] * far;
    }
    return smaller(by_changes, most);
}

/*
 * Book the interval that ends at the believed position q. m->q is still the position at its start. The damper lies
 * between the arm and the moving reference: the work of the reference's share, feed = B dr + M ddr, over the arm's
 * motion is the reference's. The account begins, or begins anew, at a position with no known motion to it.
 */
void book_interval(step_t *s, const double *q)
{
    memory_t *const m = s->m;
    double port_work = 0.0, feed_work = 0.0, motion[N], parts[3];
    s->tip_energy = compute_tip_energy(m, q, m->equilibrium);
    const double elastic_energy = m->scale * add_posture_energy(m, q, m->posture, s->tip_energy);
    const double limit_energy = evaluate_limits(s, q);
    const double rise = elastic_energy - m->elastic_energy + limit_energy - m->limit_energy;
    m->elastic_energy = elastic_energy;
    m->limit_energy = limit_energy;
    if (!m->known) { /* what the torque in force may have put out by now (supply_torque) */
        m->tank -= m->reserve - sum_reserve(s, 0.0, m->call_gap, s->transit, parts);
    }
    if (!m->known || s->jumped) {
        m->start_total += rise;
        m->supplied += rise;
        m->unaccounted += (uint32_t)m->known;
        m->known = 1;
        return;
    }
    memcpy(motion, q, sizeof motion);
    add_scaled(N, -1.0, m->q, motion);
    if (m->gap > 0) {
        port_work = bound_gap_work(s, motion);
    } else {
        port_work = dot(N, find_acting_torque(s), motion) - absorbed_work(m, motion);
        feed_work = larger(dot(N, m->feed + m->delay * N, motion), 0.0);
    }
    m->port_total += port_work;
    m->sampling_total += rise + port_work - feed_work;
    pay_into_tank(s, feed_work - port_work - rise);
    book_reference(s, feed_work);
}
