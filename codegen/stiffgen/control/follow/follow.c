/* From poses of the tips to joint positions: the way's speed, the joints' bounds, and what is out of reach. */
#include "follow.h"

static const double ARRIVED = 1e-3;     /* [s] at full speed from the goal, up to which nothing is out of reach */
static const double STUCK_TIME = 0.3;   /* [s] without progress after which the tips are stuck */
static const double MEAN_TIME = 0.1;    /* [s] of the means that progress is told by */
static const double PROGRESS = 0.1;     /* share of the asked velocity below which there is none */
static const double FREED = 0.5;        /* share of the asked way above which they move freely */
static const double PATIENCE = 5.0, NEARER[2] = {0.01, 0.02}; /* [s] in which the least way falls by a share, or [s] */
static const double OTHER = 0.05;       /* [rad] of a joint from which a posture is another, which may lead on */
static const double LEAST_PUSH = 0.02;  /* share of full speed to a goal that stands still out of reach */
static const double LAG = 0.25;         /* least weight of rotations along a motion that turns */
static const double SLIP = 0.02;        /* [m] of a tip off its place from which rotations have their whole weight */
static const double FINE_TIME = 0.03;   /* [s] from pose to pose up to which a stream is followed as a motion */
static const double COARSE_TIME = 0.5;  /* [s] up to which poses are a stream at all */
static const double COARSE_RAMP = 1.5;  /* times the ramp's time, along a coarse stream, whose noise is no motion */
static const double JOINT_RAMP = 0.25;  /* times the ramp's time in which a joint may reach its velocity limit */
static const double POSTURE_TIME = 0.3; /* [s] in which free joints go to the posture */
static const double FREE = 0.5;         /* share of its velocity limit up to which a joint does so */
static const double AT_REST = 1e-4;     /* share of its velocity limit up to which a joint rests */
static const double SAME = 1e-9;        /* [s] at full speed between poses that are the same */

/* Return the share of full speed that stops within a way [s]: by a ramp, the end exponential, or the arm overshoots. */
double stopping_speed(double way, double slope, double T)
{
    const double settling = 0.5 * T / slope; /* [s] */
    const double speed = way > 0.5 * settling ? sqrt(way / settling - 0.25) : larger(way / settling, slope);
    return smaller(way / T, speed);
}

static int is_idle(const state_t *s) { return s->idle * s->config.sample_time > PATIENCE; }
static int is_stuck(const state_t *s) { return s->stuck * s->config.sample_time > STUCK_TIME || is_idle(s); }

/* Note how much of the asked way the tips went: without progress they are stuck; if they come no nearer, q0 rests. */
static void watch_progress(state_t *s, double way)
{
    const double T = s->config.sample_time, share = smaller(T / MEAN_TIME, 1.0);
    s->asked += share * (smaller(T * way_of(&s->config, s->twist), s->way) - s->asked);
    s->got += share * (s->way - way - s->got);
    const int free = s->got > FREED * s->asked, blocked = s->got < PROGRESS * s->asked && s->stuck < LONGEST;
    s->stuck = free || way < ARRIVED ? 0 : s->stuck + blocked;
    const int nearer = way < s->least - smaller(NEARER[0] * s->least, NEARER[1]);
    const int away = way > ARRIVED ? s->idle < LONGEST : -(s->idle > 0 && !is_idle(s));
    if (!s->by_joints) { /* that way ends by itself */
        s->idle = nearer && s->least > ARRIVED ? 0 : s->idle + away;
    }
    s->least = nearer || s->by_joints ? way : s->least;
    const double more = free || way < ARRIVED ? share : 0.0;
    s->push = clamp(s->push + (is_stuck(s) ? -share * s->push : more), is_idle(s) ? 0.0 : LEAST_PUSH, 1.0);
}

/* Return OK for a pose, of which `clean` is the copy, or what is wrong. */
static int check_pose(const double *pose, double *clean)
{
    const int wrong = has_form_of_pose(pose) ? ID(FOLLOW_E_ROTATION) : ID(FOLLOW_E_POSE);
    return clean_pose(pose, clean) ? ID(FOLLOW_OK) : wrong;
}

/* Adopt what is good of a command: poses with tools, and the posture. Return OK or what is wrong. */
static int take_command(state_t *s, const input_t *input, double *goal)
{
    const config_t *const c = &s->config;
    const double *const given = stiffgen_tool(input);
    double tools[16 * TIPS];
    int result = ID(FOLLOW_OK);
    for (int t = 0; t < TIPS && result == ID(FOLLOW_OK); ++t) {
        const int good = given == NULL || clean_pose(given + 16 * t, tools + 16 * t);
        result = good ? check_pose(input->pose + 16 * t, goal + 16 * t) : ID(FOLLOW_E_TOOL);
    }
    if (result != ID(FOLLOW_OK)) {
        memcpy(goal, s->pose, sizeof s->pose);
    } else if (given != NULL) {
        memcpy(stiffgen_kept_tool(s), tools, sizeof tools);
    }
    if (!doubles_within(input->posture, N, -FARTHEST, FARTHEST)) {
        return result != ID(FOLLOW_OK) ? result : ID(FOLLOW_E_POSTURE);
    }
    for (int i = 0; i < N; ++i) {
        const double margin = c->limit_distance[i], last = s->posture[i];
        s->posture[i] = clamp(input->posture[i], c->lower_limit[i] + margin, c->upper_limit[i] - margin);
        if (is_idle(s) && fabs(s->posture[i] - last) > OTHER) {
            s->stuck = s->idle = 0;
            s->push = 1.0;
        }
    }
    return result;
}

/* Return whether the goal is new; of a motion, a fine stream, it has a velocity, of a coarse stream it is smoothed. */
static int take_goal(state_t *s, const double *goal)
{
    double moved[ROWS] = {0.0};
    if (memcmp(goal, s->pose, sizeof s->pose) != 0) {
        compare_poses(s->pose, goal, moved);
    }
    s->age += s->age < LONGEST;
    const double way = way_of(&s->config, moved), time = s->age * s->config.sample_time;
    const int fine = time <= FINE_TIME && way <= time * (1.0 + SAME);
    if (way > SAME) {
        s->interval = fine || time > COARSE_TIME ? 0.0 : time;
        s->stuck = fine || s->interval > 0.0 ? s->stuck : 0;
        s->idle = fine || s->interval > 0.0 ? s->idle : 0;
        s->least += way; /* a stream that moves makes progress */
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
    return way > SAME;
}

/* Change the tips' velocity: along with a stream, and straight to the goal, by a ramp that stops there. */
static void plan_twist(state_t *s, const step_t *k)
{
    const config_t *const c = &s->config;
    const double T = c->sample_time, slope = T / ((s->interval > 0.0 ? COARSE_RAMP : 1.0) * c->ramp_time);
    double rest[ROWS], change[ROWS];
    for (int r = 0; r < ROWS; ++r) {
        rest[r] = k->rest[r] - T * s->stream[r];
    }
    const double way = way_of(c, rest), smooth = larger(c->smoothing * s->interval, T);
    const double most = smaller(s->push, way_of(c, s->twist) + slope);
    const double speed = smaller(smaller(most, way / smooth), stopping_speed(way, slope, T));
    for (int r = 0; r < ROWS; r += 3) { /* each translation and rotation stops by itself: one may lag */
        const double limit = full_speed(c, r);
        const double own = norm(3, rest + r) / limit;
        const double share = own > 0.0 ? smaller(own * speed / way, stopping_speed(own, slope, T)) / own : 0.0;
        for (int i = r; i < r + 3; ++i) {
            change[i] = s->stream[i] + rest[i] * share;
        }
        const double over = larger(norm(3, change + r) / limit, 1.0);
        for (int i = r; i < r + 3; ++i) {
            change[i] = change[i] / over - s->twist[i];
        }
        const double jump = larger(norm(3, change + r) / (limit * slope), 1.0);
        for (int i = r; i < r + 3; ++i) {
            s->twist[i] += change[i] / jump;
        }
    }
}

/* Bound the joints' velocities: by their limits, a ramp, and a stop before the ends of their ranges. */
static void bound_each_joint(const state_t *s, step_t *k)
{
    const config_t *const c = &s->config;
    const double T = c->sample_time, slope = T / (JOINT_RAMP * c->ramp_time);
    for (int i = 0; i < N; ++i) {
        const double most = c->velocity_limit[i], change = slope * most;
        const double up = larger(c->upper_limit[i] - c->limit_distance[i] - s->q[i], 0.0);
        const double down = larger(s->q[i] - c->lower_limit[i] - c->limit_distance[i], 0.0);
        const double fast = most * smaller(stopping_speed(up / most, slope, T), 1.0);
        const double slow = -most * smaller(stopping_speed(down / most, slope, T), 1.0);
        k->high[i] = clamp(clamp(fast, s->dq[i] - change, s->dq[i] + change), -down / T, up / T);
        k->low[i] = clamp(clamp(slow, s->dq[i] - change, s->dq[i] + change), -down / T, k->high[i]);
    }
}

/* Return whether to go a way by joints to the posture: the tips are stuck, or were, and it has them at the goal. */
static int takes_posture(const state_t *s, const step_t *k, const double *way)
{
    double poses[16 * TIPS], rest[ROWS];
    if (s->by_joints ? norm(N, way) < AT_REST : !is_stuck(s) || s->way < ARRIVED) {
        return 0;
    }
    stiffgen_poses(s->posture, k->tool, poses);
    compare_poses(poses, s->pose, rest);
    return way_of(&s->config, rest) < ARRIVED;
}

/* Go straight to the posture, as fast as joints and tips may, by a ramp. velocity: the way there, then the velocity. */
static void move_to_posture(state_t *s, step_t *k, double *velocity)
{
    const config_t *const c = &s->config;
    const double T = c->sample_time, slope = T / c->ramp_time;
    double last = way_of(c, s->twist); /* share of full speed */
    multiply(k->J, velocity, s->twist);
    double way = way_of(c, s->twist); /* [s] at full speed */
    for (int i = 0; i < N; ++i) {
        way = larger(way, fabs(velocity[i]) / c->velocity_limit[i]);
        last = larger(last, fabs(s->dq[i]) / c->velocity_limit[i]);
    }
    const double speed = smaller(smaller(1.0, last + slope), stopping_speed(way, slope, T));
    for (int i = 0; i < N; ++i) {
        velocity[i] = clamp(way > 0.0 ? velocity[i] * speed / way : 0.0, k->low[i], k->high[i]);
    }
    multiply(k->J, velocity, s->twist);
}

/* Return a rotation's weight: all where the motion keeps it; where the motion turns, a place in reach comes first. */
static double rotation_weight(const state_t *s, const step_t *k, int tip)
{
    const double *const stream = s->stream + 6 * tip;
    const double turning = norm(3, stream + 3) / full_speed(&s->config, 3);
    const double most = larger(turning, norm(3, stream) / full_speed(&s->config, 0));
    const double kept = most > 0.0 ? 1.0 - (1.0 - LAG) * turning / most : LAG;
    return s->period > 0 ? larger(kept, clamp(norm(3, k->rest + 6 * tip) / SLIP, LAG, 1.0)) : 1.0;
}

/* Follow the line; what it leaves free goes to the posture. velocity: the way to the posture, then the velocity. */
static void go_by_line(state_t *s, step_t *k, double *velocity)
{
    double twist[ROWS], J[ROWS * N];
    plan_twist(s, k);
    for (int r = 0; r < ROWS; ++r) {
        const double weight = r % 6 >= 3 ? rotation_weight(s, k, r / 6) : 1.0;
        twist[r] = weight * s->twist[r];
        for (int i = 0; i < N; ++i) {
            J[r * N + i] = weight * k->J[r * N + i];
        }
    }
    for (int i = 0; i < N; ++i) {
        const double most = FREE * s->config.velocity_limit[i];
        const double pull = s->push * clamp(velocity[i] / POSTURE_TIME, -most, most);
        const double loss = s->config.sample_time / POSTURE_TIME * s->dq[i]; /* without it the ramps swing for ever */
        velocity[i] = clamp(pull, k->low[i] - loss, k->high[i] - loss);
    }
    solve_bounded(J, twist, k->low, k->high, velocity);
    keep_margin(s, k, velocity);
}

/* Report where the tips of q0 are short of the goal, and why. */
static void report(const state_t *s, const step_t *k, int result, output_t *out)
{
    int moving = 0;
    for (int i = 0; i < N; ++i) {
        moving = moving || fabs(s->dq[i]) > AT_REST * s->config.velocity_limit[i];
    }
    for (int t = 0; t < TIPS; ++t) {
        out->error[2 * t] = norm(3, k->rest + 6 * t);
        out->error[2 * t + 1] = norm(3, k->rest + 6 * t + 3) / RADIAN;
    }
    memcpy(out->q0, s->q, sizeof out->q0);
    memcpy(out->dq0, s->dq, sizeof out->dq0);
    const int unreachable = is_stuck(s) && !s->by_joints && s->way > ARRIVED;
    const int bits[5] = {moving, s->interval > 0.0, s->by_joints, unreachable, result != ID(FOLLOW_OK)};
    for (int b = 0; b < 5; ++b) {
        out->status |= bits[b] ? 1u << b : 0u;
    }
}

int start(const config_t *c, state_t *s, const double *q)
{
    if (!doubles_within(q, N, -FARTHEST, FARTHEST)) {
        return ID(FOLLOW_E_START);
    }
    s->config = *c;
    memcpy(s->q, q, sizeof s->q);
    memcpy(s->posture, q, sizeof s->posture);
    double *const tools = stiffgen_kept_tool(s);
    for (int k = 0; k < 16 * TIPS && tools != NULL; ++k) {
        tools[k] = k % 16 % 5 == 0 ? 1.0 : 0.0;
    }
    stiffgen_poses(q, tools, s->pose);
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
    double goal[16 * TIPS], here[16 * TIPS], velocity[N];
    step_t k;
    const int result = take_command(s, input, goal);
    k.tool = stiffgen_kept_tool(s);
    stiffgen_poses(s->q, k.tool, here);
    compare_poses(here, s->pose, k.rest);
    watch_progress(s, way_of(&s->config, k.rest));
    if (take_goal(s, goal)) {
        compare_poses(here, s->pose, k.rest);
    }
    s->way = way_of(&s->config, k.rest);
    weighed_jacobian(s->q, k.tool, k.J);
    bound_each_joint(s, &k);
    for (int i = 0; i < N; ++i) {
        velocity[i] = s->posture[i] - s->q[i];
    }
    s->by_joints = takes_posture(s, &k, velocity);
    (s->by_joints ? move_to_posture : go_by_line)(s, &k, velocity);
    for (int i = 0; i < N; ++i) {
        s->dq[i] = velocity[i];
        s->q[i] += s->config.sample_time * velocity[i];
    }
    report(s, &k, result, out);
    return result;
}
