/* Policy port: proposals of a slow commander, made into a command for each step. */
#include "impedance.h"

enum { PARTS = 4 };
static const double SHORTEST_INTERVAL = 1.0 / 60.0; /* [s] of an interpolation: the period of the fastest commander */

static const double LEAD = 0.5; /* of a period that a smoothed pose is ahead of its time stamp: its noise needs time */

/* Return a setting; the default replaces a number that is not finite or out of bounds. */
static double read_setting(double x, double most, double replacement)
{
    return x >= 0.0 && x <= most ? x : replacement;
}

static double hold_time(const policy_t *p)
{
    return read_setting(p->hold_time, 10.0, 0.3);
}

static double fade_time(const policy_t *p)
{
    return read_setting(p->fade_time, 10.0, 0.5);
}

/* Advance the port's time; it never goes back. Return whether `now` is finite. */
static int advance_time(policy_t *p, double now)
{
    if (!(fabs(now) <= DBL_MAX)) {
        return 0;
    }
    p->now = larger(p->now, now);
    return 1;
}

/* Return how long [s] a part has been stale; 0 for one that is not, or was never accepted. */
static double overdue(const policy_t *p, int part)
{
    return p->stage[part] == ID(STAGE_WAITING) ? 0.0 : larger(p->now - p->time[part] - hold_time(p), 0.0);
}

/* Return the share of a fade that is left: 1 before, 0 at its end, with a slope of 0 at both. */
static double share_left(const policy_t *p, double late)
{
    const double fade = fade_time(p);
    double x = late > 0.0 ? 1.0 : 0.0;
    if (late > 0.0 && late < fade) {
        x = late / fade;
    }
    return 1.0 - x * x * (3.0 - 2.0 * x);
}

/* Return how far the interpolation of a part has come, 0 to 1. */
static double progress(const policy_t *p, int part)
{
    const double length = larger(p->interval[part], SHORTEST_INTERVAL);
    return clamp((p->now - p->begin[part]) / length, 0.0, 1.0);
}

/* Set the stage of a part from the port's time; one that was never accepted goes on waiting. */
static void set_stage(policy_t *p, int part)
{
    if (p->stage[part] == ID(STAGE_WAITING)) {
        return;
    }
    const double late = overdue(p, part);
    p->stage[part] = progress(p, part) < 1.0 ? ID(STAGE_MOVING) : ID(STAGE_HOLDING);
    if (late > 0.0) {
        p->stage[part] = late < fade_time(p) ? ID(STAGE_FADING) : ID(STAGE_FADED);
    }
}

/* Interpolate linearly, and multiply by a share. The cone of positive semidefinite matrices is convex. */
static void mix(int count, double x, double share, const double *from, const double *to, double *result)
{
    for (int i = 0; i < count; ++i) {
        result[i] = share * ((1.0 - x) * from[i] + x * to[i]);
    }
}

/* Return the share of the stiffness: a pose cannot fade, so that a stale pose fades the stiffness, too. */
static double stiffness_share(const policy_t *p)
{
    const double end = read_setting(p->stale_share, 1.0, 0.1);
    return end + (1.0 - end) * share_left(p, larger(overdue(p, ID(PART_POSE)), overdue(p, ID(PART_STIFFNESS))));
}

static double wrench_share(const policy_t *p)
{
    return share_left(p, overdue(p, ID(PART_WRENCH)));
}

/*
 * Let an interpolation begin at what is commanded. `after`, the share from now on, multiplies its beginning: this is
 * divided by a share that has risen from `before`, so that nothing jumps. A share that falls acts at once.
 */
static void begin_at(int count, const double *commanded, double before, double after, double *from)
{
    for (int i = 0; i < count; ++i) {
        from[i] = after >= before && after > 0.0 ? commanded[i] / after : commanded[i];
    }
}

static double smoothing(const policy_t *p)
{
    return read_setting(p->smoothing, 0.9, 0.0);
}

/*
 * Compute the way (hybrid axes) of a tip's pose since its interpolation began, and its rate. Without smoothing a
 * straight line; with it a cubic with the velocities of both ends, and beyond its end a stop within another interval.
 */
static void find_way(const policy_t *p, int tip, double *way, double *rate)
{
    const double T = larger(p->interval[ID(PART_POSE)], SHORTEST_INTERVAL), x = progress(p, ID(PART_POSE));
    const double late = clamp((p->now - p->begin[ID(PART_POSE)]) / T - 1.0, 0.0, 1.0);
    const double *const v0 = p->from_velocity + 6 * tip, *const v1 = p->velocity + 6 * tip;
    double all[6];
    pose_difference(p->from_equilibrium + 16 * tip, p->to_equilibrium + 16 * tip, all);
    for (int i = 0; i < 6; ++i) {
        if (smoothing(p) <= 0.0) {
            way[i] = x * all[i];
            rate[i] = x < 1.0 ? all[i] / T : 0.0;
            continue;
        }
        const double bend = x * (1.0 - x) * ((1.0 - x) * v0[i] - x * v1[i]), stop = late * (1.0 - 0.5 * late) * v1[i];
        way[i] = x * x * (3.0 - 2.0 * x) * all[i] + T * (bend + stop);
        rate[i] = 6.0 * x * (1.0 - x) * (all[i] / T) + (1.0 - x) * (1.0 - 3.0 * x) * v0[i] +
                  (late > 0.0 ? 1.0 - late : x * (3.0 * x - 2.0)) * v1[i];
    }
}

/* Compute what the port commands at its time. */
static void interpolate(policy_t *p)
{
    const double x = progress(p, ID(PART_POSE)), y = progress(p, ID(PART_STIFFNESS));
    const double share = stiffness_share(p);
    for (int t = 0; t < TIPS; ++t) {
        double way[6], rate[6];
        find_way(p, t, way, rate);
        move_pose(p->from_equilibrium + 16 * t, way, p->equilibrium + 16 * t);
    }
    if (x >= 1.0 && smoothing(p) <= 0.0) {
        memcpy(p->equilibrium, p->to_equilibrium, sizeof p->equilibrium);
    }
    mix(9 * TIPS, y, share, p->from_translation, p->to_translation, p->translation_stiffness);
    mix(9 * TIPS, y, share, p->from_rotation, p->to_rotation, p->rotation_stiffness);
    mix(6 * TIPS, progress(p, ID(PART_WRENCH)), wrench_share(p), p->from_wrench, p->to_wrench, p->wrench_command);
    for (int part = 0; part < PARTS; ++part) {
        set_stage(p, part);
    }
}

/* Return why a time stamp is refused. */
static int check_time(const policy_t *p, int part, double time, int timed)
{
    if (!timed || !(fabs(time) <= DBL_MAX)) {
        return ID(REFUSED_TIME);
    }
    if (time > p->now + read_setting(p->clock_tolerance, 10.0, 0.005)) {
        return ID(REFUSED_FUTURE);
    }
    if (p->stage[part] != ID(STAGE_WAITING) && time <= p->time[part]) {
        return ID(REFUSED_ORDER);
    }
    return p->now - time > hold_time(p) + fade_time(p) ? ID(REFUSED_STALE) : ID(REFUSED_NONE);
}

/*
 * Take an accepted pose for a measurement of the commander's motion (an alpha-beta filter): correct the predicted pose
 * and its velocity by a share of what the proposal departs from it. elapsed [s]: since the last time stamp; 0: anew.
 */
static void estimate_motion(policy_t *p, int tip, const double *accepted, double elapsed)
{
    const double alpha = 1.0 - smoothing(p), beta = alpha * alpha / (2.0 - alpha);
    double *const estimate = p->estimate + 16 * tip, *const velocity = p->velocity + 6 * tip;
    double way[6] = {0.0}, predicted[16], departure[6];
    if (elapsed <= 0.0 || alpha >= 1.0) {
        memcpy(estimate, accepted, 16 * sizeof(double));
        memcpy(p->to_equilibrium + 16 * tip, accepted, 16 * sizeof(double));
        memset(velocity, 0, 6 * sizeof(double));
        return;
    }
    add_scaled(6, elapsed, velocity, way);
    move_pose(estimate, way, predicted);
    pose_difference(predicted, accepted, departure);
    add_scaled(6, beta / elapsed, departure, velocity);
    for (int i = 0; i < 6; ++i) {
        departure[i] *= alpha;
        way[i] = LEAD * elapsed * velocity[i];
    }
    move_pose(predicted, departure, estimate);
    move_pose(estimate, way, p->to_equilibrium + 16 * tip);
}

/* Accept the poses of all tips, or none; the interpolation begins at the commanded ones. Return why not. */
static int propose_pose(policy_t *p, const proposal_t *proposal, refusal_t *r)
{
    const double elapsed = proposal->time[ID(PART_POSE)] - p->time[ID(PART_POSE)];
    const int begins = p->stage[ID(PART_POSE)] == ID(STAGE_WAITING) || elapsed > hold_time(p);
    double accepted[16 * TIPS];
    for (int t = 0; t < TIPS; ++t) {
        const double reach = stiffgen_reach(t, NULL) + REACH_MARGIN;
        if (!accept_pose(proposal->equilibrium + 16 * t, reach, ID(ARGUMENT_EQUILIBRIUM), t, accepted + 16 * t, r)) {
            return ID(REFUSED_POSE);
        }
    }
    for (int t = 0; t < TIPS; ++t) {
        double way[6], rate[6];
        find_way(p, t, way, rate);
        memcpy(p->from_velocity + 6 * t, rate, sizeof rate);
        memcpy(p->from_equilibrium + 16 * t, p->equilibrium + 16 * t, 16 * sizeof(double));
        estimate_motion(p, t, accepted + 16 * t, begins ? 0.0 : larger(elapsed, SHORTEST_INTERVAL));
    }
    return ID(REFUSED_NONE);
}

/* Check that a tip's stiffness does not couple translation and rotation. Return whether it does not. */
static int check_uncoupled(const double *K, int tip, refusal_t *r)
{
    for (int k = 0; k < 36; ++k) {
        const int i = k / 6, j = k % 6;
        const double most = COMMAND_TOLERANCE * sqrt(fabs(K[7 * i] * K[7 * j]));
        if ((i < 3) != (j < 3) && !(fabs(K[k]) <= most)) {
            const int code = fabs(K[k]) <= DBL_MAX ? ID(REFUSAL_COUPLING) : ID(REFUSAL_NOT_FINITE);
            return refuse_command(r, code, ID(ARGUMENT_STIFFNESS), 36 * tip + k, K[k], most);
        }
    }
    return 1;
}

/* Accept the stiffnesses (6 x 6) of all tips as two blocks each, or none. Return why not. */
static int propose_stiffness(const config_t *c, policy_t *p, const proposal_t *proposal, refusal_t *r)
{
    double Kt[9 * TIPS], Ko[9 * TIPS], block[2][9];
    for (int t = 0; t < TIPS; ++t) {
        const double *const K = proposal->stiffness + 36 * t;
        for (int i = 0; i < 9; ++i) { /* entry (i / 3, i % 3) of the upper left block, and of the lower right one */
            block[0][i] = K[i / 3 * 6 + i % 3];
            block[1][i] = K[(i / 3 + 3) * 6 + i % 3 + 3];
        }
        const int translation = ID(ARGUMENT_TRANSLATION_STIFFNESS), rotation = ID(ARGUMENT_ROTATION_STIFFNESS);
        if (!accept_stiffness(block[0], c->translation_stiffness_limit, translation, t, Kt + 9 * t, r) ||
            !accept_stiffness(block[1], c->rotation_stiffness_limit, rotation, t, Ko + 9 * t, r)) {
            return ID(REFUSED_STIFFNESS);
        }
        if (!check_uncoupled(K, t, r)) {
            return ID(REFUSED_COUPLING);
        }
    }
    memcpy(p->to_translation, Kt, sizeof Kt);
    memcpy(p->to_rotation, Ko, sizeof Ko);
    return ID(REFUSED_NONE);
}

static int propose_wrench(const config_t *c, policy_t *p, const proposal_t *proposal, refusal_t *r)
{
    for (int t = 0; t < TIPS; ++t) {
        const double *const wrench = proposal->wrench_command + 6 * t;
        if (!accept_wrench(c, wrench, t, r)) {
            return ID(REFUSED_WRENCH);
        }
    }
    memcpy(p->to_wrench, proposal->wrench_command, sizeof p->to_wrench);
    return ID(REFUSED_NONE);
}

static int propose_part(const config_t *c, policy_t *p, const proposal_t *proposal, int part, refusal_t *r)
{
    switch (part) {
    case ID(PART_POSE):
        return propose_pose(p, proposal, r);
    case ID(PART_STIFFNESS):
        return propose_stiffness(c, p, proposal, r);
    case ID(PART_WRENCH):
        return propose_wrench(c, p, proposal, r);
    default: /* the gripper's number is passed on as it is */
        memcpy(&p->gripper, &proposal->gripper, sizeof p->gripper);
        return ID(REFUSED_NONE);
    }
}

/* Note what of a part is refused, in numbers. */
static void note_refusal(policy_t *p, int part, const refusal_t *r)
{
    p->refusal[part] = r->code;
    p->refusal_argument[part] = r->command;
    p->refusal_entry[part] = r->entry;
    p->refusal_seen[part] = r->seen;
    p->refusal_limit[part] = r->limit;
}

/* Start a port at poses, without stiffness and wrench. Return an error for poses that are none. */
int start_policy(policy_t *p, const double *poses, double now)
{
    policy_t fresh;
    memset(&fresh, 0, sizeof fresh);
    fresh.hold_time = 0.3;
    fresh.fade_time = 0.5;
    fresh.stale_share = 0.1;
    fresh.longest_interval = 0.1;
    fresh.clock_tolerance = 0.005;
    fresh.now = now;
    int good = fabs(now) <= DBL_MAX;
    for (int t = 0; t < TIPS; ++t) {
        refusal_t r = {ID(REFUSAL_NONE), ID(ARGUMENT_NONE), NO_JOINT, 0.0, 0.0};
        double *const accepted = fresh.equilibrium + 16 * t;
        good = good && accept_pose(poses + 16 * t, FARTHEST, ID(ARGUMENT_EQUILIBRIUM), t, accepted, &r);
    }
    if (!good) {
        return ID(E_POLICY);
    }
    memcpy(fresh.estimate, fresh.equilibrium, sizeof fresh.equilibrium);
    memcpy(fresh.from_equilibrium, fresh.equilibrium, sizeof fresh.equilibrium);
    memcpy(fresh.to_equilibrium, fresh.equilibrium, sizeof fresh.equilibrium);
    *p = fresh;
    return ID(OK);
}

/* Note the time of an accepted part; its interpolation takes the commander's period. */
static void accept_part(policy_t *p, int part, double time)
{
    const double most = larger(read_setting(p->longest_interval, 1.0, 0.1), SHORTEST_INTERVAL);
    const int first = p->stage[part] == ID(STAGE_WAITING);
    p->interval[part] = first ? most : clamp(time - p->time[part], SHORTEST_INTERVAL, most);
    p->begin[part] = p->now;
    p->time[part] = time;
    p->stage[part] = ID(STAGE_MOVING);
}

/*
 * Accept a proposal, part by part, and name in `refused` why a part is refused. Return the number of refused parts.
 * The order counts: accepted parts begin at what is commanded now, with the shares from before they were accepted.
 */
int propose(const config_t *c, policy_t *p, const proposal_t *proposal, double now)
{
    const int timed = advance_time(p, now);
    int refusals = 0, accepted[PARTS] = {0};
    interpolate(p);
    const double share_before = stiffness_share(p), wrench_share_before = wrench_share(p);
    for (int part = 0; part < PARTS; ++part) {
        refusal_t r = {ID(REFUSAL_NONE), ID(ARGUMENT_NONE), NO_JOINT, 0.0, 0.0};
        p->refused[part] = ID(REFUSED_NONE);
        note_refusal(p, part, &r); /* clears the note of the last proposal, also for a part that this one lacks */
        if (proposal->valid[part] != 1) {
            continue;
        }
        const double time = proposal->time[part];
        int refused = check_time(p, part, time, timed);
        refused = refused == ID(REFUSED_NONE) ? propose_part(c, p, proposal, part, &r) : refused;
        p->refused[part] = refused;
        note_refusal(p, part, &r);
        if (refused != ID(REFUSED_NONE)) {
            ++refusals;
            continue;
        }
        accept_part(p, part, time);
        accepted[part] = 1;
    }
    const double share_after = stiffness_share(p);
    /*
     * A stale pose fades the stiffness, so that an accepted pose may raise the stiffness' share by itself.
     * The stiffness would jump up: it goes from what is commanded to its goal anew. Its interval is that of its last
     * proposal, or the shortest where there was none. Where a stiffness is accepted, accept_part has set the same.
     */
    if (accepted[ID(PART_STIFFNESS)] || share_after > share_before) {
        begin_at(9 * TIPS, p->translation_stiffness, share_before, share_after, p->from_translation);
        begin_at(9 * TIPS, p->rotation_stiffness, share_before, share_after, p->from_rotation);
        p->interval[ID(PART_STIFFNESS)] = larger(p->interval[ID(PART_STIFFNESS)], SHORTEST_INTERVAL);
        p->begin[ID(PART_STIFFNESS)] = p->now;
    }
    if (accepted[ID(PART_WRENCH)]) { /* no other part changes its share */
        begin_at(6 * TIPS, p->wrench_command, wrench_share_before, wrench_share(p), p->from_wrench);
    }
    return refusals;
}

/* Write the command for a step at `now` into an input; posture, sample and torque_offset stay as they are. */
void write_command(policy_t *p, double now, input_t *input)
{
    advance_time(p, now);
    interpolate(p);
    input->command = ID(COMMAND_EQUILIBRIUM);
    memcpy(input->equilibrium, p->equilibrium, sizeof input->equilibrium);
    memcpy(input->translation_stiffness, p->translation_stiffness, sizeof input->translation_stiffness);
    memcpy(input->rotation_stiffness, p->rotation_stiffness, sizeof input->rotation_stiffness);
    memcpy(input->wrench_command, p->wrench_command, sizeof input->wrench_command);
    memset(input->velocity, 0, sizeof input->velocity);
    memset(input->acceleration, 0, sizeof input->acceleration);
}
