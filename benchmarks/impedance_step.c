/* SPDX-License-Identifier: MIT */
/*
 * Time of a controller step of the iiwa 14, one by one: median and worst over many, and two units beside it, seven sines
 * and cosines of the C library, each the mean of many calls between two readings of the clock:
 *   changing: of 4096 random configurations, by benchmarks/contenders/seven_sincos.c: the unit of RESULTS.md
 *   repeated: near the step's own posture, where the processor knows all branches: the least that they can cost
 * Each step is also repeated from the same state, 5 times, and up to 50 while the least of its times is above 10 us.
 * The least is what the code costs, without what the machine adds (other processes, interrupts, a hypervisor).
 * Arguments: steps, processor, configuration (0 the reference moves, 1 the stiffness too).
 */
#define _GNU_SOURCE
#include "iiwa14_impedance.h"

#include <math.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { N = IIWA14_DOF, REPEATS = 5, MOST_REPEATS = 50, POSTURES = 16, CONFIGURATIONS = 4096 };

static const double SLOW = 10.0; /* us: a step that seems slower is repeated further */

static const double POSTURE[N] = {0.3, 0.6, -0.4, -1.3, 0.2, 0.9, -0.5};

/* Seven sines and cosines: benchmarks/contenders/seven_sincos.c. */
void run(const double *q, const double *wrench, const double *task_stiffness, double *result);

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e6 * (double)t.tv_sec + 1e-3 * (double)t.tv_nsec;
}

static int compare(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return x < y ? -1 : x > y;
}

/*
 * Return the mean time [us] of seven sines and cosines of many configurations. The results lie as far apart as joint
 * stiffnesses do, as in benchmarks/contenders/driver.c: together they are more than the first cache holds.
 */
static double time_changing(const double *q)
{
    static double results[CONFIGURATIONS * N * N];
    const double start = now();
    for (int k = 0; k < CONFIGURATIONS; ++k) {
        run(q + N * k, NULL, NULL, results + N * N * k);
    }
    return (now() - start) / CONFIGURATIONS;
}

/* Return the mean time [us] of seven sines and cosines near a posture: of several, as a clock may count in 20 ns. */
static double time_repeated(const double *q)
{
    volatile double sink = 0.0;
    double sum = 0.0;
    const double start = now();
    for (int r = 0; r < POSTURES; ++r) {
        for (int i = 0; i < N; ++i) {
            double sine, cosine;
            sincos(q[i] + 1e-3 * r, &sine, &cosine);
            sum += sine + cosine;
        }
    }
    const double time = (now() - start) / POSTURES;
    sink += sum;
    return time;
}

static void report(const char *what, double *times, long count)
{
    qsort(times, (size_t)count, sizeof(double), compare);
    printf("%-17s median %8.3f us   99.9 %% %8.3f us   99.999 %% %8.3f us   worst %8.3f us\n", what, times[count / 2],
        times[(long)((double)count * 0.999)], times[(long)((double)count * 0.99999)], times[count - 1]);
}

int main(int count, char **arguments)
{
    const long steps = count > 1 ? atol(arguments[1]) : 1000000;
    const int processor = count > 2 ? atoi(arguments[2]) : 0;
    const int design = count > 3 ? atoi(arguments[3]) : 0;
    static iiwa14_impedance_config config;
    static iiwa14_impedance_state state;
    static iiwa14_impedance_input in;
    static iiwa14_impedance_output out;
    double *const times = (double *)calloc((size_t)steps, sizeof(double));
    double *const least_times = (double *)calloc((size_t)steps, sizeof(double));
    double *const repeated_times = (double *)calloc((size_t)steps, sizeof(double));
    double *const changing_times = (double *)calloc((size_t)steps, sizeof(double));
    static double random[CONFIGURATIONS * N];
    long rounds = 0;
    cpu_set_t set;
    CPU_ZERO(&set);
    CPU_SET((unsigned)processor, &set);
    if (times == NULL || least_times == NULL || repeated_times == NULL || changing_times == NULL ||
         sched_setaffinity(0, sizeof set, &set) != 0) {
        return 2;
    }
    for (int i = 0; i < CONFIGURATIONS * N; ++i) {
        random[i] = 3.0 * rand() / RAND_MAX - 1.5;
    }
    iiwa14_impedance_default_config(&config);
    config.sample_time = 1e-3;
    config.delay_samples = 0;
    config.heaviest_wrench[0] = 100.0;
    config.heaviest_wrench[1] = 20.0;
    for (int i = 0; i < N; ++i) {
        config.motor_inertia[i] = 0.1;
    }
    if (iiwa14_impedance_init(&config, &state, NULL) != IIWA14_OK) {
        return 2;
    }
    in.sample_valid = 1;
    in.clock = IIWA14_CLOCK_COUNTER;
    for (long k = 0; k < steps; ++k) {
        const double t = 1e-3 * (double)k;
        for (int i = 0; i < N; ++i) {
            const double rate = 0.7 + 0.3 * i;
            in.q[i] = POSTURE[i] + 0.3 * sin(rate * t);
            in.dq[i] = 0.3 * rate * cos(rate * t);
            in.q0[i] = POSTURE[i] + 0.3 * sin(rate * t + 0.05);
            in.posture_stiffness[i] = 1.0;
        }
        for (int i = 0; i < 3; ++i) {
            in.translation_stiffness[4 * i] = 700.0 * (design == 1 ? 1.0 + 0.05 * sin((0.9 + i) * t) : 1.0);
            in.rotation_stiffness[4 * i] = 30.0 * (design == 1 ? 1.0 + 0.05 * sin((1.7 + i) * t) : 1.0);
        }
        in.counter = (uint32_t)k;
        double start;
        const iiwa14_impedance_state before = state;
        for (int r = 0; r < REPEATS || (r < MOST_REPEATS && least_times[k] > SLOW); ++r) {
            state = before;
            start = now();
            iiwa14_impedance_step(&state, &in, &out);
            const double time = now() - start;
            times[k] = r == 0 ? time : times[k];
            least_times[k] = r == 0 || time < least_times[k] ? time : least_times[k];
        }
        repeated_times[k] = time_repeated(in.q);
        if (k % CONFIGURATIONS == 0) {
            changing_times[rounds++] = time_changing(random);
        }
        if (out.status & IIWA14_STATUS_FAULT) {
            fprintf(stderr, "step %ld has a fault, reason %d\n", k, out.reason);
            return 1;
        }
    }
    report("step", times, steps);
    report("  least", least_times, steps);
    report("7 sincos changing", changing_times, rounds);
    report("7 sincos repeated", repeated_times, steps);
    printf("ratio of the medians: %.1f changing, %.1f repeated; worst least to the median %.2f\n",
        times[steps / 2] / changing_times[rounds / 2], times[steps / 2] / repeated_times[steps / 2],
        least_times[steps - 1] / times[steps / 2]);
    return 0;
}
