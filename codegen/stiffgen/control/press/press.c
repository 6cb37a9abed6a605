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

/* Return how far the moved pose is before the tip along the axis; here: the measured pose. */
static double lead(const state_t *s, const input_t *in, const double *here)
{
    const double ahead[3] = {in->pose[3] + s->offset[0] - here[3], in->pose[7] + s->offset[1] - here[7],
                             in->pose[11] + s->offset[2] - here[11]};
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
    for (int k = 0; k < 3; ++k) {
        s->offset[k] += by * axis[k];
    }
    const double size = norm(3, s->offset), most = s->config.offset_limit;
    for (int k = 0; k < 3 && size > most; ++k) {
        s->offset[k] *= most / size;
    }
}

/* Advance along the axis at a speed, unless the pose is far enough before the tip. */
static void advance(state_t *s, const input_t *in, const double *here, double speed)
{
    shift(s, in->axis, clamp(AHEAD - lead(s, in, here), 0.0, speed * s->controller.sample_time));
}

/* Return the force [N] that spring and wrench_command exert along the axis: what is known without the sensor. */
static double find_exerted(const state_t *s, const input_t *in, const last_t *last, const double *here,
                           double stiffness)
{
    double rest[16];
    stiffgen_pose(&s->controller, last->reference, rest);
    const double stretch[3] = {rest[3] - here[3], rest[7] - here[7], rest[11] - here[11]};
    return stiffness * dot(3, stretch, in->axis) + s->force;
}

/* Let go, into a stage: no force of its own, and the equilibrium at the tip. */
static void let_go(state_t *s, const input_t *in, const double *here, int stage)
{
    s->force = s->low = s->doubt = 0.0;
    s->touched = 0;
    s->stage = stage;
    shift(s, in->axis, -lead(s, in, here));
}

/* Hold the force: integrate its error, and hand over. measured: the force along the axis. */
static void hold(state_t *s, const input_t *in, const double *here, double measured, const tuning_t *tuned)
{
    const double T = s->controller.sample_time;
    s->low = measured < RELEASED * in->force ? s->low + T : 0.0;
    if (s->low >= LOST_TIME || (s->low > 0.0 && s->speed > RUNAWAY)) {
        let_go(s, in, here, ID(PRESS_STAGE_LOST));
        return;
    }
    if (s->low > 0.0) { /* soon the equilibrium follows the surface; the integral waits: it would drive the tip */
        advance(s, in, here, s->low > WAIT ? FASTEST : 0.0);
        return;
    }
    const double most = smaller(MOST * in->force, s->controller.heaviest_wrench[0] / (1.0 + UNIT));
    const double stiffness = larger(tuned->stiffness, SOFTEST);
    s->force = clamp(s->force + tuned->gain * (in->force - measured) * T, -most, most);
    const double rate = clamp(s->force / (stiffness * HAND_OVER), -FASTEST, FASTEST);
    shift(s, in->axis, rate * T);
    s->force -= stiffness * rate * T;
}

/* Find the stage that the input asks for, before its step is done. */
static void choose_stage(state_t *s, const input_t *in, const last_t *last, const double *here)
{
    const int ended = (last->status & (uint32_t)ID(STATUS_FAULT)) != 0u;
    if (!(in->force > 0.0)) {
        s->stage = ID(PRESS_STAGE_OFF);
    } else if (s->stage == ID(PRESS_STAGE_DOUBTED)) {
        return;
    } else if (ended && s->stage != ID(PRESS_STAGE_LOST)) {
        let_go(s, in, here, ID(PRESS_STAGE_LOST));
    } else if (!ended && (s->stage == ID(PRESS_STAGE_OFF) || (s->stage == ID(PRESS_STAGE_LOST) && in->search != 0))) {
        s->stage = ID(PRESS_STAGE_APPROACH);
        s->touched = 0;
        s->low = s->force = s->doubt = 0.0;
    }
}

/*
 * Doubt a sensor that says less than the springs press, and let go where that lasts; in an approach also where they
 * press as hard as they may, by more than contact takes, and the tip stands: friction alone would let it creep.
 */
static void doubt(state_t *s, const input_t *in, const double *here, double excess)
{
    const int seeks = s->stage == ID(PRESS_STAGE_APPROACH), holds = s->stage == ID(PRESS_STAGE_CONTACT);
    const int stands = lead(s, in, here) > NEARLY * AHEAD && fabs(s->gone) < STALL_WAY;
    const double T = s->controller.sample_time;
    s->doubt = (seeks || holds) && excess > s->config.disagreement_limit ? s->doubt + T : 0.0;
    s->stalled = seeks && stands && excess > TOUCHED * in->force ? s->stalled + T : 0.0;
    s->gone = s->stalled > 0.0 ? s->gone : 0.0;
    if (s->doubt >= DOUBT_TIME || s->stalled >= STALL_TIME) {
        let_go(s, in, here, ID(PRESS_STAGE_DOUBTED));
    }
}

/* Do what the stage asks for. */
static void act(state_t *s, const input_t *in, const double *here, double measured, const tuning_t *tuned)
{
    const double T = s->controller.sample_time, size = norm(3, s->offset);
    if (s->stage == ID(PRESS_STAGE_OFF) || s->stage == ID(PRESS_STAGE_DOUBTED)) { /* the pose goes back */
        s->force = 0.0;
        const double left = size > s->config.approach_speed * T ? 1.0 - s->config.approach_speed * T / size : 0.0;
        for (int k = 0; k < 3; ++k) {
            s->offset[k] *= left;
        }
    } else if (s->stage == ID(PRESS_STAGE_APPROACH)) {
        s->touched = measured > TOUCHED * in->force ? s->touched + 1 : 0;
        if (s->touched >= SAMPLES) {
            s->stage = ID(PRESS_STAGE_CONTACT);
        } else {
            advance(s, in, here, s->config.approach_speed);
        }
    } else if (s->stage == ID(PRESS_STAGE_CONTACT)) {
        hold(s, in, here, measured, tuned);
    }
}

/* Do a step: without a good input or an output of the controller, the pose stays and no force is added. */
int press(state_t *s, const input_t *in, const last_t *last, output_t *out)
{
    const int result = judge(s, in);
    tuning_t tuned;
    const int told = last != NULL && all_finite(last->position, N) && all_finite(last->reference, N);
    memcpy(out->pose, result == ID(PRESS_OK) || !s->known ? in->pose : s->pose, sizeof out->pose);
    if (result == ID(PRESS_OK) && told) {
        double here[16];
        const double wrench[6] = {in->axis[0], in->axis[1], in->axis[2], 0.0, 0.0, 0.0};
        const double measured = -dot(3, in->axis, in->wrench);
        stiffgen_pose(&s->controller, last->position, here);
        watch(s, in, here);
        tuned.gain = GAIN * CALL(tip_decay)(&s->controller, last->position, in->translation_stiffness,
                                            in->rotation_stiffness, wrench, &tuned.stiffness);
        out->gain = tuned.gain;
        out->error = in->force - measured;
        out->pressing = find_exerted(s, in, last, here, tuned.stiffness);
        choose_stage(s, in, last, here);
        doubt(s, in, here, out->pressing - measured);
        act(s, in, here, measured, &tuned);
    }
    for (int k = 0; k < 3; ++k) { /* a step whose input is wrong exerts no wrench, and holds the pose */
        out->pose[4 * k + 3] += s->offset[k];
        out->wrench_command[k] = result == ID(PRESS_OK) ? s->force * in->axis[k] : 0.0;
    }
    out->stage = s->stage;
    return result;
}
