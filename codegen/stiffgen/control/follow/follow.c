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

static int is_idle(const state_t *s) { return s->idle * s->config.sample_time > PATIENCE; }
static int is_stuck(const state_t *s) { return s->stuck * s->config.sample_time > STUCK_TIME || is_idle(s); }

/* Count calls in which the tips hardly go the way that was asked for. Return whether they move freely, or are there. */
static int count_stuck(state_t *s, double way, double share)
{
    const double asked = smaller(s->config.sample_time * over_full_speed(&s->config, s->twist), s->way);
    s->asked += share * (asked - s->asked); /* means over MEAN_TIME */
    s->got += share * (s->way - way - s->got);
    const int free = s->got > FREED * s->asked || way < ARRIVED, blocked = s->got < PROGRESS * s->asked;
    s->stuck = free ? 0 : s->stuck + (blocked && s->stuck < LONGEST);
    return free;
}

/* Count calls since the least way fell by NEARER; a way by joints ends by itself, and may lead away at first. */
static void count_idle(state_t *s, double way)
{
    const int nearer = way < s->least - smaller(NEARER[0] * s->least, NEARER[1]);
    const int more = way > ARRIVED ? s->idle < LONGEST : -(s->idle > 0 && !is_idle(s)); /* 1, 0 or -1 */
    if (!s->by_joints) {
        s->idle = nearer && s->least > ARRIVED ? 0 : s->idle + more;
    }
    s->least = nearer || s->by_joints ? way : s->least;
}

/* Let the tips slow down where they are stuck, and q0 rest if they come no nearer. way [s]: left by the last call. */
static void watch_progress(state_t *s, double way)
{
    const double share = smaller(s->config.sample_time / MEAN_TIME, 1.0); /* of a call in the means */
    const double rise = count_stuck(s, way, share) ? share : 0.0;
    count_idle(s, way);
    const double change = is_stuck(s) ? -share * s->push : rise;
    s->push = clamp(s->push + change, is_idle(s) ? 0.0 : LEAST_PUSH, 1.0);
}

/* Return OK for a pose, of which `clean` is the copy, or what is wrong. */
static int check_pose(const double *pose, double *clean)
{
    const int wrong = has_form_of_pose(pose) ? ID(FOLLOW_E_ROTATION) : ID(FOLLOW_E_POSE);
    return clean_pose(pose, clean) ? ID(FOLLOW_OK) : wrong;
}

/* Adopt what is good of a command: poses with tools, all or none, and the posture. Return OK or what is wrong first. */
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
        if (is_idle(s) && fabs(s->posture[i] - last) > OTHER) { /* it may lead on: idle tips move again */
            s->stuck = s->idle = 0;
            s->push = 1.0;
        }
    }
    return result;
}

/* Adopt the goal: in a fine stream it has a velocity, in a coarse one it is smoothed. Return whether it is new. */
static int take_goal(state_t *s, const double *goal)
{
    double moved[ROWS] = {0.0};
    if (memcmp(goal, s->pose, sizeof s->pose) != 0) {
        weighed_twists(s->pose, goal, moved);
    }
    s->age += s->age < LONGEST;
    const double way = over_full_speed(&s->config, moved), time = s->age * s->config.sample_time; /* [s] */
    const int is_new = way > SAME, fine = time <= FINE_TIME && way <= time * (1.0 + SAME);
    const int coarse = !fine && time <= COARSE_TIME;
    if (is_new) {
        if (!fine && !coarse) {
            s->stuck = s->idle = 0;
        }
        s->interval = coarse ? time : 0.0;
        s->least += way; /* a stream that moves makes progress */
        s->period = fine ? s->age : 0;
        s->age = 0;
        s->push = 1.0;
        memcpy(s->pose, goal, sizeof s->pose);
    } else if (s->age > 2 * s->period) { /* the next pose of the fine stream is overdue */
        s->period = 0;
    }
    for (int r = 0; r < ROWS; ++r) {
        const double last = s->period > 0 ? s->stream[r] : 0.0;
        s->stream[r] = is_new && fine ? moved[r] / time : last;
    }
    s->interval = s->age * s->config.sample_time > COARSE_TIME ? 0.0 : s->interval;
    return is_new;
}

/* Change the tips' velocity: along with a stream, and straight to the goal, by a ramp that stops there. */
static void plan_twist(state_t *s, const step_t *k)
{
    const config_t *const c = &s->config;
    const double T = c->sample_time, ramp_time = (s->interval > 0.0 ? COARSE_RAMP : 1.0) * c->ramp_time;
    const double slope = T / ramp_time; /* change of the share of full speed per sample */
    double rest[ROWS], wanted[3];
    for (int r = 0; r < ROWS; ++r) {
        rest[r] = k->rest[r] - T * s->stream[r];
    }
    const double way = over_full_speed(c, rest), smooth = larger(c->smoothing * s->interval, T); /* [s] */
    const double most = smaller(s->push, over_full_speed(c, s->twist) + slope);
    const double speed = smaller(smaller(most, way / smooth), stopping_speed(way, slope, T));
    for (int r = 0; r < ROWS; r += 3) { /* each translation and rotation stops by itself: one may lag */
        const double limit = full_speed(c, r), own = norm(3, rest + r) / limit; /* [s] */
        const double rate = own > 0.0 ? smaller(own * speed / way, stopping_speed(own, slope, T)) / own : 0.0;
        for (int i = 0; i < 3; ++i) {
            wanted[i] = s->stream[r + i] + rest[r + i] * rate;
        }
        divide(3, larger(norm(3, wanted) / limit, 1.0), wanted);
        steer(wanted, limit * slope, s->twist + r);
    }
}

/* Bound the joints' velocities: by their limits, a ramp, and a stop before the ends of their ranges. */
static void bound_each_joint(const state_t *s, step_t *k)
{
    const config_t *const c = &s->config;
    const double T = c->sample_time, slope = T / (JOINT_RAMP * c->ramp_time);
    for (int i = 0; i < N; ++i) {
        const double most = c->velocity_limit[i], change = slope * most;
        const double up = larger(c->upper_limit[i] - c->limit_distance[i] - s->q[i], 0.0); /* [rad] room */
        const double down = larger(s->q[i] - c->lower_limit[i] - c->limit_distance[i], 0.0);
        const double upward = most * smaller(stopping_speed(up / most, slope, T), 1.0); /* [rad/s] that stops there */
        const double downward = -most * smaller(stopping_speed(down / most, slope, T), 1.0);
        k->high[i] = clamp(clamp(upward, s->dq[i] - change, s->dq[i] + change), -down / T, up / T);
        k->low[i] = clamp(clamp(downward, s->dq[i] - change, s->dq[i] + change), -down / T, k->high[i]);
    }
}

/* Return whether to go a way by joints to the posture: the tips are stuck, or were, and it has them at the goal. */
static int uses_joint_way(const state_t *s, const step_t *k, const double *way)
{
    double poses[16 * TIPS], rest[ROWS];
    const int ends = norm(N, way) < AT_REST, begins = is_stuck(s) && !(s->way < ARRIVED);
    if (s->by_joints ? ends : !begins) {
        return 0;
    }
    stiffgen_poses(s->posture, k->tool, poses);
    weighed_twists(poses, s->pose, rest);
    return over_full_speed(&s->config, rest) < ARRIVED;
}

/* Go straight to the posture, a way [rad] of the joints, as fast as joints and tips may, by a ramp. */
static void move_to_posture(state_t *s, step_t *k, const double *way, double *velocity)
{
    const config_t *const c = &s->config;
    const double T = c->sample_time, slope = T / c->ramp_time;
    double way_of_tips[ROWS];
    multiply(k->J, way, way_of_tips);
    double time = over_full_speed(c, way_of_tips), last = over_full_speed(c, s->twist); /* [s]; share of full speed */
    for (int i = 0; i < N; ++i) {
        time = larger(time, fabs(way[i]) / c->velocity_limit[i]);
        last = larger(last, fabs(s->dq[i]) / c->velocity_limit[i]);
    }
    const double speed = smaller(smaller(1.0, last + slope), stopping_speed(time, slope, T));
    for (int i = 0; i < N; ++i) {
        velocity[i] = clamp(time > 0.0 ? way[i] * speed / time : 0.0, k->low[i], k->high[i]);
    }
    multiply(k->J, velocity, s->twist);
}

/* Return a rotation's weight: all where the motion keeps it; where the motion turns, a place in reach comes first. */
static double rotation_weight(const state_t *s, const step_t *k, int tip)
{
    const double *const stream = s->stream + 6 * tip;
    const double turning = norm(3, stream + 3) / full_speed(&s->config, 3); /* share of full speed, as the next */
    const double most = larger(turning, norm(3, stream) / full_speed(&s->config, 0));
    const double kept = most > 0.0 ? 1.0 - (1.0 - LAG) * turning / most : LAG;
    const double slipped = clamp(norm(3, k->rest + 6 * tip) / SLIP, LAG, 1.0); /* off its place the tip keeps it, too */
    return s->period > 0 ? larger(kept, slipped) : 1.0;
}

/* Follow the line; what it leaves free goes a way [rad] of the joints, to the posture. */
static void go_by_line(state_t *s, step_t *k, const double *way, double *velocity)
{
    double twist[ROWS], J[ROWS * N];
    plan_twist(s, k);
    for (int r = 0; r < ROWS; ++r) {
        const double weight = is_rotation(r) ? rotation_weight(s, k, r / 6) : 1.0;
        twist[r] = weight * s->twist[r];
        for (int i = 0; i < N; ++i) {
            J[r * N + i] = weight * k->J[r * N + i];
        }
    }
    for (int i = 0; i < N; ++i) {
        const double most = FREE * s->config.velocity_limit[i];
        const double pull = s->push * clamp(way[i] / POSTURE_TIME, -most, most);
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
    out->status |= moving ? (uint32_t)ID(FOLLOW_MOVING) : 0u;
    out->status |= s->interval > 0.0 ? (uint32_t)ID(FOLLOW_SMOOTHED) : 0u;
    out->status |= s->by_joints ? (uint32_t)ID(FOLLOW_BY_JOINTS) : 0u;
    out->status |= unreachable ? (uint32_t)ID(FOLLOW_UNREACHABLE) : 0u;
    out->status |= result != ID(FOLLOW_OK) ? (uint32_t)ID(FOLLOW_REFUSED) : 0u;
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
        tools[k] = k % 16 % 5 == 0 ? 1.0 : 0.0; /* unit matrices */
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

/* Do a call. What the last one reached is judged before the new goal counts. */
int follow(state_t *s, const input_t *input, output_t *out)
{
    double goal[16 * TIPS], here[16 * TIPS], way[N], velocity[N];
    step_t k;
    const int result = take_command(s, input, goal);
    k.tool = stiffgen_kept_tool(s);
    stiffgen_poses(s->q, k.tool, here);
    weighed_twists(here, s->pose, k.rest);
    watch_progress(s, over_full_speed(&s->config, k.rest));
    if (take_goal(s, goal)) {
        weighed_twists(here, s->pose, k.rest);
    }
    s->way = over_full_speed(&s->config, k.rest);
    weighed_jacobian(s->q, k.tool, k.J);
    bound_each_joint(s, &k);
    for (int i = 0; i < N; ++i) {
        way[i] = s->posture[i] - s->q[i];
    }
    s->by_joints = uses_joint_way(s, &k, way);
    (s->by_joints ? move_to_posture : go_by_line)(s, &k, way, velocity);
    for (int i = 0; i < N; ++i) {
        s->dq[i] = velocity[i];
        s->q[i] += s->config.sample_time * velocity[i];
    }
    report(s, &k, result, out);
    return result;
}
