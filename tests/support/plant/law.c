/* SPDX-License-Identifier: MIT */
/* The generated controller as a law of the episodes. */
#include "law.h"

#include <string.h>

typedef ROBOT_(impedance_input) input_t;
typedef ROBOT_(impedance_output) output_t;

size_t law_config_size(void)
{
    return sizeof(ROBOT_(impedance_config));
}

size_t law_state_size(void)
{
    return sizeof(ROBOT_(impedance_state));
}

size_t law_output_size(void)
{
    return sizeof(output_t);
}

void law_default_config(void *config)
{
    ROBOT_(impedance_default_config)(config);
}

/*
 * A controller in place of the C one, such as its Python class, or NULL. It is called with input NULL to initialise, with
 * output NULL to reset, and to step; it returns what init and step return.
 */
int (*law_elsewhere)(const void *config, const input_t *input, output_t *output);

int law_init(const void *config, void *state)
{
    if (law_elsewhere != NULL) {
        return law_elsewhere(config, NULL, NULL);
    }
    return ROBOT_(impedance_init)(config, state, NULL);
}

static void reset(const void *config, void *state, const input_t *in)
{
    if (law_elsewhere != NULL) {
        law_elsewhere(config, in, NULL);
    } else {
        ROBOT_(impedance_reset)(state);
    }
}

#ifdef PLANT_TOOLS
/* Step with the tools of the sample, and report whether another one is in force, or refused. */
static int step(const void *config, void *state, const sample_t *sample, input_t *in, output_t *out, command_t *command)
{
    const ROBOT_(impedance_state) *const known = state;
    double before[16 * TIPS];
    memcpy(before, known->memory.tool_pose, sizeof before);
    memcpy(in->tool_pose, sample->tool, sizeof in->tool_pose);
    const int code = ROBOT_(impedance_step)(config, state, in, out);
    command->tool_changed = memcmp(before, known->memory.tool_pose, sizeof before) != 0;
    command->tool_refused = out->refusal == UPPER_(REFUSAL_ENGAGED);
    return code;
}
#else
static int step(const void *config, void *state, const sample_t *sample, input_t *in, output_t *out, command_t *command)
{
    (void)sample;
    (void)command;
    return law_elsewhere != NULL ? law_elsewhere(config, in, out) : ROBOT_(impedance_step)(config, state, in, out);
}
#endif

void law_step(const void *config, void *state, const sample_t *sample, void *output, command_t *command)
{
    const ROBOT_(impedance_config) *const c = config;
    output_t *const out = output;
    input_t in;
    memset(&in, 0, sizeof in);
    in.sample_valid = sample->valid;
    in.command = sample->pose ? UPPER_(COMMAND_EQUILIBRIUM) : UPPER_(COMMAND_POSITION);
    in.wrench_valid = 1;
    in.counter = sample->counter;
    memcpy(in.q, sample->q, sizeof in.q);
    memcpy(in.dq, sample->dq, sizeof in.dq);
    memcpy(in.q0, sample->pose ? sample->posture : sample->wanted, sizeof in.q0);
    robot_poses(sample->wanted, sample->tool, in.equilibrium);
    for (int i = 0; sample->single && i < 16 * TIPS; ++i) {
        in.equilibrium[i] = (float)in.equilibrium[i];
    }
    memcpy(in.translation_stiffness, sample->translation, sizeof in.translation_stiffness);
    memcpy(in.rotation_stiffness, sample->rotation, sizeof in.rotation_stiffness);
    memcpy(in.wrench, sample->wrench, sizeof in.wrench);
    memcpy(in.velocity, sample->velocity, sizeof in.velocity);
    memcpy(in.acceleration, sample->acceleration, sizeof in.acceleration);
    memcpy(in.wrench_command, sample->wrench_command, sizeof in.wrench_command);
    memcpy(in.torque_offset, sample->torque_offset, sizeof in.torque_offset);
    if (sample->reset) {
        reset(config, state, &in);
    }
    command->code = step(config, state, sample, &in, out, command);
    memcpy(command->torque, out->tau_ff, sizeof command->torque);
    memcpy(command->offset, out->offset_torque, sizeof command->offset);
    memcpy(command->velocity_limit, out->velocity_limit, sizeof command->velocity_limit);
    command->call_gap = out->call_gap_limit;
    memcpy(command->kp, out->kp, sizeof command->kp);
    memcpy(command->kd, out->kd, sizeof command->kd);
    memcpy(command->q_des, out->q_des, sizeof command->q_des);
    memcpy(command->reference, out->reference, sizeof command->reference);
    memcpy(command->equilibrium, out->equilibrium, sizeof command->equilibrium);
    memcpy(command->translation, out->translation_stiffness, sizeof command->translation);
    memcpy(command->rotation, out->rotation_stiffness, sizeof command->rotation);
    memcpy(command->joint, c->posture_stiffness, sizeof command->joint);
    command->scale = out->scale;
    command->energy = out->elastic_energy + out->limit_energy;
    command->tank = out->tank_energy;
    command->supplied = out->energy_supplied;
    command->deficit = out->tank_energy < 0.0 ? -out->tank_energy : 0.0;
    command->status = out->status;
    command->faulted = out->fault != 0;
    command->reason = out->reason;
}
