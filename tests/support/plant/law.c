/* SPDX-License-Identifier: MIT */
/* The generated controller as a law of the episodes. */
#include "law.h"

#include <string.h>

typedef ROBOT_(impedance_config) config_t;
typedef ROBOT_(impedance_state) state_t;
typedef ROBOT_(impedance_input) input_t;
typedef ROBOT_(impedance_output) output_t;

size_t law_config_size(void)
{
    return sizeof(config_t);
}

size_t law_state_size(void)
{
    return sizeof(state_t);
}

size_t law_output_size(void)
{
    return sizeof(output_t);
}

/* The defaults, and what has none: 1 ms, no delay, the usual wrench. */
void law_default_config(void *config)
{
    config_t *const c = config;
    ROBOT_(impedance_default_config)(c);
    c->sample_time = 1e-3;
    c->delay_samples = 0;
    c->heaviest_wrench[0] = 100.0;
    c->heaviest_wrench[1] = 20.0;
    for (int i = 0; i < N; ++i) {
        c->motor_inertia[i] = 0.1;
    }
}

/*
 * A controller in place of the C one, such as its Python class, or NULL. It is called with input NULL to initialise, with
 * output NULL to reset, and to step; it returns what init and step return.
 */
int (*law_elsewhere)(const config_t *config, const double *torque, const input_t *input, output_t *output);

int law_init(const void *config, void *state, const double *torque, const double *tool)
{
    config_t c = *(const config_t *)config;
#ifdef PLANT_TOOLS
    memcpy(c.tool_pose, tool, sizeof c.tool_pose);
#else
    (void)tool;
#endif
    const int code = ROBOT_(impedance_init)(&c, state, torque); /* law_step reads limits there */
    return law_elsewhere != NULL ? law_elsewhere(&c, torque, NULL, NULL) : code;
}

void law_step(void *state, const sample_t *sample, void *output, command_t *command)
{
    const config_t *const c = &((const state_t *)state)->memory.config;
    output_t *const out = output;
    input_t in;
    memset(&in, 0, sizeof in);
    in.sample_valid = sample->valid;
    in.clock = UPPER_(CLOCK_COUNTER);
    in.counter = sample->counter;
    in.shaped = sample->shaped;
    memcpy(in.q, sample->q, sizeof in.q);
    memcpy(in.dq, sample->dq, sizeof in.dq);
    memcpy(in.q0, sample->wanted, sizeof in.q0);
    memcpy(in.translation_stiffness, sample->translation, sizeof in.translation_stiffness);
    memcpy(in.rotation_stiffness, sample->rotation, sizeof in.rotation_stiffness);
    memcpy(in.acceleration, sample->acceleration, sizeof in.acceleration);
    memcpy(in.wrench_command, sample->wrench_command, sizeof in.wrench_command);
    memcpy(in.torque_offset, sample->torque_offset, sizeof in.torque_offset);
    for (int i = 0; i < N; ++i) {
        in.posture_stiffness[i] = sample->joint;
    }
    if (sample->reset && law_elsewhere != NULL) {
        law_elsewhere(NULL, NULL, &in, NULL);
    } else if (sample->reset) {
        ROBOT_(impedance_reset)(state);
    }
    command->code = law_elsewhere != NULL ? law_elsewhere(NULL, NULL, &in, out) : ROBOT_(impedance_step)(state, &in, out);
    memcpy(command->torque, out->torque, sizeof command->torque);
    memcpy(command->velocity_limit, c->velocity_limit, sizeof command->velocity_limit);
    command->call_gap = c->call_gap_limit < c->missed_limit ? c->call_gap_limit : c->missed_limit;
    for (int i = 0; i < N; ++i) {
        command->offset[i] = out->torque[i] - out->own_torque[i];
        command->joint[i] = sample->joint;
    }
    memcpy(command->reference, out->reference, sizeof command->reference);
    robot_poses(out->reference, sample->tool, command->equilibrium);
    memcpy(command->translation, sample->translation, sizeof command->translation);
    memcpy(command->rotation, sample->rotation, sizeof command->rotation);
    command->scale = out->scale;
    command->energy = out->stored;
    command->tank = out->tank;
    command->supplied = out->energy_supplied;
    command->deficit = out->tank < 0.0 ? -out->tank : 0.0;
    command->status = out->status;
    command->faulted = out->fault != 0;
    command->reason = out->reason;
}
