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

/* Search a posture of a pose in front of the arm. */
static void search(void)
{
    static const double pose[16] = {1.0, 0.0, 0.0, 0.5, 0.0, -1.0, 0.0, 0.1, 0.0, 0.0, -1.0, 0.4, 0.0, 0.0, 0.0, 1.0};
    static const double start[7] = {0.0, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0};
    double posture[7];
    iiwa14_impedance_config config;
    iiwa14_impedance_default_config(&config);
    const int error = iiwa14_find_posture(&config, pose, start, posture);
    seen(&error, sizeof error);
    seen(posture, sizeof posture);
}

int main(void)
{
    search();
    for (int delay = 0; delay <= 6; ++delay) { /* 6 is refused */
        for (int coarse = 0; coarse < 2; ++coarse) {
            iiwa14_impedance_config config;
            iiwa14_impedance_state state;
            iiwa14_impedance_input input;
            iiwa14_impedance_output output;
            iiwa14_impedance_default_config(&config);
            config.delay_samples = delay;
            if (coarse) { /* a velocity that would have to be averaged over more samples than a 32-bit integer counts */
                config.position_quantum = 0.1;
                for (int i = 0; i < 7; ++i) {
                    config.torque_rate_limit[i] = 1e-6;
                }
            }
            const int error = iiwa14_impedance_init(&config, &state, NULL);
            seen(&error, sizeof error);
            if (error != 0) {
                continue;
            }
            for (int step = 0; step < 200; ++step) {
                memset(&input, 0, sizeof input);
                input.sample_valid = 1;
                input.command = IIWA14_COMMAND_POSITION;
                input.counter = (uint32_t)step;
                for (int i = 0; i < 7; ++i) {
                    input.q0[i] = 0.3 + 0.1 * i;
                    input.dq[i] = 0.02 * cos(0.002 * step + i);
                    input.q[i] = input.q0[i] + 0.01 * sin(0.002 * step + i);
                }
                for (int i = 0; i < 9; i += 4) {
                    input.translation_stiffness[i] = 500.0;
                    input.rotation_stiffness[i] = 20.0;
                }
                iiwa14_impedance_step(&config, &state, &input, &output);
                seen(&output, sizeof output);
            }
            iiwa14_impedance_reset(&state);
        }
    }
    printf("%llu\n", digest);
    return 0;
}
