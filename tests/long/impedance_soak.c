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

enum { CONFIGS = 6 };

static void make_configs(iiwa14_impedance_config *c)
{
    for (int k = 0; k < CONFIGS; ++k) {
        iiwa14_impedance_default_config(&c[k]);
        c[k].return_time = 0.05;
    }
    c[1].damping_design = IIWA14_DAMPING_DESIGN_FACTORISED;
    c[1].stiffness_sign = IIWA14_STIFFNESS_SIGN_POSITIVE_PART;
    c[2].damping_design = IIWA14_DAMPING_DESIGN_TASK;
    for (int k = 0; k < 6; ++k) {
        c[2].task_damping[7 * k] = k < 3 ? 40.0 : 12.0;
    }
    c[2].tank = IIWA14_TANK_OFF;
    c[3].nullspace = IIWA14_NULLSPACE_PROJECTED;
    c[3].wrench_filter = IIWA14_WRENCH_FILTER_MOVING_AVERAGE;
    c[3].representation = IIWA14_REPRESENTATION_BODY;
    c[4].stiffness_formula = IIWA14_STIFFNESS_FORMULA_CONVENTIONAL;
    c[4].tank = IIWA14_TANK_OFF;
    c[5].representation = IIWA14_REPRESENTATION_SPATIAL;
    c[5].return_time = 0.0;
    c[5].tank_initial = c[5].tank_minimum = 0.0;
}

static void good_sample(iiwa14_impedance_input *in, double t, unsigned long long *random)
{
    memset(in, 0, sizeof *in);
    in->sample_valid = 1;
    for (int i = 0; i < N; ++i) {
        const double rate = 0.7 + 0.3 * i;
        in->q[i] = POSTURE[i] + 0.3 * sin(rate * t);
        in->dq[i] = 0.3 * rate * cos(rate * t);
        in->q0[i] = POSTURE[i] + 0.4 * sin(0.9 * rate * t + i);
        in->dq0[i] = 0.36 * rate * cos(0.9 * rate * t + i);
    }
    for (int k = 0; k < 6; ++k) {
        in->wrench[k] = (k < 3 ? 30.0 : 8.0) * sin((1.1 + k) * t) + uniform(random);
        in->task_stiffness[7 * k] = (k < 3 ? 700.0 : 30.0) * (1.2 + sin(0.3 * t));
    }
}

/* Spoil one number; returns whether the controller must refuse the sample. */
static int spoil(iiwa14_impedance_input *in, unsigned long long *random)
{
    static const double values[] = {NAN, INFINITY, -INFINITY, 1e308, -1e308, 1e5, 5e-324, -1e-310};
    const int kind = (int)(bits(random) % 8);
    const int entry = (int)(bits(random) % 36);
    double *const fields[] = {in->q, in->dq, in->q0, in->dq0, in->wrench, in->task_stiffness};
    const int field = (int)(bits(random) % 6);
    const int index = field < 4 ? entry % N : field == 4 ? entry % 6 : entry;
    if (kind >= 6 && field == 5) {
        in->task_stiffness[index] = index % 7 == 0 ? values[kind] * 0.0 : values[kind];
        return 0; /* a denormal off the diagonal is within the symmetry tolerance; zero on it is allowed */
    }
    fields[field][index] = values[kind];
    return kind < 6;
}

static int finite_output(const iiwa14_impedance_output *out)
{
    const double *const arrays[] = {out->torque, out->position, out->velocity, out->reference, out->reference_velocity,
        out->error, out->elastic_torque, out->damping_torque, out->limit_torque, out->eigenvalues};
    const double *const matrices[] = {out->stiffness_target, out->stiffness, out->damping, out->mass_matrix};
    const double *const scalars[] = {&out->antisymmetric_norm, &out->singularity, &out->stiffness_step, &out->blend,
        &out->elastic_energy, &out->limit_energy, &out->dissipated_power, &out->variation_power,
        &out->antisymmetric_power, &out->tank_energy, &out->tank_deficit, &out->port_total, &out->variation_total,
        &out->sampling_total, &out->antisymmetric_total, &out->limiting_total, &out->dissipated_total,
        &out->released_total, &out->engaged_total};
    for (size_t a = 0; a < sizeof arrays / sizeof *arrays; ++a) {
        for (int i = 0; i < N; ++i) {
            if (!isfinite(arrays[a][i])) {
                return 0;
            }
        }
    }
    for (size_t a = 0; a < sizeof matrices / sizeof *matrices; ++a) {
        for (int i = 0; i < N * N; ++i) {
            if (!isfinite(matrices[a][i])) {
                return 0;
            }
        }
    }
    for (size_t a = 0; a < sizeof scalars / sizeof *scalars; ++a) {
        if (!isfinite(*scalars[a])) {
            return 0;
        }
    }
    return 1;
}

static const char *check(const iiwa14_impedance_config *c, const iiwa14_impedance_output *out, const double *last,
    int bad, int missed, int quiet)
{
    const unsigned refused =
        IIWA14_STATUS_NON_FINITE | IIWA14_STATUS_OUT_OF_RANGE | IIWA14_STATUS_TASK_STIFFNESS;
    if (!finite_output(out)) {
        return "output not finite";
    }
    for (int i = 0; i < N; ++i) {
        if (fabs(out->torque[i]) > c->effort_limit[i]) {
            return "effort limit exceeded";
        }
        if (fabs(out->torque[i] - last[i]) > c->torque_rate_limit[i] * c->sample_time * (1 + 1e-12)) {
            return "torque jumped";
        }
    }
    if (bad && !missed && (!(out->status & refused) || !(out->status & IIWA14_STATUS_FALLBACK))) {
        return "bad sample without its status bit";
    }
    if (!bad && !missed && (out->status & (refused | IIWA14_STATUS_FALLBACK))) {
        return "good sample refused";
    }
    if (missed != ((out->status & IIWA14_STATUS_MISSED) != 0)) {
        return "missed sample without its status bit";
    }
    if (quiet > QUIET && (out->status & (IIWA14_STATUS_RETURNING | IIWA14_STATUS_FALLBACK))) {
        return "did not recover";
    }
    if (c->tank == IIWA14_TANK_ON && out->tank_energy < c->tank_minimum) {
        return "tank below its minimum";
    }
    return NULL;
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
            j->failure = iiwa14_impedance_init(c, &state) == IIWA14_OK ? NULL : "configuration refused";
            memset(last, 0, sizeof last);
            quiet = 0;
        }
        good_sample(&in, (double)k * 1e-3, &random);
        const int bad = uniform(&random) < 0.01 && spoil(&in, &random);
        const int missed = uniform(&random) < 0.01;
        in.sample_valid = !missed;
        if (j->failure == NULL && iiwa14_impedance_step(c, &state, &in, &out) != IIWA14_OK) {
            j->failure = "step refused";
        }
        quiet = bad || missed ? 0 : quiet + 1;
        j->recovered += quiet == QUIET + 1;
        j->bad += bad && !missed;
        j->missed += missed;
        j->failure = j->failure != NULL ? j->failure : check(c, &out, last, bad, missed, quiet);
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
