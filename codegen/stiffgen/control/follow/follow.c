/* From poses of the tips to joint positions: the way's speed, the joints' bounds, and what is out of reach. */
#include "follow.h"

static const double ARRIVED = 1e-3;     /* [m] from the goal up to which nothing is out of reach */
static const double STUCK_TIME = 0.3;   /* [s] over which progress is looked at */
static const double PROGRESS = 0.1;     /* share of the asked way below which the tips are stuck */
static const double FREED = 0.5;        /* share of the asked way above which they move freely */
static const double LEAST_PUSH = 0.02;  /* share of full speed to a goal that stands still out of reach */
static const double FINE_TIME = 0.03;   /* [s] from pose to pose up to which a stream is followed as a motion */
static const double COARSE_TIME = 0.5;  /* [s] up to which poses are a stream at all */
static const double JOINT_RAMP = 0.25;  /* times the ramp's time in which a joint may reach its velocity limit */
static const double POSTURE_TIME = 0.3; /* [s] in which free joints go to the posture */
static const double FREE = 0.5;         /* share of its velocity limit up to which a joint does so */
static const double AT_REST = 1e-4;     /* share of its velocity limit up to which a joint rests */
static const double SAME = 1e-9;        /* [s] at full speed between poses that are the same */

/*
 * Return the largest share of full speed from which a ramp of this slope stops within a way [s]; below half of it the
 * stop is exponential: an abrupt end of the braking throws the arm beyond the goal (6 mm for 2).
 */
static double stopping_speed(double way, double slope, double T)
{
    const double settling = 0.5 * T / slope; /* [s] */
    const double speed = way > 0.5 * settling ? sqrt(way / settling - 0.25) : fmax(way / settling, slope);
    return fmin(way / T, speed);
}

static int is_stuck(const state_t *s)
{
    return s->stuck * s->config.sample_time > STUCK_TIME;
}

/* Note how much of the asked way the tips went; after a while without progress short of the goal they are stuck. */
static void watch_progress(state_t *s, const double *here)
{
    const double T = s->config.sample_time, share = T / STUCK_TIME;
    double rest[ROWS];
    compare_poses(here, s->pose, rest);
    const double distance = weigh(rest);
    s->asked += share * (fmin(T * weigh(s->twist), s->distance) - s->asked);
    s->got += share * (s->distance - distance - s->got);
    s->stuck = distance > ARRIVED && s->got < PROGRESS * s->asked ? s->stuck + (s->stuck < LONGEST) : 0;
    const double more = s->got > FREED * s->asked ? share : 0.0;
    s->push = fmin(fmax(s->push + (is_stuck(s) ? -share * s->push : more), LEAST_PUSH), 1.0);
}

/* Adopt the poses of tools, where there are any. Return OK, or what is wrong. */
static int take_tool(state_t *s, const input_t *input)
{
    const double *const given = stiffgen_tool(input);
    double *const kept = stiffgen_kept_tool(s), clean[16 * TIPS];
    for (int t = 0; t < TIPS && given != NULL; ++t) {
        if (clean_pose(given + 16 * t, clean + 16 * t) != ID(FOLLOW_OK)) {
            return ID(FOLLOW_E_TOOL);
        }
    }
    if (given != NULL) {
        memcpy(kept, clean, sizeof clean);
    }
    return ID(FOLLOW_OK);
}

/* Adopt what is good of a command. Return OK, or what is wrong; in its place the last good one stays. */
static int take_command(state_t *s, const input_t *input, step_t *k)
{
    const config_t *const c = &s->config;
    int result = ID(FOLLOW_OK);
    for (int t = 0; t < TIPS && result == ID(FOLLOW_OK); ++t) {
        result = clean_pose(input->pose + 16 * t, k->goal + 16 * t);
    }
    if (result != ID(FOLLOW_OK)) {
        memcpy(k->goal, s->pose, sizeof k->goal);
    }
    if (!all_within(input->posture, N, -FARTHEST, FARTHEST)) {
        return result != ID(FOLLOW_OK) ? result : ID(FOLLOW_E_POSTURE);
    }
    for (int i = 0; i < N; ++i) {
        const double least = c->lower_limit[i] + c->limit_distance[i], most = c->upper_limit[i] - c->limit_distance[i];
        s->posture[i] = fmin(fmax(input->posture[i], least), most);
    }
    return result;
}

/* See whether the goal belongs to a motion, a fine stream with a velocity, or to a coarse stream, which is smoothed. */
static void take_goal(state_t *s, const double *goal)
{
    double moved[ROWS];
    compare_poses(s->pose, goal, moved);
    s->age += s->age < LONGEST;
    const double way = relative_speed(&s->config, moved), time = s->age * s->config.sample_time;
    const int fine = time <= FINE_TIME && way <= time * (1.0 + SAME);
    if (way > SAME) {
        s->interval = fine || time > COARSE_TIME ? 0.0 : time;
        s->stuck = fine || s->interval > 0.0 ? s->stuck : 0;
        s->period = fine ? s->age : 0;
        s->age = 0;
        s->push = 1.0;
        memcpy(s->pose, goal, sizeof s->pose);
    } else if (s->age > 2 * s->period) {
        s->period = 0;
    }
    for (int r = 0; r < ROWS; ++r) {
        const double old = s->period > 0 ? s->stream[r] : 0.0;
        s->stream[r] = way > SAME && fine ? moved[r] / time : old;
    }
    s->interval = s->age * s->config.sample_time > COARSE_TIME ? 0.0 : s->interval;
}

/* Change the tips' velocity: along with a stream, and straight to the goal, by a ramp that stops there. */
static void plan_twist(state_t *s, const step_t *k)
{
    const config_t *const c = &s->config;
    const double T = c->sample_time, slope = T / c->ramp_time;
    double rest[ROWS], change[ROWS];
    for (int r = 0; r < ROWS; ++r) {
        rest[r] = k->rest[r] - T * s->stream[r];
    }
    const double way = relative_speed(c, rest), smooth = fmax(c->smoothing * s->interval, T);
    const double most = fmin(s->push, relative_speed(c, s->twist) + slope);
    const double speed = fmin(fmin(most, way / smooth), stopping_speed(way, slope, T));
    for (int r = 0; r < ROWS; r += 3) { /* each translation and rotation stops by itself: one may lag */
        const double limit = r % 6 < 3 ? c->tip_velocity_limit : RADIAN * c->tip_rotation_limit;
        const double own = norm(3, rest + r) / limit;
        const double share = own > 0.0 ? fmin(own * speed / way, stopping_speed(own, slope, T)) / own : 0.0;
        for (int i = r; i < r + 3; ++i) {
            change[i] = s->stream[i] + rest[i] * share;
        }
        const double over = fmax(norm(3, change + r) / limit, 1.0);
        for (int i = r; i < r + 3; ++i) {
            change[i] = change[i] / over - s->twist[i];
        }
        const double jump = fmax(norm(3, change + r) / (limit * slope), 1.0);
        for (int i = r; i < r + 3; ++i) {
            s->twist[i] += change[i] / jump;
        }
    }
}

/* Bound the joints' velocities: by their limits, a ramp, and a stop before the ends of their ranges. */
static void bound_joints(const state_t *s, step_t *k)
{
    const config_t *const c = &s->config;
    const double T = c->sample_time, slope = T / (JOINT_RAMP * c->ramp_time);
    for (int i = 0; i < N; ++i) {
        const double most = c->velocity_limit[i], change = slope * most;
        const double up = fmax(c->upper_limit[i] - c->limit_distance[i] - s->q[i], 0.0);
        const double down = fmax(s->q[i] - c->lower_limit[i] - c->limit_distance[i], 0.0);
        const double fast = most * fmin(stopping_speed(up / most, slope, T), 1.0);
        const double slow = -most * fmin(stopping_speed(down / most, slope, T), 1.0);
        const double high = fmin(fmax(fmin(fast, s->dq[i] + change), s->dq[i] - change), up / T);
        k->high[i] = fmax(high, -down / T);
        k->low[i] = fmin(fmax(fmin(fmax(slow, s->dq[i] - change), s->dq[i] + change), -down / T), k->high[i]);
    }
}

/* Return whether to go to the posture by joints: the tips are stuck, or were, and the posture has them at the goal. */
static int goes_by_joints(const state_t *s, const step_t *k)
{
    double poses[16 * TIPS], rest[ROWS];
    if (!(s->by_joints || is_stuck(s)) || s->distance < ARRIVED) {
        return 0;
    }
    stiffgen_poses(s->posture, k->tool, poses);
    compare_poses(poses, k->goal, rest);
    return weigh(rest) < ARRIVED;
}

/* Go straight to the posture, as fast as joints and tips may, by a ramp. velocity: the way there, then the velocity. */
static void go_by_joints(state_t *s, const step_t *k, double *velocity)
{
    const config_t *const c = &s->config;
    const double T = c->sample_time, slope = T / c->ramp_time;
    double twist[ROWS], last = relative_speed(c, s->twist); /* share of full speed */
    multiply(k->J, velocity, twist);
    double way = relative_speed(c, twist); /* [s] at full speed */
    for (int i = 0; i < N; ++i) {
        way = fmax(way, fabs(velocity[i]) / c->velocity_limit[i]);
        last = fmax(last, fabs(s->dq[i]) / c->velocity_limit[i]);
    }
    const double speed = fmin(fmin(1.0, way / T), fmin(stopping_speed(way, slope, T), last + slope));
    for (int i = 0; i < N; ++i) {
        const double wanted = way > 0.0 ? velocity[i] * speed / way : 0.0;
        velocity[i] = fmin(fmax(wanted, k->low[i]), k->high[i]);
    }
    multiply(k->J, velocity, s->twist);
}

/* Follow the line; what it leaves free goes to the posture. velocity: the way to the posture, then the velocity. */
static void go_by_line(state_t *s, const step_t *k, double *velocity)
{
    double time = POSTURE_TIME;
    for (int i = 0; i < N; ++i) {
        time = fmax(time, fabs(velocity[i]) / (FREE * k->most[i]));
    }
    for (int i = 0; i < N; ++i) {
        velocity[i] = fmin(fmax(velocity[i] / time, k->low[i]), k->high[i]);
    }
    plan_twist(s, k);
    solve_velocity(k, s->twist, velocity);
    keep_margin(s, k, velocity);
}

/* Report where the tips of q0 are short of the goal, and why. */
static void report(const state_t *s, const step_t *step, int result, output_t *out)
{
    int moving = 0;
    for (int i = 0; i < N; ++i) {
        moving = moving || fabs(s->dq[i]) > AT_REST * step->most[i];
    }
    for (int t = 0; t < TIPS; ++t) {
        out->error[2 * t] = norm(3, step->rest + 6 * t);
        out->error[2 * t + 1] = norm(3, step->rest + 6 * t + 3) / RADIAN;
    }
    memcpy(out->q0, s->q, sizeof out->q0);
    memcpy(out->dq0, s->dq, sizeof out->dq0);
    const int unreachable = is_stuck(s) && !s->by_joints;
    const int bits[5] = {moving, s->interval > 0.0, s->by_joints, unreachable, result != ID(FOLLOW_OK)};
    for (int k = 0; k < 5; ++k) {
        out->status |= bits[k] ? 1u << k : 0u;
    }
}

int start(const config_t *c, state_t *s, const double *q)
{
    memset(s, 0, sizeof *s);
    if (!all_within(q, N, -FARTHEST, FARTHEST)) {
        return ID(FOLLOW_E_START);
    }
    s->config = *c;
    memcpy(s->q, q, sizeof s->q);
    memcpy(s->posture, q, sizeof s->posture);
    for (int i = 0; i < SHORT; ++i) {
        s->weakest[i] = 1.0;
    }
    s->age = LONGEST;
    s->push = 1.0;
    s->ready = READY;
    return ID(FOLLOW_OK);
}

int follow(state_t *s, const input_t *input, output_t *out)
{
    double velocity[N];
    step_t k;
    memset(&k, 0, sizeof k);
    const int tool = take_tool(s, input);
    k.tool = stiffgen_kept_tool(s);
    k.most = s->config.velocity_limit;
    if (s->begun == 0 && tool != ID(FOLLOW_OK)) {
        memcpy(out->q0, s->q, sizeof out->q0);
        return tool;
    }
    stiffgen_poses(s->q, k.tool, k.here);
    if (s->begun == 0) {
        memcpy(s->pose, k.here, sizeof s->pose);
    }
    s->begun = 1;
    watch_progress(s, k.here);
    const int command = take_command(s, input, &k), result = tool != ID(FOLLOW_OK) ? tool : command;
    take_goal(s, k.goal);
    compare_poses(k.here, s->pose, k.rest);
    s->distance = weigh(k.rest);
    weighed_jacobian(s->q, k.tool, k.J);
    bound_joints(s, &k);
    for (int i = 0; i < N; ++i) {
        add_column(k.J, i, 1.0, k.G);
        velocity[i] = s->posture[i] - s->q[i];
    }
    s->by_joints = goes_by_joints(s, &k);
    (s->by_joints ? go_by_joints : go_by_line)(s, &k, velocity);
    for (int i = 0; i < N; ++i) {
        s->dq[i] = velocity[i];
        s->q[i] += s->config.sample_time * velocity[i];
    }
    report(s, &k, result, out);
    return result;
}
