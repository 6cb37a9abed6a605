/* An object that several tips hold: one straight, shaped way, no faster than all tips follow. */
#include "carry.h"

static const double SPARE = 0.8;            /* share of the tips' full speed along the way */
static const double LEFT[2] = {3e-4, 1e-3}; /* [m], [rad] of a tip off its place at which the object waits for it */
static const double BRAKES = 4.0;           /* times the ramp's acceleration */
static const double WAITING = 0.9;          /* share of LEFT from which it counts as waiting */
static const double WAITED = 0.3;           /* [s] after which the rest of the way is out of reach */
static const double THERE = 1e-9;           /* [s] at full speed */

/* Compute the pose a b: that of a frame whose pose in the frame of a is b. */
static void place(const double *a, const double *b, double *pose)
{
    for (int i = 0; i < 3; ++i) {
        const double *const row = a + 4 * i;
        for (int j = 0; j < 4; ++j) {
            const double column[3] = {b[j], b[4 + j], b[8 + j]};
            pose[4 * i + j] = dot(3, row, column) + (j == 3 ? row[3] : 0.0);
        }
    }
    memcpy(pose + 12, a + 12, 4 * sizeof *pose);
}

/* Return a twist over limits of translation and rotation, the larger part; over speeds a way is a time [s]. */
static double over_limits(const double *twist, const double *limits)
{
    return larger(norm(3, twist) / limits[0], norm(3, twist + 3) / limits[1]);
}

/* Compute how far each tip, at `here`, is off its place, over LEFT: 1 stops the object. Return the largest. */
static double find_lag(const state_t *s, const double *here, double *lag)
{
    double most = 0.0, twist[6];
    for (int t = 0; t < TIPS; ++t) {
        compare_pose(here + 16 * t, s->pose + 16 * t, twist);
        lag[t] = over_limits(twist, LEFT);
        most = larger(most, lag[t]);
    }
    return most;
}

/* Place the object, at rest, by a tip's pose and its grasp: here grasp^-1. Return whether the result is a pose. */
static int hold(state_t *s, const double *here, const double *grasp)
{
    double inverse[16] = {0.0}, object[16];
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            inverse[4 * i + j] = grasp[4 * j + i]; /* R^T */
            inverse[4 * i + 3] -= grasp[4 * j + i] * grasp[4 * j + 3]; /* -R^T p */
        }
    }
    place(here, inverse, object);
    object[15] = 1.0;
    memset(s->carried, 0, sizeof s->carried);
    s->waits = 0;
    return clean_pose(object, s->object);
}

static int is_waiting(const state_t *s) { return s->waits * s->config.sample_time > WAITED; }

/*
 * Adopt what is good of a command. After a wait, another goal begins where the tip that is farthest off its place has
 * the object: from there all tips can go on. Return whether the command is good.
 */
static int take_object(state_t *s, const input_t *input, const double *lag)
{
    double goal[16], grasp[16 * TIPS], here[16 * TIPS];
    int good = clean_pose(input->object_pose, goal), last = 0;
    for (int t = 0; t < TIPS; ++t) {
        good = clean_pose(input->grasp + 16 * t, grasp + 16 * t) && good;
        last = s->held && lag[t] > lag[last] ? t : last;
    }
    if (!good) {
        return 0;
    }
    memcpy(s->grasp, grasp, sizeof s->grasp);
    if (!s->held || (is_waiting(s) && memcmp(goal, s->goal, sizeof goal) != 0)) {
        stiffgen_poses(s->q, stiffgen_tool(input), here); /* where the tips are */
        s->held = hold(s, here + 16 * last, grasp + 16 * last);
    }
    memcpy(s->goal, goal, sizeof s->goal);
    return s->held;
}

/*
 * Compute the object's full speeds v [m/s] and w [rad/s]: a tip at the longest lever then moves at SPARE of its own
 * limits. Both are the same share of those, share (v_limit + lever w_limit) = SPARE v_limit.
 */
static void find_full_speeds(const state_t *s, double *full)
{
    const config_t *const c = &s->config;
    double lever = 0.0; /* [m] */
    for (int t = 0; t < TIPS; ++t) {
        const double *const grasp = s->grasp + 16 * t, origin[3] = {grasp[3], grasp[7], grasp[11]};
        lever = larger(lever, norm(3, origin));
    }
    const double share = SPARE / (1.0 + lever * c->tip_rotation_limit / c->tip_velocity_limit);
    full[0] = share * c->tip_velocity_limit;
    full[1] = share * c->tip_rotation_limit;
}

/* Move the object towards its goal for a sample. lag: the tips' largest; from 1 on the object stops. */
static void advance(state_t *s, double lag)
{
    const double T = s->config.sample_time, slope = T / s->config.ramp_time;
    double full[2], rest[6], step[6], wanted[3];
    find_full_speeds(s, full);
    compare_pose(s->object, s->goal, rest);
    const double way = over_limits(rest, full); /* [s] */
    const double most = smaller(clamp(1.0 - lag, 0.0, 1.0), over_limits(s->carried, full) + slope);
    const double speed = smaller(most, stopping_speed(way, slope, T)); /* share of full speed */
    for (int part = 0; part < 2; ++part) { /* translation, rotation */
        double *const velocity = s->carried + 3 * part;
        for (int i = 0; i < 3; ++i) {
            wanted[i] = way > THERE ? rest[3 * part + i] * speed / way : 0.0;
        }
        steer(wanted, full[part] * BRAKES * slope, velocity);
        for (int i = 0; i < 3; ++i) {
            step[3 * part + i] = T * velocity[i];
        }
    }
    move_pose(step, s->object);
    s->waits = lag > WAITING && way > THERE ? s->waits + (s->waits < LONGEST) : 0;
}

/* Do a step: move the object as far as all tips can follow, and let each tip follow its place on the object. */
int carry(state_t *s, const input_t *input, output_t *out)
{
    double here[16 * TIPS], lag[TIPS], wanted[16], twist[6];
    input_t each = *input; /* what each tip follows by itself */
    stiffgen_poses(s->q, stiffgen_kept_tool(s), here);
    const double most = find_lag(s, here, lag);
    const int good = take_object(s, input, lag); /* else the last good command stays in force */
    memcpy(each.pose, s->pose, sizeof each.pose);
    if (s->held) {
        advance(s, most);
    }
    for (int t = 0; t < TIPS && s->held; ++t) {
        place(s->object, s->grasp + 16 * t, each.pose + 16 * t);
    }
    const int result = follow(s, &each, out);
    for (int t = 0; t < TIPS && s->held; ++t) { /* the error to the goal, not to the place on the way */
        place(s->goal, s->grasp + 16 * t, wanted);
        compare_pose(here + 16 * t, wanted, twist);
        out->error[2 * t] = norm(3, twist);
        out->error[2 * t + 1] = norm(3, twist + 3);
    }
    out->status |= is_waiting(s) ? (uint32_t)ID(FOLLOW_UNREACHABLE) : 0u;
    out->status |= good ? 0u : (uint32_t)ID(FOLLOW_REFUSED);
    return good || result != ID(FOLLOW_OK) ? result : ID(FOLLOW_E_POSE);
}
