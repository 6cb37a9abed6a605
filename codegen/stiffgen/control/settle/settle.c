/* The integral of the pose error moves the commanded pose, as long as the command rests and nothing touches the tip. */
#include "settle.h"

static const double REST_TIME = 0.05;     /* [s] for which the command has been at rest */
static const double SAME = 1e-9;          /* change of a pose's entry that is none */
static const double ARRIVED[2] = {2e-3, 6e-3};  /* [m], [rad] of the equilibrium from the moved command */
static const double SLOW[2] = {0.05, 0.15};     /* [m/s], [rad/s] of the tip up to which it rests */
static const double SPEED_TIME = 0.01;    /* [s] time constant of the tip's measured speed */
static const double BEYOND = 1.25;        /* times settle_force, up to which error and offset may pull together */
static const double LEFT = 0.9;           /* times settle_band, up to which an error is left: a tip may still creep */
static const double CLOSEST = 3.0;        /* times settle_band: smaller errors are integrated as fast as this one */
static const double SLOWNESS = 4.0;       /* time of the integral times the decay: stable from 1 on */
static const double OFFSET_LIMIT[2] = {0.2, 0.5};   /* [m], [rad] of the offset, whatever the stiffness is */

/* Keep both configurations; refuse a controller that is not configured. */
int start(const config_t *c, const controller_t *controller, state_t *s)
{
    const controller_t *const k = controller;
    if (!is_usable(k->sample_time, k->delay_samples, k->damping_ratio, N, k->motor_inertia)) {
        return ID(SETTLE_E_CONTROLLER);
    }
    s->config = *c;
    s->controller = *controller;
    s->ready = READY;
    return ID(SETTLE_OK);
}

/* Return the bits of what the last step of the controller says against an integral. */
static uint32_t obstacles(void)
{
    const uint32_t bad = (uint32_t)ID(STATUS_FAULT) | (uint32_t)ID(STATUS_MISSED) | (uint32_t)ID(STATUS_BAD_SAMPLE);
    const uint32_t held = (uint32_t)ID(STATUS_COMMAND_REFUSED) | (uint32_t)ID(STATUS_GOVERNOR);
    const uint32_t weak = (uint32_t)ID(STATUS_RESERVE) | (uint32_t)ID(STATUS_SATURATED);
    return bad | held | weak | (uint32_t)ID(STATUS_TANK_LIMITED) | (uint32_t)ID(STATUS_JOINT_LIMIT);
}

/* Note whether the command rests, and how fast the tip is. here: the measured pose. */
static void watch(state_t *s, const double *pose, const double *here)
{
    const double T = s->controller.sample_time;
    double moved[6], change = 0.0;
    for (int k = 0; k < 16; ++k) {
        change = larger(change, fabs(pose[k] - s->pose[k]));
    }
    s->rest = s->known && change <= SAME ? smaller(s->rest + T, 1.0) : 0.0; /* [s], up to 1 s */
    compare_pose(s->here, here, moved);
    for (int k = 0; k < 6; ++k) {
        const double speed = s->known ? moved[k] / T : 0.0;
        s->velocity[k] += smaller(T / SPEED_TIME, 1.0) * (speed - s->velocity[k]); /* low-pass */
    }
    memcpy(s->pose, pose, sizeof s->pose);
    memcpy(s->here, here, sizeof s->here);
    s->known = 1;
}

/* Return whether something touches the tip, or the caller says so. */
static int is_touched(const state_t *s, const input_t *in)
{
    const double force = norm(3, in->wrench), moment = norm(3, in->wrench + 3);
    return in->hold != 0 || force > s->config.contact_wrench[0] || moment > s->config.contact_wrench[1];
}

/* Return whether the equilibrium has arrived at the moved command, and command and tip rest. */
static int is_at_rest(const state_t *s, const last_t *last, const double *moved)
{
    double equilibrium[16], rest[6];
    stiffgen_poses(last->reference, stiffgen_tool(&s->controller), equilibrium);
    compare_pose(equilibrium, moved, rest);
    int good = s->rest >= REST_TIME && (last->status & obstacles()) == 0u && last->scale > 0.0;
    for (int k = 0; k < 2; ++k) {
        good = good && norm(3, rest + 3 * k) <= ARRIVED[k] && norm(3, s->velocity + 3 * k) <= SLOW[k];
    }
    return good;
}

/* Return size and direction of an error, and the stiffness in force along it. */
static error_t measure(const state_t *s, const input_t *in, const last_t *last, int kind, const double *error)
{
    error_t e = {norm(3, error), {0.0, 0.0, 0.0}, 0.0};
    for (int k = 0; k < 3 && e.size > 0.0; ++k) {
        e.axis[k] = error[k] / e.size;
    }
    const double *const K = kind == TRANSLATION ? in->translation_stiffness : in->rotation_stiffness;
    const int turns = kind == TRANSLATION ? TRANSLATION_TURNS : ROTATION_TURNS;
    e.stiffness = last->scale * square_in(K, turns, s->here, e.axis);
    return e;
}

/* Shorten an offset whose spring would pull harder than settle_force. Return whether it was too long. */
static int limit_offset(const state_t *s, const input_t *in, const last_t *last, int kind, double *offset)
{
    const error_t d = measure(s, in, last, kind, offset);
    const double most = s->config.settle_force[kind];
    const double length = d.stiffness * OFFSET_LIMIT[kind] > most ? most / d.stiffness : OFFSET_LIMIT[kind];
    for (int k = 0; k < 3 && d.size > length; ++k) {
        offset[k] *= length / d.size;
    }
    return d.size > length;
}

/*
 * Integrate the error of one kind, unless it is within the band, or the springs pull more than friction or a payload
 * need: something blocks the tip. Return whether it does.
 */
static int integrate(state_t *s, const input_t *in, const last_t *last, int kind, const double *error)
{
    const error_t e = measure(s, in, last, kind, error);
    double *const offset = s->offset + 3 * kind;
    /* from the tip to where the springs are at rest [m], [rad]; error alone reaches to the pose that is wanted */
    const double stretch[3] = {error[0] + offset[0], error[1] + offset[1], error[2] + offset[2]};
    const double most = s->config.settle_force[kind], band = s->config.settle_band[kind];
    double wrench[6] = {0.0}, unused; /* unit wrench along the error; stiffness along it, without the scale */
    if (!(e.size > LEFT * band && e.stiffness > 0.0 && e.stiffness * norm(3, stretch) < BEYOND * most)) {
        return 0;
    }
    memcpy(wrench + 3 * kind, e.axis, sizeof e.axis);
    const double decay = find_decay(&s->controller, last->position, in->translation_stiffness, in->rotation_stiffness,
                                    wrench, &unused);
    /* slower than the closed loop decays, so that both do not swing against each other */
    const double share = decay * s->controller.sample_time / SLOWNESS;
    for (int k = 0; k < 3; ++k) {
        offset[k] += share * (e.size - 0.5 * band) * larger(CLOSEST * band / e.size, 1.0) * e.axis[k];
    }
    return 1;
}

/* Integrate the error where the arm rests and nobody touches it, and report it. out->pose: the commanded one. */
static void settle_here(state_t *s, const input_t *in, const last_t *last, output_t *out)
{
    double here[16], moved[16], error[6];
    stiffgen_poses(last->position, stiffgen_tool(&s->controller), here);
    watch(s, in->pose, here);
    memcpy(moved, in->pose, sizeof moved);
    move_pose(s->offset, moved);
    const int rests = is_at_rest(s, last, moved) && !is_touched(s, in);
    compare_pose(here, in->pose, error);
    for (int kind = TRANSLATION; kind <= ROTATION; ++kind) {
        const int moves = rests && integrate(s, in, last, kind, error + 3 * kind);
        const int limited = limit_offset(s, in, last, kind, s->offset + 3 * kind); /* stiffness may have changed */
        out->error[kind] = norm(3, error + 3 * kind);
        out->status |= moves ? (uint32_t)ID(SETTLE_MOVING) : 0u;
        out->status |= limited ? (uint32_t)ID(SETTLE_LIMITED) : 0u;
    }
    const int settled = out->error[0] <= s->config.settle_band[0] && out->error[1] <= s->config.settle_band[1];
    out->status |= rests ? 0u : (uint32_t)ID(SETTLE_HELD);
    out->status |= settled ? (uint32_t)ID(SETTLE_SETTLED) : 0u;
}

/* Do a step. Without good numbers the last pose stays; without an output of the controller the offset is held. */
int settle(state_t *s, const input_t *in, const last_t *last, output_t *out)
{
    const int good = all_finite(in->pose, 16) && all_finite(in->translation_stiffness, 9) &&
                     all_finite(in->rotation_stiffness, 9) && all_finite(in->wrench, 6);
    const int told = last != NULL && all_finite(last->position, N) && all_finite(last->reference, N) &&
                     fabs(last->scale) <= DBL_MAX;
    memcpy(out->pose, good || !s->known ? in->pose : s->pose, sizeof out->pose);
    if (good && told) {
        settle_here(s, in, last, out);
    } else {
        s->rest = 0.0;
        out->status = (uint32_t)ID(SETTLE_HELD);
    }
    memcpy(out->offset, s->offset, sizeof out->offset);
    if (norm(6, s->offset) > 0.0) { /* without an offset the pose stays as it is, to the last bit */
        move_pose(s->offset, out->pose);
    }
    return good ? ID(SETTLE_OK) : ID(SETTLE_E_NUMBER);
}
