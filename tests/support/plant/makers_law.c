/* SPDX-License-Identifier: MIT */
/*
 * The generated controller behind Settle, Press and Follow, which are told lies: forces that nobody exerts, axes, numbers
 * that are not finite, old outputs. What they make of it are commands. One loop in a process.
 */
#define law_init init_controller
#define law_step step_controller
#include "law.c"
#undef law_init
#undef law_step

#include <math.h>

static struct {
    ROBOT_(follow_state) follow;
    ROBOT_(settle_state) settle;
    ROBOT_(press_state) press;
    ROBOT_(settle_input) rest;
    ROBOT_(press_input) push;
    output_t last;
    int stepped, steps, known;
    uint32_t bits;
} makers;

static double draw(void)
{
    makers.bits = makers.bits * 1664525u + 1013904223u;
    return (makers.bits >> 8) / 16777216.0;
}

int law_init(const void *config, void *state, const double *torque, const double *tool)
{
    ROBOT_(settle_config) settle;
    ROBOT_(press_config) press;
    const uint32_t bits = makers.bits;
    memset(&makers, 0, sizeof makers);
    makers.bits = bits;
    ROBOT_(settle_default_config)(&settle);
    settle.settle_force[0] = 200.0 * draw();
    settle.settle_force[1] = 40.0 * draw();
    settle.settle_band[0] = 1e-3 * draw() + 1e-6;
    settle.contact_wrench[0] = settle.contact_wrench[1] = draw() < 0.5 ? 1e4 : 5.0;
    ROBOT_(press_default_config)(&press);
    press.approach_speed = draw() + 1e-3;
    press.disagreement_limit = 1e4; /* no doubt: it would let go of most lies */
    (void)ROBOT_(settle_init)(&settle, config, &makers.settle);
    (void)ROBOT_(press_init)(&press, config, &makers.press);
    return init_controller(config, state, torque, tool);
}

/* Tell the makers something else, now and then. */
static void lie(void)
{
    double size = 1e-9;
    for (int k = 0; k < 3; ++k) {
        makers.push.axis[k] = draw() - 0.5;
        size += makers.push.axis[k] * makers.push.axis[k];
    }
    for (int k = 0; k < 6; ++k) {
        makers.push.wrench[k] = draw() < 0.5 ? 0.0 : (draw() - 0.5) * (k < 3 ? 200.0 : 40.0);
        makers.rest.wrench[k] = draw() < 0.5 ? makers.push.wrench[k] : 0.0;
    }
    for (int k = 0; k < 3; ++k) {
        makers.push.axis[k] /= sqrt(size);
    }
    makers.push.force = draw() < 0.2 ? 0.0 : 50.0 * draw();
    makers.push.search = draw() < 0.7;
    makers.rest.hold = draw() < 0.1;
    if (draw() < 0.1) {
        makers.push.wrench[2] = makers.rest.wrench[0] = (double)NAN;
    }
}

/* Step with commands that the makers make of the sample's pose. */
void law_step(void *state, const sample_t *sample, void *output, command_t *command)
{
    ROBOT_(settle_output) moved;
    ROBOT_(press_output) pushed;
    ROBOT_(follow_input) input;
    ROBOT_(follow_output) path;
    sample_t told = *sample;
    if (!makers.known && sample->valid) {
        ROBOT_(follow_config) follow;
        makers.bits = makers.bits ^ sample->counter ^ (uint32_t)(1e6 * fabs(sample->q[0]));
        ROBOT_(follow_default_config)(&follow);
        follow.sample_time = ((const state_t *)state)->memory.config.sample_time;
        (void)ROBOT_(follow_init)(&follow, &makers.follow, sample->q);
        makers.known = 1;
    }
    if (makers.known && sample->valid) {
        if (makers.steps++ % 64 == 0) {
            lie();
        }
        memcpy(makers.rest.translation_stiffness, sample->translation, sizeof makers.rest.translation_stiffness);
        memcpy(makers.rest.rotation_stiffness, sample->rotation, sizeof makers.rest.rotation_stiffness);
        memcpy(makers.push.translation_stiffness, sample->translation, sizeof makers.push.translation_stiffness);
        memcpy(makers.push.rotation_stiffness, sample->rotation, sizeof makers.push.rotation_stiffness);
        robot_poses(sample->wanted, sample->tool, makers.rest.pose);
        const output_t *const last = makers.stepped && draw() < 0.98 ? &makers.last : NULL;
        (void)ROBOT_(settle_step)(&makers.settle, &makers.rest, last, &moved);
        memcpy(makers.push.pose, moved.pose, sizeof makers.push.pose);
        (void)ROBOT_(press_step)(&makers.press, &makers.push, last, &pushed);
        memset(&input, 0, sizeof input);
        memcpy(input.pose, pushed.pose, sizeof input.pose);
        memcpy(input.posture, sample->wanted, sizeof input.posture);
        (void)ROBOT_(follow_step)(&makers.follow, &input, &path);
        memcpy(told.wanted, path.q0, sizeof told.wanted);
        memcpy(told.wrench_command, pushed.wrench_command, sizeof told.wrench_command);
        told.shaped = 1;
    }
    step_controller(state, &told, output, command);
    makers.last = *(const output_t *)output;
    makers.stepped = 1;
}
