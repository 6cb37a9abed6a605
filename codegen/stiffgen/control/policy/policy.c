/* Policy port: proposals of a slow commander, made into a command for each step. */
#include "policy.h"

static const double SHORTEST_INTERVAL = 1.0 / 60.0; /* [s] of an interpolation: the period of the fastest commander */

/* Advance the port's time; it never goes back. Return whether `now` is finite. */
static int advance_time(policy_t *p, double now)
{
    const int finite = fabs(now) <= DBL_MAX;
    p->now = finite ? larger(p->now, now) : p->now;
    return finite;
}

/* Return how long [s] a part has been stale; 0 for one that is not, or was never accepted. */
static double overdue(const policy_t *p, int part)
{
    const double late = p->now - p->time[part] - p->config.hold_time;
    return p->command.stage[part] == ID(POLICY_STAGE_WAITING) ? 0.0 : larger(late, 0.0);
}

/* Return the share of a fade that is left: 1 before, 0 at its end, with a slope of 0 at both. */
static double share_left(const policy_t *p, double late)
{
    const double x = late > 0.0 ? smaller(late / p->config.fade_time, 1.0) : 0.0; /* a fade_time of 0: at once */
    return 1.0 - x * x * (3.0 - 2.0 * x);
}

/* Return how far the interpolation of a part has come, 0 to 1. */
static double progress(const policy_t *p, int part)
{
    return smaller((p->now - p->begin[part]) / larger(p->interval[part], SHORTEST_INTERVAL), 1.0);
}

/* Return the stage of a part at the port's time; one that was never accepted goes on waiting. */
static int find_stage(const policy_t *p, int part)
{
    const double late = overdue(p, part);
    if (p->command.stage[part] == ID(POLICY_STAGE_WAITING)) {
        return ID(POLICY_STAGE_WAITING);
    }
    if (late > 0.0) {
        return late < p->config.fade_time ? ID(POLICY_STAGE_FADING) : ID(POLICY_STAGE_FADED);
    }
    return progress(p, part) < 1.0 ? ID(POLICY_STAGE_MOVING) : ID(POLICY_STAGE_HOLDING);
}

/* Interpolate linearly, and take the share that a fade leaves: both keep a stiffness positive semidefinite. */
static void mix(int count, double gone, double share, const double *from, const double *to, double *result)
{
    for (int i = 0; i < count; ++i) {
        result[i] = share * ((1.0 - gone) * from[i] + gone * to[i]);
    }
}

/* Return the share of the stiffness: a pose cannot fade, so that a stale pose fades the stiffness, too. */
static double stiffness_share(const policy_t *p)
{
    const double late = larger(overdue(p, ID(POLICY_PART_POSE)), overdue(p, ID(POLICY_PART_STIFFNESS)));
    return p->config.stale_share + (1.0 - p->config.stale_share) * share_left(p, late);
}

static double wrench_share(const policy_t *p) { return share_left(p, overdue(p, ID(POLICY_PART_WRENCH))); }

/*
 * Let an interpolation begin at what is commanded. mix multiplies its start by the share `after`; one that has risen
 * from `before` divides it here: after * from is what is commanded, and nothing jumps. One that falls acts at once.
 */
static void begin_at(int count, const double *commanded, double before, double after, double *from)
{
    const double divisor = after >= before && after > 0.0 ? after : 1.0;
    for (int i = 0; i < count; ++i) {
        from[i] = commanded[i] / divisor;
    }
}

/* Compute what the port commands at its time. The pose goes as it is to a follower, which has the ramps. */
static void interpolate(policy_t *p)
{
    const double share = stiffness_share(p), gone = progress(p, ID(POLICY_PART_STIFFNESS));
    output_t *const out = &p->command;
    mix(9 * TIPS, gone, share, p->from_translation, p->to_translation, out->translation_stiffness);
    mix(9 * TIPS, gone, share, p->from_rotation, p->to_rotation, out->rotation_stiffness);
    mix(6 * TIPS, progress(p, ID(POLICY_PART_WRENCH)), wrench_share(p), p->from_wrench, p->to_wrench,
        out->wrench_command);
    for (int part = 0; part < PARTS; ++part) {
        out->stage[part] = find_stage(p, part);
    }
}

/* Check a time stamp: one ahead of the clock is not believed, since what follows would be refused as too old. */
static refusal_t check_time(const policy_t *p, int part, double time, int timed)
{
    const config_t *const c = &p->config;
    if (!timed || !(fabs(time) <= DBL_MAX)) {
        return refuse(ID(POLICY_REFUSED_TIME), WHOLE, 0.0, 0.0);
    }
    if (time > p->now + c->clock_tolerance) {
        return refuse(ID(POLICY_REFUSED_FUTURE), WHOLE, time - p->now, c->clock_tolerance);
    }
    if (p->command.stage[part] != ID(POLICY_STAGE_WAITING) && time <= p->time[part]) {
        return refuse(ID(POLICY_REFUSED_ORDER), WHOLE, time, p->time[part]);
    }
    const double oldest = c->hold_time + c->fade_time;
    return p->now - time > oldest ? refuse(ID(POLICY_REFUSED_STALE), WHOLE, p->now - time, oldest) : accept();
}

/* Copy numbers that are accepted. */
static void take(refusal_t found, int count, const double *given, double *taken)
{
    for (int i = 0; found.code == ACCEPTED && i < count; ++i) {
        taken[i] = given[i];
    }
}

/* Check a part of a proposal, and accept it for all tips or none. Return why it is refused, or that it is not. */
static refusal_t propose_part(policy_t *p, const proposal_t *proposal, int part)
{
    const config_t *const c = &p->config;
    double Kt[9 * TIPS] = {0.0}, Ko[9 * TIPS] = {0.0};
    refusal_t found = accept();
    switch (part) {
    case ID(POLICY_PART_POSE):
        found = check_poses(c, proposal->pose);
        take(found, 16 * TIPS, proposal->pose, p->command.pose);
        break;
    case ID(POLICY_PART_STIFFNESS):
        found = check_stiffness(proposal->translation_stiffness, c->translation_stiffness_limit, Kt);
        if (found.code == ACCEPTED) { /* entries of rotation_stiffness count on behind the others */
            found = check_stiffness(proposal->rotation_stiffness, c->rotation_stiffness_limit, Ko);
            found.entry += found.code != ACCEPTED ? 9 * TIPS : 0;
        }
        take(found, 9 * TIPS, Kt, p->to_translation);
        take(found, 9 * TIPS, Ko, p->to_rotation);
        break;
    case ID(POLICY_PART_WRENCH):
        found = check_wrench(c, proposal->wrench_command);
        take(found, 6 * TIPS, proposal->wrench_command, p->to_wrench);
        break;
    default: /* the gripper's number is passed on as it is */
        memcpy(&p->command.gripper, &proposal->gripper, sizeof p->command.gripper);
        break;
    }
    return found;
}

/* Note the time of an accepted part; its interpolation takes the commander's period. */
static void note_accepted(policy_t *p, int part, double time)
{
    const double most = larger(p->config.longest_interval, SHORTEST_INTERVAL);
    const int first = p->command.stage[part] == ID(POLICY_STAGE_WAITING);
    p->interval[part] = first ? most : clamp(time - p->time[part], SHORTEST_INTERVAL, most);
    p->begin[part] = p->now;
    p->time[part] = time;
    p->command.stage[part] = ID(POLICY_STAGE_MOVING);
}

/* Accept or refuse each part that is proposed, and note why. Return the number of refused parts. accepted: per part. */
static int propose_parts(policy_t *p, const proposal_t *proposal, int timed, int *accepted)
{
    int refusals = 0;
    for (int part = 0; part < PARTS; ++part) {
        const double time = proposal->time[part];
        const int proposed = proposal->valid[part] == 1;
        refusal_t found = proposed ? check_time(p, part, time, timed) : accept();
        if (proposed && found.code == ACCEPTED) {
            found = propose_part(p, proposal, part);
        }
        accepted[part] = proposed && found.code == ACCEPTED;
        refusals += found.code != ACCEPTED;
        if (accepted[part]) {
            note_accepted(p, part, time);
        }
        p->refused[part] = found.code; /* ACCEPTED clears what was noted before */
        p->refused_entry[part] = found.entry;
        p->refused_seen[part] = found.seen;
        p->refused_limit[part] = found.limit;
    }
    return refusals;
}

/*
 * Accept a proposal, part by part, and note why a part is refused. Return the number of refused parts. The order
 * counts: accepted parts begin at what is commanded now, with the shares from before they were accepted.
 */
int propose(policy_t *p, const proposal_t *proposal, double now)
{
    const int timed = advance_time(p, now);
    int accepted[PARTS];
    interpolate(p); /* p->command: what is commanded now */
    const double before = stiffness_share(p), wrench_before = wrench_share(p);
    const int refusals = propose_parts(p, proposal, timed, accepted);
    const double after = stiffness_share(p);
    /* An accepted pose may raise the stiffness' share by itself: the stiffness goes to its goal anew, with no jump. */
    if (accepted[ID(POLICY_PART_STIFFNESS)] || after > before) {
        begin_at(9 * TIPS, p->command.translation_stiffness, before, after, p->from_translation);
        begin_at(9 * TIPS, p->command.rotation_stiffness, before, after, p->from_rotation);
        p->begin[ID(POLICY_PART_STIFFNESS)] = p->now;
    }
    if (accepted[ID(POLICY_PART_WRENCH)]) { /* no other part changes its share */
        begin_at(6 * TIPS, p->command.wrench_command, wrench_before, wrench_share(p), p->from_wrench);
    }
    return refusals;
}

/* Start a port at poses, without stiffness and wrench. Return OK, or what is wrong. */
int start(const config_t *c, policy_t *p, const double *poses, double now)
{
    if (!(fabs(now) <= DBL_MAX) || check_poses(c, poses).code != ACCEPTED) {
        return fabs(now) <= DBL_MAX ? ID(POLICY_E_POSE) : ID(POLICY_E_TIME);
    }
    p->config = *c;
    p->now = now;
    memcpy(p->command.pose, poses, sizeof p->command.pose);
    p->ready = READY;
    return ID(POLICY_OK);
}

/* Write the command of a time. */
void command(policy_t *p, double now, output_t *out)
{
    advance_time(p, now);
    interpolate(p);
    *out = p->command;
}
