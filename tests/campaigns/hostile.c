/* SPDX-License-Identifier: MIT */
/*
 * Hostile steps of the iiwa 14's controller: bad samples, commands, counters and calls, a configuration that changes while
 * it runs, valid and not, and single bit flips of the state. Checked at every step: the torque is finite, moves by no more
 * than the rate limit in force, and is inside the effort limit, or on its way down to it at the rate limit.
 * Arguments: steps, seed, flips in a million steps. Exit code 0, or 1 with the first failure on standard error.
 */
#include "iiwa14_impedance.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { N = IIWA14_DOF };

typedef iiwa14_impedance_config config_t;
typedef iiwa14_impedance_state state_t;
typedef iiwa14_impedance_input input_t;
typedef iiwa14_impedance_output output_t;

static const double POSTURE[N] = {0.3, 0.6, -0.4, -1.3, 0.2, 0.9, -0.5};
static uint64_t random_state;

static uint64_t bits(void)
{
    random_state ^= random_state << 13;
    random_state ^= random_state >> 7;
    random_state ^= random_state << 17;
    return random_state;
}

static double uniform(void)
{
    return (double)(bits() >> 11) / 9007199254740992.0;
}

static double hostile_value(void)
{
    static const double values[] = {NAN, INFINITY, -INFINITY, 1e308, -1e308, 1e5, -1e5, 5e-324, -1e-310, 0.0, -0.0, 1.0};
    return values[bits() % (sizeof values / sizeof *values)];
}

static void good_sample(input_t *in, uint32_t counter)
{
    const double t = counter * 1e-3;
    memset(in, 0, sizeof *in);
    in->sample_valid = 1;
    in->command = t - floor(t) < 0.7 ? IIWA14_COMMAND_POSITION : IIWA14_COMMAND_EQUILIBRIUM;
    in->wrench_valid = 1;
    in->counter = counter;
    for (int i = 0; i < N; ++i) {
        const double rate = 0.7 + 0.3 * i;
        in->q[i] = POSTURE[i] + 0.3 * sin(rate * t);
        in->dq[i] = 0.3 * rate * cos(rate * t);
        in->q0[i] = POSTURE[i] + 0.4 * sin(0.9 * rate * t + i);
    }
    iiwa14_forward_kinematics(in->q0, in->equilibrium);
    for (int k = 0; k < 3; ++k) {
        in->wrench[k] = 30.0 * sin((1.1 + k) * t);
        in->translation_stiffness[4 * k] = 700.0 * (1.2 + sin(0.3 * t + k));
        in->rotation_stiffness[4 * k] = 30.0 * (1.2 + sin(0.4 * t + k));
    }
}

/* Spoil some numbers of a struct that holds doubles from `first` on, or its integers before. */
static void spoil(void *target, size_t size)
{
    char *const at = target;
    const int count = 1 + (int)(bits() % 3);
    for (int k = 0; k < count; ++k) {
        if (bits() % 4 == 0) {
            at[bits() % size] ^= (char)(1 << bits() % 8);
        } else {
            const double value = hostile_value();
            memcpy(at + 8 * (bits() % (size / 8)), &value, sizeof value);
        }
    }
}

/* A configuration changed in one to three fields, by factors that keep it reasonable or by anything. */
static void change(config_t *config)
{
    config_t fresh;
    iiwa14_impedance_default_config(&fresh);
    if (bits() % 3 == 0) {
        *config = fresh;
    }
    for (int k = 0; k < N; ++k) {
        const double factor = exp(6.0 * (uniform() - 0.5));
        switch (bits() % 8) {
        case 0: config->effort_limit[k] = fmin(fresh.effort_limit[k] * factor, 1e4); break;
        case 1: config->torque_rate_limit[k] = fresh.torque_rate_limit[k] * factor; break;
        case 2: config->damping_ratio[k] = fmin(factor, 100.0); break;
        case 3: config->posture_stiffness[k] = 10.0 * factor; break;
        case 4: config->limit_stiffness[k] = fresh.limit_stiffness[k] * factor; break;
        case 5: config->velocity_limit[k] = fresh.velocity_limit[k] * factor; break;
        case 6: config->motor_inertia[k] = 0.1 * factor; break;
        default: break;
        }
    }
    switch (bits() % 8) {
    case 0: config->delay_samples = (int)(bits() % 6); break;
    case 1: config->coriolis = 1 + (int)(bits() % 2); break;
    case 2: config->sample_time = 0.001 * exp(3.0 * (uniform() - 0.5)); break;
    case 3: config->limit_zone = 0.1 * exp(4.0 * (uniform() - 0.5)); break;
    case 4: config->communication_reaction = 1 + (int)(bits() % 3); break;
    case 5: config->joint_damping = exp(10.0 * (uniform() - 0.5)); break;
    default: break;
    }
    if (bits() % 20 == 0) {
        spoil(config, sizeof *config);
    }
}

static int fail(long step, const char *what, int joint, double value, double before)
{
    fprintf(stderr, "step %ld: %s: joint %d, %.17g after %.17g\n", step, what, joint, value, before);
    return 1;
}

int main(int count, char **arguments)
{
    const long steps = count > 1 ? atol(arguments[1]) : 100000;
    const double flips = (count > 3 ? atof(arguments[3]) : 10000.0) / 1e6;
    static state_t state;
    config_t config, wanted;
    input_t in;
    output_t out;
    double last[N] = {0.0}, rate[N];
    long flipped = 0, flip_at = -1, faults = 0, refused = 0, active = 0, reasons[32] = {0}, seen = 0;
    uint32_t counter = 0;
    int was_fault = 0;
    random_state = (count > 2 ? strtoull(arguments[2], NULL, 10) : 1) * 0x9e3779b97f4a7c15u + 1;
    iiwa14_impedance_default_config(&config);
    if (iiwa14_impedance_init(&config, &state, NULL) != IIWA14_OK) {
        return fail(0, "default configuration refused", 0, 0.0, 0.0);
    }
    for (int i = 0; i < N; ++i) {
        rate[i] = config.torque_rate_limit[i] * config.sample_time;
    }
    for (long step = 0; step < steps; ++step) {
        /* calm stretches, so that it comes back to control, and wild ones */
        const int calm = step / 500 % 2 == 0;
        counter += uniform() < (calm ? 0.0 : 0.02) ? (uint32_t)(bits() % 5) : 1u;
        good_sample(&in, counter);
        if (!calm && uniform() < 0.05) {
            spoil(&in, sizeof in);
        }
        in.sample_valid = uniform() < (calm ? 0.0 : 0.05) ? (int)(bits() % 3) : in.sample_valid;
        if (!calm && uniform() < 0.02) {
            change(&config);
        }
        if (calm && step % 500 == 0) {
            iiwa14_impedance_default_config(&config);
        }
        if (uniform() < (calm ? 0.1 : 0.02)) {
            iiwa14_impedance_reset(&state);
        }
        if (uniform() < flips) {
            const uint64_t at = bits() % (8 * sizeof state);
            ((unsigned char *)&state)[at / 8] ^= (unsigned char)(1u << at % 8);
            ++flipped;
            flip_at = step;
        }
        memcpy(&wanted, &config, sizeof wanted);
        const int code = iiwa14_impedance_step(&config, &state, &in, &out);
        if (memcmp(&wanted, &config, sizeof wanted) != 0) {
            return fail(step, "the configuration was written to", 0, 0.0, 0.0);
        }
        refused += code != IIWA14_OK;
        for (int i = 0; i < N; ++i) {
            if (code == IIWA14_OK) {
                rate[i] = config.torque_rate_limit[i] * config.sample_time;
            }
            if (!isfinite(out.torque[i])) {
                return fail(step, "torque not finite", i, out.torque[i], last[i]);
            }
            if (fabs(out.torque[i] - last[i]) > rate[i] * (1 + 1e-12) + 1e-12) {
                fprintf(stderr, "code %d, status %x, bit flips so far %ld, last at step %ld\n", code, (unsigned)out.status,
                        flipped, flip_at);
                return fail(step, "torque jumped", i, out.torque[i], last[i]);
            }
            if (code == IIWA14_OK && fabs(out.torque[i]) > config.effort_limit[i] &&
                fabs(out.torque[i]) > fabs(last[i]) - rate[i] * (1 - 1e-12) + 1e-12) {
                return fail(step, "effort limit passed", i, out.torque[i], last[i]);
            }
        }
        const int fault = out.fault != 0;
        faults += fault && !was_fault;
        active += !fault;
        if (fault && !was_fault && out.reason >= 0 && out.reason < 32) {
            seen += reasons[out.reason]++ == 0;
        }
        was_fault = fault;
        memcpy(last, out.torque, sizeof last);
    }
    printf("%ld steps, %ld under control, %ld faults for %ld reasons, %ld refused configurations, %ld bit flips\n", steps,
           active, faults, seen, refused, flipped);
    return 0;
}
