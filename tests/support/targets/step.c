/* SPDX-License-Identifier: MIT */
/*
 * The controller's step at many states, between marks: half of them of smooth motions, half hostile (samples missed or
 * not finite, counters that leap, stiffnesses that change, resets), so that every loop is seen at its longest.
 * ROBOT(x), the prefix, and CLOCK are defined in robot.h, which includes the header; STATES by a flag.
 */
#include "robot.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

__attribute__((noinline)) void mark_begin(void) { __asm__ volatile(""); }
__attribute__((noinline)) void mark_end(void) { __asm__ volatile("" ::: "memory"); }
__attribute__((noinline)) void mark_report(void) { __asm__ volatile("nop"); }

static uint64_t generator = 88172645463325252ull;

static double uniform(double low, double high)
{
    generator ^= generator << 13;
    generator ^= generator >> 7;
    generator ^= generator << 17;
    return low + (high - low) * (double)(generator >> 11) * 0x1p-53;
}

static void symmetric(double *matrix, int n, double size)
{
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j <= i; ++j) {
            matrix[n * i + j] = matrix[n * j + i] = i == j ? uniform(0.2, 1.0) * size : uniform(-0.1, 0.1) * size;
        }
    }
}

int main(void)
{
    static ROBOT(config) config;
    static ROBOT(state) state;
    static ROBOT(input) in;
    static ROBOT(output) out;
    enum { N = sizeof in.q / sizeof *in.q };
    uint32_t counter = 0;
    ROBOT(default_config)(&config);
    config.sample_time = 1e-3;
    config.delay_samples = 0;
    config.heaviest_wrench[0] = 100.0;
    config.heaviest_wrench[1] = 20.0;
    for (int i = 0; i < N; ++i) {
        config.motor_inertia[i] = 0.1;
    }
    if (ROBOT(init)(&config, &state, NULL) != 0) {
        return 2;
    }
    for (long k = 0; k < STATES; ++k) {
        const double t = 1e-3 * (double)k;
        const int hostile = k / 500 % 2, kind = (int)uniform(0.0, 40.0);
        for (int i = 0; i < N; ++i) {
            const double rate = 0.7 + 0.3 * i, middle = 0.5 * (config.lower_limit[i] + config.upper_limit[i]);
            in.q[i] = middle + 0.3 * sin(rate * t);
            in.dq[i] = 0.3 * rate * cos(rate * t);
            in.q0[i] = middle + 0.3 * sin(rate * t + 0.05);
        }
        for (int i = 0; i < 6; ++i) {
            in.wrench_command[i] = hostile ? uniform(-8.0, 8.0) : 0.0;
        }
        if (k % 50 == 0) {
            symmetric(in.translation_stiffness, 3, hostile ? uniform(0.0, 3000.0) : 700.0);
            symmetric(in.rotation_stiffness, 3, hostile ? uniform(0.0, 300.0) : 30.0);
        }
        in.sample_valid = 1;
        in.clock = CLOCK;
        counter += 1;
        if (hostile) {
            in.sample_valid = kind != 0;
            counter += kind == 1 ? 1000u : 0u;
            in.q[0] += kind == 2 ? uniform(-1.0, 1.0) : 0.0;
            in.q[N - 1] = kind == 3 ? NAN : in.q[N - 1];
            in.dq[0] = kind == 4 ? INFINITY : in.dq[0];
            in.q0[0] += kind == 5 ? uniform(-1.0, 1.0) : 0.0;
        }
        in.counter = counter;
        mark_begin();
        ROBOT(step)(&state, &in, &out);
        mark_end();
        if (kind == 39) {
            ROBOT(reset)(&state);
        }
    }
    mark_report();
    return 0;
}
