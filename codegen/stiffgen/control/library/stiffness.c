/* Stiffness and scale: what releases energy is done, what costs energy waits for the tank. */
#include "impedance.h"

static const double FALL_SHARE = 0.9; /* of the rate limit for a scale that falls: the pull changes, too */

/*
 * Move the stiffness towards the wanted one, by the share of this step, where that releases energy. Results: the
 * changes that cost energy, per spring; they are not made yet. Return whether anything changes.
 */
static int release_stiffness(step_t *s, double *translation, double *rotation, double *posture)
{
    memory_t *const m = s->m;
    const double share = 1.0 - exp(-s->c->sample_time / s->c->stiffness_time); /* a low pass */
    int changed = 0;
    for (int i = 0; i < N; ++i) {
        const double D = s->c->posture_stiffness[i] - m->posture_stiffness[i];
        const double step = fabs(D) <= ROUNDED * s->c->posture_stiffness[i] ? D : share * D;
        posture[i] = step > 0.0 ? step : 0.0;
        m->posture_stiffness[i] += step < 0.0 ? step : 0.0;
        changed |= D != 0.0;
    }
    const int is_wanted = s->commanded || m->capped; /* there is a stiffness of a command, or of cap_springs */
    for (int t = 0; t < TIPS; ++t) {
        double *const Kt = m->translation_stiffness + 9 * t, *const Ko = m->rotation_stiffness + 9 * t;
        changed |= soften(is_wanted ? s->translation + 9 * t : Kt, share, Kt, translation + 9 * t);
        changed |= soften(is_wanted ? s->rotation + 9 * t : Ko, share, Ko, rotation + 9 * t);
    }
    return changed;
}

/* Adopt the configured limits of the bounded springs at once, where the tank can pay; else the old ones stay. */
static void adopt_spring_limits(step_t *s)
{
    memory_t *const m = s->m;
    double old[2 * TIPS];
    memcpy(old, m->spring_limits, sizeof old);
    for (int t = 0; t < TIPS; ++t) {
        m->spring_limits[t] = s->c->spring_force_limit;
        m->spring_limits[TIPS + t] = s->c->spring_moment_limit;
    }
    if (m->spring != ID(SPRING_BOUNDED) || memcmp(old, m->spring_limits, sizeof old) == 0) {
        return;
    }
    const double v = compute_stored_energy(m, m->q) - m->elastic_energy; /* with the new limits, less with the old */
    if (v <= larger(smaller(s->budget, available_energy(m) - m->reserve / COVERED), 0.0)) {
        book_stiffness(s, &m->elastic_energy, v);
    } else {
        memcpy(m->spring_limits, old, sizeof old);
        s->status |= ID(STATUS_TANK_LIMITED);
    }
}

/*
 * Return the energy [J] by which a rise of the stiffness may lift that of the tips' springs: the one at which they
 * exert heaviest_wrench at the present deflection, where energy and wrench rise in the same ratio.
 */
static double heaviest_rise(const memory_t *m)
{
    return m->load > NO_LOAD ? m->load_energy * fmax(1.0 / m->load - 1.0, 0.0) : HUGE_VAL;
}

/* Change the stiffness towards the wanted one, as far as the tank can pay and the springs may pull. */
void vary_stiffness(step_t *s)
{
    memory_t *const m = s->m;
    double translation[9 * TIPS], rotation[9 * TIPS], posture[N];
    adopt_spring_limits(s);
    cap_springs(s);
    if (!release_stiffness(s, translation, rotation, posture)) {
        return;
    }
    /* a softer bounded spring can store more, as its limit comes later: the tank pays, its budget falls */
    const double released = compute_stored_energy(m, m->q);
    book_stiffness(s, &m->elastic_energy, released - m->elastic_energy);
    /* First try the whole change, then the share that can be paid, as the energy is linear in the stiffness. That of
     * the bounded spring is not: if its share costs more, a third attempt takes the change back. */
    int last = 1;
    if (m->spring == ID(SPRING_BOUNDED)) {
        last = 2;
    }
    double step = 1.0, share = 0.0, cost = 0.0; /* share: of the change that is made, the sum of the steps */
    for (int attempt = 0; attempt <= last; ++attempt) {
        add_scaled(9 * TIPS, step, translation, m->translation_stiffness);
        add_scaled(9 * TIPS, step, rotation, m->rotation_stiffness);
        add_scaled(N, step, posture, m->posture_stiffness);
        share += step;
        cost = compute_stored_energy(m, m->q) - released;
        /* stiffer than covered would be paid in vain: the scale would fall */
        const double covered = smaller(s->budget, available_energy(m) - m->reserve / COVERED);
        const double budget = larger(smaller(covered, heaviest_rise(m)), 0.0);
        if (cost <= budget) {
            break;
        }
        step = attempt == 0 ? (1.0 - ROUNDED) * budget / cost - 1.0 : -share; /* from share 1 to what can be paid */
        s->status |= ID(STATUS_TANK_LIMITED);
    }
    book_stiffness(s, &m->elastic_energy, cost);
    s->status |= ID(STATUS_STIFFNESS_CHANGING);
}

/*
 * Return the largest scale, `cap` at most, at which the springs' torque stays within effort limits and reserve beside
 * limit avoidance and the caller's torque. pull: torque of the springs at scale 1.
 */
static double find_target_scale(step_t *s, const double *pull, double cap)
{
    const memory_t *const m = s->m;
    double target = cap, parts[3];
    for (int i = 0; i < N; ++i) {
        const double size = fabs(pull[i]);
        if (size > NO_TORQUE) { /* limit, offset: what the others add in the springs' direction */
            const double limit = pull[i] > 0.0 ? s->out->limit_torque[i] : -s->out->limit_torque[i];
            const double offset = pull[i] > 0.0 ? m->offset[i] : -m->offset[i];
            target = smaller(target, larger((s->c->effort_limit[i] - limit - offset) / size, 0.0));
        }
    }
    s->status |= target < cap ? (uint32_t)ID(STATUS_SATURATED) : 0u;
    compute_reserve(s, m->calls, m->call_gap, pull, parts); /* at the scale l: parts[0] + a l + b l^2 */
    const double most = larger(COVERED * available_energy(m) - parts[0], 0.0), a = parts[1], b = parts[2];
    if ((a + b * target) * target > most) {
        target = solve_share(a, b, most);
        s->status |= ID(STATUS_RESERVE);
    }
    return target;
}

/* Return the largest fall of the scale that the torque follows in one step; 2, more than any scale, without a pull. */
static double find_fastest_fall(const memory_t *m, const double *pull)
{
    double fall = 2.0;
    for (int i = 0; i < N; ++i) {
        const double size = fabs(pull[i]);
        fall = size > NO_TORQUE ? smaller(fall, FALL_SHARE * m->rate[i] / size) : fall;
    }
    return fall;
}

/*
 * Vary the scale: in a fault to zero, as fast as the torque's rate limit allows; else as far as the cap, the effort
 * limits and the reserve allow. pull: torque of the springs at scale 1; energy: their energy. A fall is done at once, a
 * rise takes SCALE_TIME and is paid from the budget.
 */
void vary_scale(step_t *s, const double *pull, double energy, double cap)
{
    memory_t *const m = s->m;
    const config_t *const c = s->c;
    double target = find_target_scale(s, pull, cap);
    if (m->fault != ID(FAULT_NONE) && !holds_in_fault(s)) {
        const double fastest_fall = find_fastest_fall(m, pull);
        target = larger(m->scale - fastest_fall, 0.0);
    }
    const double rise = target - m->scale;
    double step = smaller(rise, c->sample_time / larger(c->stiffness_time, SCALE_TIME));
    if (step > 0.0 && step * energy > larger(s->budget, 0.0)) {
        step = (1.0 - ROUNDED) * larger(s->budget, 0.0) / energy;
        s->status |= ID(STATUS_TANK_LIMITED);
    }
    if (step != 0.0) {
        m->scale = step == rise ? target : m->scale + step; /* exactly, so that a fall ends at 0 */
        book_stiffness(s, &m->elastic_energy, m->scale * energy - m->elastic_energy);
    }
}
