/* SPDX-License-Identifier: MIT */
/*
 * Steps of a controller whose memory holds anything: patterns, random bytes and numbers, parts of a good state, with a
 * wrong checksum, the checksum 0 or one that fits. Compiled for one generated robot like arms.c; includes the
 * controller's file, so that checksums can be computed.
 * Arguments: trials, seed. Exit code 0, or 1 with the first failure on standard error.
 */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define JOIN_NAMES(a, b) a##b
#define JOIN(a, b) JOIN_NAMES(a, b)
#define ROBOT_(name) JOIN(ROBOT, _##name)

enum { BEFORE = 20, AFTER = 40, WAYS = 8 };

static uint64_t random_state;
static state_t state;

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

static double odd_number(void)
{
    static const double values[] = {5000.0, -5000.0, 1e300, -1e300, 1e5, 320.0, 1.0, 0.0, -0.0, 5e-324};
    static const double none[] = {NAN, INFINITY};
    const uint64_t which = bits() % 16;
    if (which >= 14) {
        return none[which - 14];
    }
    return which < 10 ? values[which] : 1e4 * (uniform() - 0.5);
}

/* Fill memory with one number, one byte, random bytes, or odd numbers. */
static void fill(void *target, size_t size)
{
    unsigned char *const at = target;
    double number = odd_number();
    const int way = (int)(bits() % 4);
    memset(at, (int)(bits() % 256), size);
    for (size_t k = 0; way != 3 && k + sizeof number <= size; k += sizeof number) {
        const uint64_t word = bits();
        if (way == 1) {
            memcpy(&number, &word, sizeof number);
        } else if (way == 2) {
            number = odd_number();
        }
        memcpy(at + k, &number, sizeof number);
    }
}

/* Spoil the state in one of WAYS ways. */
static void spoil(int way)
{
    static state_t kept;
    kept = state;
    fill(&state, sizeof state);
    if (way == 1) {
        state.checksum = 0u;
    } else if (way == 2) { /* all but the torques */
        memcpy(state.torque, kept.torque, sizeof kept.torque);
        memcpy(state.rate, kept.rate, sizeof kept.rate);
        memcpy(state.effort, kept.effort, sizeof kept.effort);
    } else if (way == 3) { /* the torques alone */
        state.memory = kept.memory;
        state.checksum = kept.checksum;
        if (bits() % 2 == 0) {
            memcpy(state.effort, kept.effort, sizeof kept.effort);
            memcpy(state.rate, kept.rate, sizeof kept.rate);
        }
    } else if (way >= 4) { /* a good state with a part that is not, and a checksum that fits */
        state_t wrong = state;
        state = kept;
        if (way == 4) { /* the numbers of the memory */
            memcpy(&state.memory, &wrong.memory, offsetof(memory_t, ready));
        } else if (way == 5) { /* all of the memory but its mark */
            state.memory = wrong.memory;
            state.memory.ready = READY;
        } else if (way == 6) { /* some words of it */
            for (int k = 0; k < 5; ++k) {
                const size_t at = bits() % (sizeof state.memory / 8) * 8;
                memcpy((char *)&state.memory + at, (char *)&wrong.memory + at, 8);
            }
        } else { /* a torque beyond the limit, stored as a step would */
            double torque[N];
            for (int i = 0; i < N; ++i) {
                torque[i] = odd_number();
            }
            store_copies(state.torque, torque);
        }
        state.checksum = compute_checksum(&state);
    }
}

static void good_sample(input_t *in, const double *posture, int k)
{
    memset(in, 0, sizeof *in);
    in->sample_valid = 1;
    in->clock = JOIN(UPPER, _CLOCK_COUNTER);
    in->counter = (uint32_t)k;
    for (int i = 0; i < N; ++i) {
        in->q[i] = posture[i] + 1e-4 * sin(0.01 * k);
        in->dq[i] = 1e-3 * cos(0.01 * k);
        in->q0[i] = posture[i] + 0.2;
    }
    for (int i = 0; i < 3; ++i) {
        in->translation_stiffness[4 * i] = 500.0;
        in->rotation_stiffness[4 * i] = 30.0;
    }
}

/* Check a step's torques. Return what is wrong, or NULL. */
static const char *check(const config_t *c, const output_t *out)
{
    for (int i = 0; i < N; ++i) {
        if (!(fabs(out->torque[i]) <= c->effort_limit[i])) {
            return "effort limit passed";
        }
    }
    return NULL;
}

int main(int count, char **arguments)
{
    static const double posture[N] = {POSTURE};
    const long trials = count > 1 ? atol(arguments[1]) : 10000;
    long refused = 0, faults = 0, own = 0;
    random_state = (count > 2 ? strtoull(arguments[2], NULL, 10) : 1) * 0x9e3779b97f4a7c15u + 1;
    for (long trial = 0; trial < trials; ++trial) {
        config_t config;
        input_t in;
        output_t out;
        ROBOT_(impedance_default_config)(&config);
        config.sample_time = 1e-3;
        config.delay_samples = (int)(bits() % 3);
        config.heaviest_wrench[0] = 100.0;
        config.heaviest_wrench[1] = 20.0;
        for (int i = 0; i < N; ++i) {
            config.motor_inertia[i] = 0.1;
            config.effort_limit[i] *= bits() % 2 ? 1.0 : uniform() + 1e-3;
        }
        const int way = (int)(bits() % WAYS);
        if (ROBOT_(impedance_init)(&config, &state, NULL) != JOIN(UPPER, _OK)) {
            fprintf(stderr, "configuration refused\n");
            return 1;
        }
        for (int k = 0; k < BEFORE + AFTER; ++k) {
            good_sample(&in, posture, k);
            in.sample_valid = k < BEFORE || bits() % 8 != 0;
            if (k == BEFORE) {
                spoil(way);
            }
            if (k > BEFORE && bits() % 16 == 0) {
                ROBOT_(impedance_reset)(&state);
            }
            const int asked = k >= BEFORE && bits() % 8 == 0;
            const int code = ROBOT_(impedance_step)(&state, asked ? NULL : &in, &out);
            const char *const wrong = check(&config, &out);
            if (wrong != NULL) {
                fprintf(stderr, "trial %ld, way %d, step %d after, code %d: %s\n", trial, way, k - BEFORE, code, wrong);
                return 1;
            }
            refused += k == BEFORE && code != JOIN(UPPER, _OK);
            faults += k == BEFORE && code == JOIN(UPPER, _OK) && out.fault != 0;
            own += k == BEFORE && code == JOIN(UPPER, _OK) && out.fault == 0;
        }
    }
    printf("%ld trials: %ld refused, %ld faults, %ld taken for a state\n", trials, refused, faults, own);
    return 0;
}
