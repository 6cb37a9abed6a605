/*
 * A force along an axis. An integral of the measured force's error acts at once, as wrench_command; what it grows to is
 * handed over to the equilibrium, whose spring then exerts it and needs nothing from the tank.
 */
#include "press.h"

static const double UNIT = 1e-3;         /* what the axis' length may differ from 1 by */
static const double GAIN = 0.5;          /* of the integral, over the tip's decay: stable below 1 on any wall */
static const double HAND_OVER = 0.3;     /* [s] time constant with which the equilibrium takes over */
static const double FASTEST = 0.1;       /* [m/s] of the equilibrium in contact */
static const double RUNAWAY = 0.08;      /* [m/s] of a tip without a force, from which on contact is lost at once */
static const double SOFTEST = 50.0;      /* [N/m] stiffness along the axis below which less is handed over */
static const double AHEAD = 0.03;        /* [m] of the equilibrium before the tip in an approach */
static const double NEARLY = 0.9;        /* share of it from which on it is as far as it goes */
static const double TOUCHED = 0.2;       /* share of the force from which on there is contact */
static const double RELEASED = 0.1;      /* share below which there may be none */
static const double WAIT = 0.03;         /* [s] of low force for which the equilibrium waits: most contacts return */
static const double LOST_TIME = 0.15;    /* [s] of low force after which contact is lost */
static const double DOUBT_TIME = 0.2;    /* [s] of springs beyond disagreement_limit: impacts and turns are shorter */
static const double STALL_TIME = 5.0;    /* [s] of an approach that presses and stands, after which it is blocked */
static const double STALL_WAY = 1e-3;    /* [m] that the tip goes in it if friction holds it: a UR5 creeps by 1.5 mm */
static const double SPEED_TIME = 0.01;   /* [s] time constant of the tip's measured speed */
static const double MOST = 2.0;          /* times the force that the integral may have */
enum { SAMPLES = 3 };                    /* with a force, before contact */

/* Keep both configurations; refuse a controller that is not configured. */
int start(const config_t *c, const controller_t *controller, state_t *s)
{
    const controller_t *const k = controller;
    if (!is_usable(k->sample_time, k->delay_samples, k->damping_ratio, N, k->motor_inertia)) {
        return ID(PRESS_E_CONTROLLER);
    }
    s->config = *c;
    s->controller = *controller;
    s->ready = READY;
    return ID(PRESS_OK);
}

/* Judge an input. Return OK or what is wrong. */
static int judge(const state_t *s, const input_t *in)
{
    const int stiff = all_finite(in->translation_stiffness, 9) && all_finite(in->rotation_stiffness, 9);
    if (!stiff || !all_finite(in->pose, 16) || !all_finite(in->wrench, 6)) {
        return ID(PRESS_E_NUMBER);
    }
    if (!(fabs(norm(3, in->axis) - 1.0) <= UNIT)) {
        return ID(PRESS_E_AXIS);
    }
    const int good = in->force >= 0.0 && MOST * in->force <= s->controller.heaviest_wrench[0];
    return good ? ID(PRESS_OK) : ID(PRESS_E_FORCE);
}

/* Return how far [m] the moved pose is before the tip along the axis. */
static double lead(const state_t *s, const input_t *in, const step_t *k)
{
    double ahead[3];
    for (int i = 0; i < 3; ++i) {
        ahead[i] = in->pose[4 * i + 3] + s->offset[i] - k->here[4 * i + 3];
    }
    return dot(3, ahead, in->axis);
}

/* Note how fast the tip moves along the axis, and how far it has gone since the approach stood. */
static void watch(state_t *s, const input_t *in, const double *here)
{
    const double moved[3] = {here[3] - s->here[3], here[7] - s->here[7], here[11] - s->here[11]};
    const double T = s->controller.sample_time, way = s->known ? dot(3, moved, in->axis) : 0.0;
    s->speed += smaller(T / SPEED_TIME, 1.0) * (way / T - s->speed);
    s->gone += way;
    memcpy(s->here, here, sizeof s->here);
    memcpy(s->pose, in->pose, sizeof s->pose);
    s->known = 1;
}

/* Move the offset along the axis, within offset_limit. */
static void shift(state_t *s, const double *axis, double by)
{
    for (int i = 0; i < 3; ++i) {
        s->offset[i] += by * axis[i];
    }
    const double size = norm(3, s->offset), most = s->config.offset_limit;
    for (int i = 0; i < 3 && size > most; ++i) {
        s->offset[i] *= most / size;
    }
}

/* Advance along the axis at a speed, unless the pose is AHEAD of the tip. */
static void advance(state_t *s, const input_t *in, const step_t *k, double speed)
{
    shift(s, in->axis, clamp(AHEAD - lead(s, in, k), 0.0, speed * s->controller.sample_time));
}

/* Return the force [N] that spring and wrench_command exert along the axis: what is known without the sensor. */
static double find_exerted(const state_t *s, const input_t *in, const last_t *last, const step_t *k)
{
    double rest[16]; /* pose at which the springs are at rest */
    stiffgen_pose(&s->controller, last->reference, rest);
    const double stretch[3] = {rest[3] - k->here[3], rest[7] - k->here[7], rest[11] - k->here[11]};
    return k->stiffness * dot(3, stretch, in->axis) + s->force;
}

/* Let go, into a stage: no force of its own, and the equilibrium at the tip. */
static void let_go(state_t *s, const input_t *in, const step_t *k, int stage)
{
    s->force = s->low = s->doubt = 0.0;
    s->touched = 0;
    s->stage = stage;
    shift(s, in->axis, -lead(s, in, k));
}

/*
 * Integrate the force's error, and hand over to the spring what the integral has: the equilibrium moves along the axis
 * at a `rate` [m/s], so that the spring exerts stiffness * rate * T more in each sample, and the integral as much less.
 */
static void integrate(state_t *s, const input_t *in, const step_t *k)
{
    const double T = s->controller.sample_time, stiffness = larger(k->stiffness, SOFTEST);
    const double most = smaller(MOST * in->force, s->controller.heaviest_wrench[0] / (1.0 + UNIT));
    s->force = clamp(s->force + k->gain * (in->force - k->measured) * T, -most, most);
    const double rate = clamp(s->force / (stiffness * HAND_OVER), -FASTEST, FASTEST);
    shift(s, in->axis, rate * T);
    s->force -= stiffness * rate * T;
}

/* Hold the force while there is contact. Where it is low the integral waits, which would drive the tip. */
static void hold(state_t *s, const input_t *in, const step_t *k)
{
    s->low = k->measured < RELEASED * in->force ? s->low + s->controller.sample_time : 0.0;
    if (s->low >= LOST_TIME || (s->low > 0.0 && s->speed > RUNAWAY)) {
        let_go(s, in, k, ID(PRESS_STAGE_LOST));
    } else if (s->low > 0.0) {
        advance(s, in, k, s->low > WAIT ? FASTEST : 0.0); /* soon the equilibrium follows the surface */
    } else {
        integrate(s, in, k);
    }
}

/* Find the stage that the input asks for, before its step is done. */
static void choose_stage(state_t *s, const input_t *in, const last_t *last, const step_t *k)
{
    const int ended = (last->status & (uint32_t)ID(STATUS_FAULT)) != 0u;
    const int may_begin = s->stage == ID(PRESS_STAGE_OFF) || (s->stage == ID(PRESS_STAGE_LOST) && in->search != 0);
    if (!(in->force > 0.0)) {
        s->stage = ID(PRESS_STAGE_OFF);
    } else if (s->stage == ID(PRESS_STAGE_DOUBTED)) { /* until the force is 0 */
        return;
    } else if (ended && s->stage != ID(PRESS_STAGE_LOST)) {
        let_go(s, in, k, ID(PRESS_STAGE_LOST));
    } else if (!ended && may_begin) {
        s->stage = ID(PRESS_STAGE_APPROACH);
        s->touched = 0;
        s->low = s->force = s->doubt = 0.0;
    }
}

/*
 * Doubt a sensor that says less than the springs press, by the excess [N], and let go where that lasts; in an approach
 * also where they press as hard as they may, by more than contact takes, and the tip stands: friction alone would let
 * the tip creep.
 */
static void doubt(state_t *s, const input_t *in, const step_t *k, double excess)
{
    const int seeks = s->stage == ID(PRESS_STAGE_APPROACH), holds = s->stage == ID(PRESS_STAGE_CONTACT);
    const int stands = lead(s, in, k) > NEARLY * AHEAD && fabs(s->gone) < STALL_WAY;
    const double T = s->controller.sample_time;
    s->doubt = (seeks || holds) && excess > s->config.disagreement_limit ? s->doubt + T : 0.0;
    s->stalled = seeks && stands && excess > TOUCHED * in->force ? s->stalled + T : 0.0;
    s->gone = s->stalled > 0.0 ? s->gone : 0.0;
    if (s->doubt >= DOUBT_TIME || s->stalled >= STALL_TIME) {
        let_go(s, in, k, ID(PRESS_STAGE_DOUBTED));
    }
}

/* Let the pose go back at approach_speed, without a force. */
static void go_back(state_t *s)
{
    const double size = norm(3, s->offset), step = s->config.approach_speed * s->controller.sample_time; /* [m] */
    const double left = size > step ? 1.0 - step / size : 0.0;
    s->force = 0.0;
    for (int i = 0; i < 3; ++i) {
        s->offset[i] *= left;
    }
}

/* Do what the stage asks for; SAMPLES with a force in a row end an approach. */
static void act(state_t *s, const input_t *in, const step_t *k)
{
    if (s->stage == ID(PRESS_STAGE_OFF) || s->stage == ID(PRESS_STAGE_DOUBTED)) {
        go_back(s);
    } else if (s->stage == ID(PRESS_STAGE_APPROACH)) {
        s->touched = k->measured > TOUCHED * in->force ? s->touched + 1 : 0;
        if (s->touched >= SAMPLES) {
            s->stage = ID(PRESS_STAGE_CONTACT);
        } else {
            advance(s, in, k, s->config.approach_speed);
        }
    } else if (s->stage == ID(PRESS_STAGE_CONTACT)) {
        hold(s, in, k);
    }
}

/* Find what is known of a step. The sensor has the wrench of the environment on the tip: the opposite is exerted. */
static void measure(const state_t *s, const input_t *in, const last_t *last, step_t *k)
{
    const double along[6] = {in->axis[0], in->axis[1], in->axis[2], 0.0, 0.0, 0.0}; /* a unit wrench */
    stiffgen_pose(&s->controller, last->position, k->here);
    k->measured = -dot(3, in->axis, in->wrench);
    k->gain = GAIN * CALL(tip_decay)(&s->controller, last->position, in->translation_stiffness,
                                     in->rotation_stiffness, along, &k->stiffness);
}

/* Do a step: without a good input or an output of the controller, the pose stays and no force is added. */
int press(state_t *s, const input_t *in, const last_t *last, output_t *out)
{
    const int result = judge(s, in);
    const int told = last != NULL && all_finite(last->position, N) && all_finite(last->reference, N);
    memcpy(out->pose, result == ID(PRESS_OK) || !s->known ? in->pose : s->pose, sizeof out->pose);
    if (result == ID(PRESS_OK) && told) {
        step_t k;
        measure(s, in, last, &k);
        watch(s, in, k.here);
        out->gain = k.gain;
        out->error = in->force - k.measured;
        out->pressing = find_exerted(s, in, last, &k);
        choose_stage(s, in, last, &k);
        doubt(s, in, &k, out->pressing - k.measured);
        act(s, in, &k);
    }
    for (int i = 0; i < 3; ++i) { /* a step whose input is wrong exerts no wrench, and holds the pose */
        out->pose[4 * i + 3] += s->offset[i];
        out->wrench_command[i] = result == ID(PRESS_OK) ? s->force * in->axis[i] : 0.0;
    }
    out->stage = s->stage;
    return result;
}
