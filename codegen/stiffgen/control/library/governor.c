/* Governor: the equilibrium follows the wanted one, within bounds on its velocity, force and work. */
#include "impedance.h"

static const double ARRIVED = 1e-12; /* [s] of travel that is the rounding of poses: the goal is reached */
static const double NEXT_SHARE = 0.9; /* of the share that should do: the energy is not linear */
static const double TIP_RAMP = 2.0; /* ramp times in which an equilibrium by pose reaches its largest velocity */
static const double SAME_POSE = 1e-6; /* [m] or [rad] per call up to which a commanded pose is the same */
static const double STATIONARY = 1e-5; /* [s] of travel below which a posture does not move on */
static const double PATH_LEAD = 0.03; /* [m] or [rad] from posture to equilibrium: it slows, and at twice this waits */
static const double SLOWEST = 0.1; /* share of its velocity limits that an equilibrium keeps until it waits */
static const double RESTING = 0.03; /* [rad/s] or [m/s] up to which an arm rests */
static const double UNLOADED = 0.5; /* [N m] or [N] up to which an arm at rest has no load */
static const double CREEPING = 1e-3; /* [s] of travel: a slower posture that is waited for is at its end */

/*
 * Return the largest norm of the vectors of x, each of the given length, over the governor's share of its velocity
 * limit: of a motion the time [s] that it takes, of a velocity the share of the limit.
 */
static double relative_size(int count, int length, const double *x, const double *limits)
{
    double most = 0.0;
    for (int k = 0; k < count; k += length) {
        const double size = length == 1 ? fabs(x[k]) : norm(length, x + k);
        most = larger(most, size / (GOVERNOR * limits[k / length]));
    }
    return most;
}

/*
 * Return the largest share v of the limits from which a velocity that falls by `slope` per step covers no more than the
 * way [steps at the limits]: the sum of v, v - slope, ... is v (v + slope) / (2 slope).
 */
static double find_stoppable_speed(double slope, double way)
{
    return sqrt(0.25 * slope * slope + 2.0 * slope * way) - 0.5 * slope;
}

/* Move a velocity towards target, by at most `slope` of its limits. */
static void ramp_towards(double slope, int count, int length, const double *target, const double *limits,
                         double *velocity)
{
    double change[MAX_ROWS] = {0.0};
    for (int i = 0; i < count; ++i) {
        change[i] = target[i] - velocity[i];
    }
    const double jump = relative_size(count, length, change, limits);
    add_scaled(count, jump > slope ? slope / jump : 1.0, change, velocity);
}

/*
 * Update the velocity towards a goal: the goal's own velocity, if it is within the limits, and a velocity that reduces
 * the remaining distance to zero and from which the ramp can stop. ramp: time of that [s]; away: from here to the goal,
 * including `moved`, the goal's motion since the last step.
 */
static void approach_goal(const config_t *c, double ramp, int count, int length, const double *away,
                          const double *moved, const double *limits, double *velocity)
{
    const double T = c->sample_time, slope = T / ramp;
    double target[MAX_ROWS] = {0.0}, rest[MAX_ROWS] = {0.0};
    const int follow = relative_size(count, length, moved, limits) <= T;
    for (int i = 0; i < count; ++i) {
        rest[i] = away[i] - (follow ? moved[i] : 0.0);
    }
    const double way = relative_size(count, length, rest, limits);
    const double speed = smaller(smaller(way / T, 1.0), find_stoppable_speed(slope, way / T));
    for (int i = 0; i < count; ++i) {
        target[i] = (follow ? moved[i] / T : 0.0) + (way > 0.0 ? rest[i] * (speed / way) : 0.0);
    }
    const double size = relative_size(count, length, target, limits);
    for (int i = 0; i < count; ++i) {
        target[i] = target[i] / larger(size, 1.0);
    }
    ramp_towards(slope, count, length, target, limits, velocity);
}

/* Predict posture and equilibrium after a share of this step's motion. */
static void predict_equilibrium(const step_t *s, double share, int by_posture, double *posture, double *equilibrium)
{
    const memory_t *const m = s->m;
    const double time = share * s->c->sample_time;
    memcpy(posture, m->posture, N * sizeof(double));
    if (by_posture) {
        add_scaled(N, time, m->posture_velocity, posture);
        stiffgen_poses(posture, m, equilibrium);
        return;
    }
    for (int t = 0; t < TIPS; ++t) {
        double twist[6] = {0.0};
        add_scaled(6, time, m->equilibrium_velocity + 6 * t, twist);
        move_pose(m->equilibrium + 16 * t, twist, equilibrium + 16 * t);
    }
}

/*
 * Move the posture's velocity towards a share of the step per call, within the share `most` of its limits and so that a
 * ramp can stop it. size: of the step, over the limits [s].
 */
static void approach_step(const config_t *c, const double *step, double size, double most, double *velocity)
{
    const double T = c->sample_time, slope = T / c->ramp_time, stop = find_stoppable_speed(slope, size / T);
    const double speed = smaller(smaller(STEP_SHARE * size / T, most), stop), share = size > 0.0 ? speed / size : 0.0;
    double target[N];
    for (int i = 0; i < N; ++i) {
        target[i] = share * step[i];
    }
    ramp_towards(slope, N, 1, target, c->reference_velocity_limit, velocity);
}

/* Return whether the arm rests without a load in another posture than the reference's. */
static int rests_elsewhere(const step_t *s)
{
    const memory_t *const m = s->m;
    return is_far_behind(m) && norm(N, m->dq) < RESTING && norm(N, s->transit) < UNLOADED;
}

/*
 * Update the posture's velocity towards a posture of the pose that is commanded, nearest to the wanted one. The posture
 * follows the equilibrium. Where it ends short of the equilibrium, the pose is out of reach from here (beyond): the
 * posture then goes towards the pose itself, as near as it can, and the equilibrium goes where the posture is. No other
 * posture is searched, since it would move the arm unasked (search_posture). here: pose of the posture; ahead: twists
 * from it to the equilibrium; arrived: the equilibrium is at its goal. Return whether the posture is still on its way.
 */
static int approach_posture(step_t *s, const double *here, const double *ahead, int arrived)
{
    const config_t *const c = s->c;
    memory_t *const m = s->m;
    const double lead = largest_part(ahead);
    double step[N] = {0.0}, error[TIP_ROWS] = {0.0};
    if (!s->commanded) {
        approach_step(c, step, 0.0, 1.0, m->posture_velocity);
        return 0;
    }
    /* beyond the reach the equilibrium follows, and the posture waits for it; else it may wait for the posture */
    const int waits = m->beyond && lead > PATH_LEAD, awaited = !m->beyond && lead >= 2.0 * PATH_LEAD;
    if (m->beyond) {
        (void)compare_poses(here, s->goal, error);
    }
    const double distance = find_posture_step(c, m, m->posture, m->beyond ? error : ahead, s->q0, step);
    if (m->beyond) {
        step_to_wanted(m, s->q0, distance, s->goal, step);
    }
    const double size = relative_size(N, 1, step, c->reference_velocity_limit);
    const int stands = size <= (awaited ? CREEPING : STATIONARY);
    const int ends_short = stands && distance > REACHED && !m->beyond; /* beyond the reach from this call on */
    const int moving = !stands || waits || !arrived || ends_short;
    m->beyond = distance > REACHED && (m->beyond || ends_short);
    const int unreachable = !moving && (distance > REACHED || rests_elsewhere(s));
    s->status |= unreachable ? (uint32_t)ID(STATUS_UNREACHABLE) : 0u;
    if (waits) {
        memset(step, 0, sizeof step);
    }
    /* a posture that leads is slow until the arm has followed */
    approach_step(c, step, size, m->beyond && leads_away(m, step) ? SLOWEST : 1.0, m->posture_velocity);
    return moving;
}

/*
 * Update the equilibrium's velocity towards a goal. away: twists from the equilibrium to it; moved: twists of its own
 * motion since the last step; pace: share of the velocity limits that it uses, at most 1, and 0 or less to wait. Return
 * whether it has arrived.
 */
static int approach_poses(step_t *s, const double *away, const double *moved, double pace)
{
    const config_t *const c = s->c;
    memory_t *const m = s->m;
    const double share = clamp(pace, SLOWEST, 1.0);
    const double tip_limits[2] = {share * c->tip_velocity_limit, share * c->tip_rotation_limit};
    int arrived = 1;
    for (int t = 0; t < TIPS; ++t) {
        arrived &= relative_size(6, 3, away + 6 * t, tip_limits) <= ARRIVED;
        if (pace <= 0.0) { /* wait: stop at once, without a ramp */
            memset(m->equilibrium_velocity + 6 * t, 0, 6 * sizeof(double));
            continue;
        }
        /* slow, it still stops as fast: less would carry it beyond its goal */
        approach_goal(c, TIP_RAMP * c->ramp_time * share, 6, 3, away + 6 * t, moved + 6 * t, tip_limits,
                      m->equilibrium_velocity + 6 * t);
    }
    return arrived;
}

/*
 * Find the share of its velocity limits that an equilibrium by pose uses; at 0 and below it waits (approach_poses). It
 * goes no farther ahead of its posture than the posture can follow (lead: distance from the pose of the posture).
 * Where the commanded pose is out of reach (beyond), lead does not count: the equilibrium then goes to the posture. It
 * is slow while the arm is deep in a limit zone, and waits while its springs push the arm out of the limits, unless its
 * way lowers this push.
 */
static double find_pace(const step_t *s, double lead)
{
    const memory_t *const m = s->m;
    double depth = 0.0;
    for (int i = 0; i < N; ++i) {
        depth = larger(depth, larger(find_depth(m, i, -1.0), find_depth(m, i, 1.0)));
    }
    if (depth >= s->c->limit_zone && is_pushed_out(s)) {
        return 0.0;
    }
    /*
     * by depth: 1 outside the zones, SLOWEST from their middle on (validate keeps limit_zone above 0); by lead: below 1
     * from PATH_LEAD, 0 at twice that, and below 0 farther out
     */
    const double by_depth = larger(1.0 - 2.0 * depth / larger(s->c->limit_zone, DBL_MIN), SLOWEST);
    return m->beyond ? by_depth : smaller(by_depth, 2.0 - lead / PATH_LEAD);
}

/* Update the velocities towards a commanded pose. Return whether posture or equilibrium is still away from its goal. */
static int follow_pose(step_t *s)
{
    memory_t *const m = s->m;
    double here[16 * TIPS], ahead[TIP_ROWS] = {0.0}, twists[TIP_ROWS] = {0.0};
    stiffgen_poses(m->posture, m, here);
    const double streamed = largest_part(s->moved);
    if (streamed > SAME_POSE) {
        /* beyond the reach, the posture goes on towards the poses of a stream: waiting for each, it would stop */
        m->beyond = m->beyond && streamed <= PATH_LEAD && compare_poses(here, s->goal, twists) > PATH_LEAD;
    }
    const double lead = compare_poses(here, m->equilibrium, ahead);
    for (int k = 0; s->commanded && m->beyond && k < TIP_ROWS; ++k) { /* the equilibrium goes to the posture's pose */
        s->away[k] = -ahead[k];
        s->moved[k] = 0.0;
    }
    const int arrived = approach_poses(s, s->away, s->moved, find_pace(s, lead));
    return approach_posture(s, here, ahead, arrived) || !arrived;
}

/* After commands by pose, let the equilibrium join the posture's pose. Return whether it is still away from it. */
static int join_posture(step_t *s)
{
    const double still[TIP_ROWS] = {0.0};
    double here[16 * TIPS], away[TIP_ROWS] = {0.0};
    stiffgen_poses(s->m->posture, s->m, here);
    if (s->commanded) {
        (void)compare_poses(s->m->equilibrium, here, away);
    }
    const int arrived = approach_poses(s, away, still, 1.0);
    s->m->joined = s->commanded && arrived;
    return !arrived;
}

/*
 * Update the velocities of posture and equilibrium. by_posture: the equilibrium is the pose of its posture. Else a
 * command by q0 first stops the posture until the equilibrium joins it. Return whether either is away from its goal.
 */
static int update_velocities(step_t *s, int by_posture)
{
    memory_t *const m = s->m;
    double away[MAX_ROWS], moved[MAX_ROWS];
    int moving = 0, joining = s->input->command == ID(COMMAND_POSITION) && !by_posture;
    if (!by_posture && !joining) {
        return follow_pose(s);
    }
    for (int i = 0; i < N; ++i) {
        away[i] = s->commanded && !joining ? s->q0[i] - m->posture[i] : 0.0;
        moved[i] = s->commanded && !joining ? s->q0[i] - m->wanted_posture[i] : 0.0;
        moving |= away[i] != 0.0;
    }
    approach_goal(s->c, s->c->ramp_time, N, 1, away, moved, s->c->reference_velocity_limit, m->posture_velocity);
    return joining ? join_posture(s) || moving : moving;
}

/*
 * Return the time [s] that the governor's velocity limits need for the largest of the motion from posture to goal and
 * the twists of the tips.
 */
double travel_between(const config_t *c, const double *posture, const double *goal, const double *twists)
{
    const double tip_limits[2] = {c->tip_velocity_limit, c->tip_rotation_limit};
    double away[N];
    for (int i = 0; i < N; ++i) {
        away[i] = goal[i] - posture[i];
    }
    double travel = relative_size(N, 1, away, c->reference_velocity_limit);
    for (int t = 0; t < TIPS; ++t) {
        travel = larger(travel, relative_size(6, 3, twists + 6 * t, tip_limits));
    }
    return travel;
}

/*
 * Let a moving command bring in reference work, by the distance that it moves: an engagement limit per TRAVEL_TIME of
 * the equilibrium's travel. What the command moved is paid out no faster than the equilibrium can travel, and no
 * further than the equilibrium is away from the command.
 */
static void pay_for_travel(step_t *s)
{
    const config_t *const c = s->c;
    memory_t *const m = s->m;
    const int by_pose = s->input->command == ID(COMMAND_EQUILIBRIUM);
    if (!s->commanded) {
        return;
    }
    if (by_pose && !m->by_pose) { /* the last command was q0: its poses */
        stiffgen_poses(m->wanted_posture, m, m->wanted_equilibrium);
    }
    if (!by_pose && (m->by_pose || !m->joined)) { /* poses of this q0, where they are compared below */
        stiffgen_poses(s->q0, m, s->goal);
    }
    /* poses count where a command by pose is one of the two that are compared */
    if (by_pose || m->by_pose) {
        (void)compare_poses(m->wanted_equilibrium, s->goal, s->moved);
    }
    if (by_pose || !m->joined) {
        (void)compare_poses(m->equilibrium, s->goal, s->away);
    }
    const double moved = travel_between(c, m->wanted_posture, s->q0, s->moved);
    const double away = travel_between(c, m->posture, s->q0, s->away);
    m->travel = smaller(m->travel + moved, away);
    const double paid = smaller(m->travel, c->sample_time);
    const double work = m->engagement + s->engagement_limit * (paid / TRAVEL_TIME);
    m->travel -= paid;
    m->engagement = larger(m->engagement, smaller(work, s->engagement_limit));
    m->by_pose = by_pose;
}

/* Return the work [J] that the engagement has left for moves of posture and equilibrium. */
static double work_left(const memory_t *m)
{
    return larger(m->engagement - worst_feed_work(m, m->feed, m->call_gap), 0.0);
}

/*
 * Move the posture by itself, where closed loops allow it and the engagement can pay what its spring stores. Return the
 * rise of its energy.
 */
static double move_posture(step_t *s)
{
    memory_t *const m = s->m;
    double posture[N];
    memcpy(posture, m->posture, sizeof posture);
    add_scaled(N, s->c->sample_time, m->posture_velocity, posture);
    const double before = add_posture_energy(m, m->q, m->posture, 0.0);
    const double rise = m->scale * (add_posture_energy(m, m->q, posture, 0.0) - before);
    if (rise > work_left(m) || !stiffgen_reaches(posture, m)) {
        memset(m->posture_velocity, 0, sizeof m->posture_velocity);
        s->status |= ID(STATUS_GOVERNOR);
        return 0.0;
    }
    memcpy(m->posture, posture, sizeof posture);
    m->elastic_energy += rise;
    return rise;
}

/*
 * Find the share of this step's motion that keeps the tip's velocity, the energy stored in the tips' springs (where a
 * load holds it above the limit, it must not rise) and the work left to the engagement, after that of the posture's own
 * motion. Results: posture and equilibrium there, and the rise of the stored energy.
 */
static double find_share(step_t *s, int by_posture, double own, double *posture, double *equilibrium, double *rise)
{
    const config_t *const c = s->c;
    memory_t *const m = s->m;
    const double tip_limits[2] = {c->tip_velocity_limit, c->tip_rotation_limit};
    const double left = work_left(m) - own, tips = m->scale * s->tip_energy;
    const double allowed = smaller(larger(s->energy_limit - tips, 0.0), left); /* of tip_rise */
    double share = 1.0;
    int reached = 0;
    for (int attempt = 0; attempt < 5 && !reached; ++attempt) {
        double speed = 0.0, twist[6];
        predict_equilibrium(s, share, by_posture, posture, equilibrium);
        for (int t = 0; by_posture && t < TIPS; ++t) {
            pose_difference(m->equilibrium + 16 * t, equilibrium + 16 * t, twist);
            speed = larger(speed, relative_size(6, 3, twist, tip_limits) / c->sample_time);
        }
        const double energy = compute_tip_energy(m, m->q, equilibrium), tip_rise = m->scale * energy - tips;
        *rise = m->scale * add_posture_energy(m, m->q, posture, energy) - m->elastic_energy;
        reached = speed <= 1.0 && tip_rise <= allowed && *rise <= left;
        if (speed > 1.0) {
            share *= (1.0 - ROUNDED) / speed;
        } else if (!reached) { /* the share that would do if the energies were linear, or at last none */
            const double covered = smaller(allowed / larger(tip_rise, allowed), left / larger(*rise, left));
            share *= attempt < 3 && allowed > 0.0 ? NEXT_SHARE * covered : 0.0;
            s->status |= ID(STATUS_GOVERNOR);
        }
    }
    return reached ? share : 0.0;
}

/* Move the equilibrium towards the wanted one, within the governor's bounds. */
void move_equilibrium(step_t *s)
{
    memory_t *const m = s->m;
    double posture[N], equilibrium[16 * TIPS], rise = 0.0;
    pay_for_travel(s); /* compares this command with the last one, which is replaced at the end */
    const int by_posture = m->joined && (!s->commanded || s->input->command == ID(COMMAND_POSITION));
    const int moving = update_velocities(s, by_posture);
    const double own = by_posture ? 0.0 : move_posture(s);
    const double share = find_share(s, by_posture, own, posture, equilibrium, &rise);
    s->status |= moving ? (uint32_t)ID(STATUS_MOVING) : 0u;
    for (int i = 0; by_posture && i < N; ++i) {
        m->posture_velocity[i] *= share;
    }
    for (int k = 0; k < 6 * TIPS; ++k) {
        m->equilibrium_velocity[k] *= by_posture ? 0.0 : share;
    }
    if (share > 0.0) {
        memcpy(m->posture, posture, sizeof posture);
        memcpy(m->equilibrium, equilibrium, sizeof equilibrium);
        m->elastic_energy += rise;
    }
    /* posture and equilibrium are one move: what one releases pays for the other */
    book_reference(s, own + (share > 0.0 ? rise : 0.0));
    if (s->commanded) {
        memcpy(m->wanted_posture, s->q0, sizeof posture);
        if (s->input->command == ID(COMMAND_EQUILIBRIUM)) {
            memcpy(m->wanted_equilibrium, s->goal, sizeof equilibrium);
            m->joined = 0;
        }
    }
}

/* Take stiffness, tool and goal from an accepted command; nothing is stored in the springs. */
static void adopt_command(step_t *s)
{
    memory_t *const m = s->m;
    memcpy(m->translation_stiffness, s->translation, 9 * TIPS * sizeof(double));
    memcpy(m->rotation_stiffness, s->rotation, 9 * TIPS * sizeof(double));
    memcpy(m->wanted_posture, s->q0, sizeof m->wanted_posture);
    memcpy(m->wanted_equilibrium, s->goal, sizeof m->wanted_equilibrium);
    if (stiffgen_tool(s->input) != NULL) {
        memcpy(m->tool_pose, stiffgen_tool(s->input), sizeof m->tool_pose);
        s->has_jacobians = 0;
    }
    m->by_pose = s->input->command == ID(COMMAND_EQUILIBRIUM);
    m->commanded = 1;
}

/* Start an engagement. Its energy is paid where the call ends without a fault: pay_engagement. */
static void start_engagement(step_t *s)
{
    memory_t *const m = s->m;
    m->engaged = 1;
    m->scale = 1.0;
    measure_inertia(s, m->q);
    if (available_energy(m) < 0.0) {
        /* more was put out than there was: the account ends here, and begins anew */
        m->unaccounted += 1u;
        m->supplied -= available_energy(m);
        m->tank -= available_energy(m);
    }
    s->lack = clamp(s->tank_initial - m->tank, 0.0, s->engagement_limit);
    s->started = 1;
}

/* Pay the energy of an engagement that this call started: it first makes up for what the tank lacks. */
void pay_engagement(step_t *s)
{
    memory_t *const m = s->m;
    if (s->started && m->fault == ID(FAULT_NONE)) {
        m->tank += s->lack;
        m->supplied += s->lack;
        m->engagement = s->engagement_limit - s->lack;
    }
}

/* Settle the springs at the arm, where they store nothing: equilibrium, stiffness, tool and spring may change. */
void settle_springs(step_t *s)
{
    memory_t *const m = s->m;
    m->spring = s->c->spring;
    for (int t = 0; t < TIPS; ++t) {
        m->spring_limits[t] = s->c->spring_force_limit;
        m->spring_limits[TIPS + t] = s->c->spring_moment_limit;
    }
    memcpy(m->posture, m->q, sizeof m->posture);
    memset(m->posture_velocity, 0, sizeof m->posture_velocity);
    memset(m->equilibrium_velocity, 0, sizeof m->equilibrium_velocity);
    memcpy(m->posture_stiffness, s->c->posture_stiffness, sizeof m->posture_stiffness);
    m->scale = m->elastic_energy = m->travel = 0.0;
    m->joined = 1;
    m->beyond = 0;
    if (s->commanded) {
        adopt_command(s);
    }
    stiffgen_poses(m->q, m, m->equilibrium);
    if (s->commanded && m->fault == ID(FAULT_NONE)) {
        start_engagement(s);
    }
}
