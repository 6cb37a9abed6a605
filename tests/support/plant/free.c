/* SPDX-License-Identifier: MIT */
/* No controller: the arm floats. For checks of the plant itself. */
#include "law.h"

#include <string.h>

size_t law_config_size(void)
{
    return sizeof(int);
}

size_t law_state_size(void)
{
    return sizeof(int);
}

size_t law_output_size(void)
{
    return sizeof(int);
}

void law_default_config(void *config)
{
    memset(config, 0, sizeof(int));
}

int law_init(const void *config, void *state, const double *torque, const double *tool)
{
    (void)config;
    (void)state;
    (void)torque;
    (void)tool;
    return 0;
}

void law_step(void *state, const sample_t *sample, void *output, command_t *command)
{
    (void)state;
    (void)sample;
    (void)output;
    memset(command, 0, sizeof *command);
}
