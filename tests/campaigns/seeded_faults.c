/* SPDX-License-Identifier: MIT */
/* The iiwa 14's controller with ordinary and extreme configurations; prints a digest of all it gives back. */
#include "iiwa14_impedance.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static unsigned long long digest = 14695981039346656037ULL;

static void seen(const void *from, size_t size)
{
    const unsigned char *const bytes = from;
    for (size_t i = 0; i < size; ++i) {
        digest = (digest ^ bytes[i]) * 1099511628211ULL;
    }
}

static void configure(iiwa14_impedance_config *config, int delay)
{
    iiwa14_impedance_default_config(config);
    config->sample_time = 1e-3;
    config->delay_samples = delay;
    config->heaviest_wrench[0] = 50.0;
    config->heaviest_wrench[1] = 10.0;
    for (int i = 0; i < 7; ++i) {
        config->motor_inertia[i] = 0.1;
    }
}

/* Move an arm near its goal. Then leave out calls, by a counter that jumps ahead, until counters reach their bounds. */
static void run(iiwa14_impedance_state *state, int coarse)
{
    iiwa14_impedance_input input;
    iiwa14_impedance_output output;
    for (int step = 0; step < (coarse ? 30000 : 200); ++step) {
        memset(&input, 0, sizeof input);
        input.sample_valid = !coarse || step < 200;
        input.clock = IIWA14_CLOCK_COUNTER;
        input.counter = (uint32_t)(step < 200 ? step : 200000 * (step - 199));
        for (int i = 0; i < 7; ++i) {
            input.q0[i] = 0.3 + 0.1 * i;
            input.dq[i] = 0.02 * cos(0.002 * step + i);
            input.q[i] = input.q0[i] + 0.01 * sin(0.002 * step + i);
        }
        for (int i = 0; i < 9; i += 4) {
            input.translation_stiffness[i] = 500.0;
            input.rotation_stiffness[i] = 20.0;
        }
        iiwa14_impedance_step(state, &input, &output);
        seen(&output, sizeof output);
    }
}

int main(void)
{
    for (int delay = 0; delay <= 6; ++delay) { /* 6 is refused */
        for (int coarse = 0; coarse < 2; ++coarse) {
            iiwa14_impedance_config config;
            iiwa14_impedance_state state;
            configure(&config, delay);
            const int error = iiwa14_impedance_init(&config, &state, NULL);
            seen(&error, sizeof error);
            seen(&config, sizeof config);
            if (error == 0) {
                run(&state, coarse && delay == 0);
            }
        }
    }
    printf("%llu\n", digest);
    return 0;
}
