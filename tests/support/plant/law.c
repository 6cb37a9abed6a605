/* SPDX-License-Identifier: MIT */
/* The generated controller as a law of the episodes. */
#include "law.h"

#include "iiwa14_impedance.h"

#include <string.h>

typedef iiwa14_impedance_input input_t;
typedef iiwa14_impedance_output output_t;

size_t law_config_size(void)
{
    return sizeof(iiwa14_impedance_config);
}

size_t law_state_size(void)
{
    return sizeof(iiwa14_impedance_state);
}

size_t law_output_size(void)
{
    return sizeof(output_t);
}

void law_default_config(void *config)
{
    iiwa14_impedance_default_config(config);
}

int law_init(const void *config, void *state)
{
    return iiwa14_impedance_init(config, state, NULL);
}

void law_step(const void *config, void *state, const sample_t *sample, void *output, command_t *command)
{
    const iiwa14_impedance_config *const c = config;
    output_t *const out = output;
    input_t in;
    memset(&in, 0, sizeof in);
    in.sample_valid = sample->valid;
    in.command = sample->pose ? IIWA14_COMMAND_EQUILIBRIUM : IIWA14_COMMAND_POSITION;
    in.wrench_valid = 1;
    in.counter = sample->counter;
    memcpy(in.q, sample->q, sizeof in.q);
    memcpy(in.dq, sample->dq, sizeof in.dq);
    memcpy(in.q0, sample->pose ? sample->posture : sample->wanted, sizeof in.q0);
    iiwa14_forward_kinematics(sample->wanted, in.equilibrium);
    memcpy(in.translation_stiffness, sample->translation, sizeof in.translation_stiffness);
    memcpy(in.rotation_stiffness, sample->rotation, sizeof in.rotation_stiffness);
    memcpy(in.wrench, sample->wrench, sizeof in.wrench);
    memcpy(in.velocity, sample->velocity, sizeof in.velocity);
    memcpy(in.acceleration, sample->acceleration, sizeof in.acceleration);
    memcpy(in.wrench_command, sample->wrench_command, sizeof in.wrench_command);
    if (sample->reset) {
        iiwa14_impedance_reset(state);
    }
    command->code = iiwa14_impedance_step(config, state, &in, out);
    memcpy(command->torque, out->tau_ff, sizeof command->torque);
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
