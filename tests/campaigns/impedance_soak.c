/* SPDX-License-Identifier: MIT */
/*
 * Many controller steps of the iiwa 14 with hostile input, checked one by one. Arguments: steps, seed, threads.
 * Exit code 0, or 1 with the first failure on standard error. With -DABORTING_ALLOCATOR any allocation while stepping
 * aborts.
 */
#include "iiwa14_impedance.h"

#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef ABORTING_ALLOCATOR
void *__libc_malloc(size_t);
void *__libc_calloc(size_t, size_t);
void *__libc_realloc(void *, size_t);
void __libc_free(void *);
static volatile int armed;
static void refuse(void)
{
    if (armed) {
        abort();
    }
}
void *malloc(size_t size) { refuse(); return __libc_malloc(size); }
void *calloc(size_t count, size_t size) { refuse(); return __libc_calloc(count, size); }
void *realloc(void *old, size_t size) { refuse(); return __libc_realloc(old, size); }
void free(void *old) { refuse(); __libc_free(old); }
#endif

enum { N = IIWA14_DOF, QUIET = 70 };

typedef struct {
    long steps;
    unsigned long long seed;
    const iiwa14_impedance_config *configs;
    long bad, missed, recovered;
    const char *failure;
    long at;
} job;

static const double POSTURE[N] = {0.3, 0.6, -0.4, -1.3, 0.2, 0.9, -0.5};

static unsigned long long bits(unsigned long long *state)
{
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    return *state;
}

static double uniform(unsigned long long *state)
{
    return (double)(bits(state) >> 11) / 9007199254740992.0;
}

enum { CONFIGS = 4 };

static void make_configs(iiwa14_impedance_config *c)
{
    for (int k = 0; k < CONFIGS; ++k) {
        iiwa14_impedance_default_config(&c[k]);
        c[k].sample_time = 1e-3;
        c[k].delay_samples = 0;
        c[k].heaviest_wrench[0] = 100.0;
        c[k].heaviest_wrench[1] = 20.0;
        for (int i = 0; i < N; ++i) {
            c[k].motor_inertia[i] = 0.1;
        }
    }
    c[1].damping_ratio = 2.0;
    c[2].delay_samples = 2;
    c[3].coriolis = IIWA14_CORIOLIS_ON;
}

static void good_sample(iiwa14_impedance_input *in, double t, unsigned long long *random)
{
    memset(in, 0, sizeof *in);
    in->sample_valid = 1;
    in->clock = IIWA14_CLOCK_COUNTER;
    in->counter = (uint32_t)(t * 1e3 + 0.5);
    for (int i = 0; i < N; ++i) {
        const double rate = 0.7 + 0.3 * i;
        in->q[i] = POSTURE[i] + 0.1 * sin(rate * t);
        in->dq[i] = 0.1 * rate * cos(rate * t);
        in->q0[i] = POSTURE[i] + 0.1 * sin(0.9 * rate * t + i);
    }
    for (int k = 0; k < 6; ++k) {
        in->wrench_command[k] = sin((1.1 + k) * t) + uniform(random);
    }
    for (int k = 0; k < 3; ++k) {
        in->translation_stiffness[4 * k] = 700.0 * (1.2 + sin(0.3 * t));
        in->rotation_stiffness[4 * k] = 30.0 * (1.2 + sin(0.3 * t));
    }
}

/* Spoil one number; returns whether the controller must refuse sample or command. */
static int spoil(iiwa14_impedance_input *in, unsigned long long *random)
{
    static const double values[] = {NAN, INFINITY, -INFINITY, 1e308, -1e308, 1e9};
    double *const fields[] = {in->q, in->dq, in->q0};
    fields[bits(random) % 3][bits(random) % N] = values[bits(random) % 6];
    return 1;
}

static const char *check(const iiwa14_impedance_config *c, const iiwa14_impedance_output *out, const double *last,
    int bad, int missed)
{
    const unsigned refused = IIWA14_STATUS_BAD_SAMPLE | IIWA14_STATUS_COMMAND_REFUSED;
    for (int i = 0; i < N; ++i) {
        if (!isfinite(out->torque[i]) || !isfinite(out->position[i]) || !isfinite(out->reference[i]) ||
            !isfinite(out->tank) || !isfinite(out->energy_supplied)) {
            return "output not finite";
        }
        if (fabs(out->torque[i]) > c->effort_limit[i]) {
            return "effort limit exceeded";
        }
        if (fabs(out->torque[i] - last[i]) > c->torque_rate_limit[i] * c->sample_time * (1 + 1e-12)) {
            return "torque jumped";
        }
    }
    if (bad && !missed && !(out->status & refused)) {
        return "bad sample without its status bit";
    }
    return missed && !(out->status & IIWA14_STATUS_MISSED) ? "missed sample without its status bit" : NULL;
}

static void *work(void *argument)
{
    job *const j = (job *)argument;
    iiwa14_impedance_state state;
    iiwa14_impedance_input in;
    iiwa14_impedance_output out;
    const iiwa14_impedance_config *c = j->configs;
    unsigned long long random = j->seed * 0x9e3779b97f4a7c15ull + 1;
    double last[N] = {0.0};
    int quiet = 0;
    const long block = j->steps / CONFIGS + 1;
    for (long k = 0; k < j->steps && j->failure == NULL; ++k) {
        if (k % block == 0) {
            c = &j->configs[k / block];
            j->failure = iiwa14_impedance_init(c, &state, NULL) == IIWA14_OK ? NULL : "configuration refused";
            memset(last, 0, sizeof last);
            quiet = 0;
        }
        good_sample(&in, (double)k * 1e-3, &random);
        const int bad = uniform(&random) < 0.01 && spoil(&in, &random);
        const int missed = uniform(&random) < 0.01;
        in.sample_valid = !missed;
        if (j->failure == NULL && iiwa14_impedance_step(&state, &in, &out) != IIWA14_OK) {
            j->failure = "step refused";
        }
        if (k % 20 == 0 && iiwa14_impedance_reset(&state) != IIWA14_OK) {
            j->failure = "reset refused";
        }
        quiet = bad || missed ? 0 : quiet + 1;
        j->recovered += quiet == QUIET + 1;
        j->bad += bad && !missed;
        j->missed += missed;
        j->failure = j->failure != NULL ? j->failure : check(c, &out, last, bad, missed);
        j->at = k;
        memcpy(last, out.torque, sizeof last);
    }
    return NULL;
}

int main(int count, char **arguments)
{
    static iiwa14_impedance_config configs[CONFIGS];
    job jobs[8];
    pthread_t threads[8];
    const long steps = count > 1 ? atol(arguments[1]) : 10000;
    const unsigned long long seed = count > 2 ? strtoull(arguments[2], NULL, 10) : 1;
    const int workers = count > 3 ? atoi(arguments[3]) : 1;
    int failed = 0;
    make_configs(configs);
    for (int w = 0; w < workers && w < 8; ++w) {
        const job fresh = {steps, seed + (unsigned)w, configs, 0, 0, 0, NULL, 0};
        jobs[w] = fresh;
    }
    if (workers == 1) {
#ifdef ABORTING_ALLOCATOR
        armed = 1;
#endif
        work(&jobs[0]);
#ifdef ABORTING_ALLOCATOR
        armed = 0;
#endif
    }
    for (int w = 0; workers > 1 && w < workers && w < 8; ++w) {
        if (pthread_create(&threads[w], NULL, work, &jobs[w]) != 0) {
            return 2;
        }
    }
    for (int w = 0; workers > 1 && w < workers && w < 8; ++w) {
        pthread_join(threads[w], NULL);
    }
    for (int w = 0; w < workers && w < 8; ++w) {
        printf("%ld steps, %ld refused samples, %ld missed, %ld recoveries\n", steps, jobs[w].bad, jobs[w].missed,
            jobs[w].recovered);
        if (jobs[w].failure != NULL) {
            fprintf(stderr, "step %ld: %s\n", jobs[w].at, jobs[w].failure);
            failed = 1;
        }
    }
    return failed;
}
