/* SPDX-License-Identifier: MIT */
/*
 * Hostile steps of the iiwa 14's controller: bad samples, commands, counters and calls, new starts with another
 * configuration and the torque in force, valid and not, and single bit flips of the state. Checked at every step: the torque
 * is finite, moves by no more than the rate limit in force, and is inside the effort limit in force; without a state that was
 * initialised it is 0.
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
    in->clock = IIWA14_CLOCK_COUNTER;
    in->counter = counter;
    in->shaped = t - floor(t) < 0.3;
    for (int i = 0; i < N; ++i) {
        const double rate = 0.7 + 0.3 * i;
        in->q[i] = POSTURE[i] + 0.3 * sin(rate * t);
        in->dq[i] = 0.3 * rate * cos(rate * t);
        in->q0[i] = POSTURE[i] + 0.4 * sin(0.9 * rate * t + i);
    }
    for (int k = 0; k < 3; ++k) {
        in->wrench_command[k] = 30.0 * sin((1.1 + k) * t);
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

static void take_defaults(config_t *config)
{
    iiwa14_impedance_default_config(config);
    config->sample_time = 1e-3;
    config->delay_samples = 0;
    config->heaviest_wrench[0] = 100.0;
    config->heaviest_wrench[1] = 20.0;
    for (int i = 0; i < N; ++i) {
        config->motor_inertia[i] = 0.1;
    }
}

/* A configuration changed in one to three fields, by factors that keep it reasonable or by anything. */
static void change(config_t *config)
{
    config_t fresh;
    take_defaults(&fresh);
    if (bits() % 3 == 0) {
        *config = fresh;
    }
    for (int k = 0; k < N; ++k) {
        const double factor = exp(6.0 * (uniform() - 0.5));
        switch (bits() % 6) {
        case 0: config->effort_limit[k] = fmin(fresh.effort_limit[k] * factor, 1e4); break;
        case 1: config->torque_rate_limit[k] = fresh.torque_rate_limit[k] * factor; break;
        case 2: config->velocity_limit[k] = fresh.velocity_limit[k] * factor; break;
        case 3: config->motor_inertia[k] = 0.1 * factor; break;
        default: break;
        }
    }
    switch (bits() % 8) {
    case 0: config->delay_samples = (int)(bits() % 6); break;
    case 1: config->coriolis = 1 + (int)(bits() % 2); break;
    case 2: config->sample_time = 0.001 * exp(3.0 * (uniform() - 0.5)); break;
    case 3: config->tank_initial = exp(6.0 * (uniform() - 0.5)); break;
    case 4: config->communication_reaction = 1 + (int)(bits() % 3); break;
    case 5: config->damping_ratio = 2.0 * uniform(); break;
    case 6: config->coulomb_friction[bits() % N] = fresh.effort_limit[0] * uniform(); break;
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

/* Check the torque of a step; last and rate are in force. Return 1 with a message if it is wrong. */
static int is_wrong(long step, int code, const output_t *out, const config_t *config, const double *last)
{
    for (int i = 0; i < N; ++i) {
        const double now = out->torque[i], rate = config->torque_rate_limit[i] * config->sample_time;
        if (!isfinite(now)) {
            return fail(step, "torque not finite", i, now, last[i]);
        }
        if (fabs(now) > config->effort_limit[i]) {
            return fail(step, "effort limit passed", i, now, last[i]);
        }
        if (!(code == IIWA14_E_NOT_INITIALISED && now == 0.0) && fabs(now - last[i]) > rate * (1 + 1e-12) + 1e-12) {
            return fail(step, "torque jumped", i, now, last[i]);
        }
    }
    return 0;
}

/* Start with another configuration and the torque in force; of a refused one nothing is kept but in one of eight. */
static int start_anew(config_t *in_force, state_t *state, const double *torque)
{
    config_t config = *in_force;
    state_t before = *state;
    change(&config);
    const int error = iiwa14_impedance_init(&config, state, torque);
    if (error == IIWA14_OK) {
        *in_force = config;
    } else if (bits() % 8 != 0) {
        *state = before;
    }
    return error != IIWA14_OK;
}

int main(int count, char **arguments)
{
    const long steps = count > 1 ? atol(arguments[1]) : 100000;
    const double flips = (count > 3 ? atof(arguments[3]) : 10000.0) / 1e6;
    static state_t state;
    config_t config;
    input_t in;
    output_t out;
    double last[N] = {0.0};
    long flipped = 0, faults = 0, refused = 0, active = 0, reasons[32] = {0}, seen = 0;
    uint32_t counter = 0;
    int was_fault = 0, code = IIWA14_E_NOT_INITIALISED;
    random_state = (count > 2 ? strtoull(arguments[2], NULL, 10) : 1) * 0x9e3779b97f4a7c15u + 1;
    take_defaults(&config);
    for (long step = 0; step < steps; ++step) {
        /* calm stretches, so that it comes back to control, and wild ones */
        const int calm = step / 500 % 2 == 0;
        counter += uniform() < (calm ? 0.0 : 0.02) ? (uint32_t)(bits() % 5) : 1u;
        good_sample(&in, counter);
        if (!calm && uniform() < 0.05) {
            spoil(&in, sizeof in);
        }
        in.sample_valid = uniform() < (calm ? 0.0 : 0.05) ? (int)(bits() % 3) : in.sample_valid;
        if (!calm && uniform() < 0.005) {
            refused += start_anew(&config, &state, last);
        }
        if (code == IIWA14_E_NOT_INITIALISED && uniform() < 0.05) { /* without a state only a start helps */
            take_defaults(&config);
            memset(last, 0, sizeof last);
            refused += iiwa14_impedance_init(&config, &state, NULL) != IIWA14_OK;
        }
        if (uniform() < (calm ? 0.1 : 0.02)) {
            iiwa14_impedance_reset(&state);
        }
        if (uniform() < flips) {
            const uint64_t at = bits() % (8 * sizeof state);
            ((unsigned char *)&state)[at / 8] ^= (unsigned char)(1u << at % 8);
            ++flipped;
        }
        code = iiwa14_impedance_step(&state, &in, &out);
        if (is_wrong(step, code, &out, &config, last)) {
            return 1;
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
