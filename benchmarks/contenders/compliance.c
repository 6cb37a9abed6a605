/* SPDX-License-Identifier: MIT */
/*
 * The hybrid joint stiffness and the functions of a loaded arm on joint springs in turn on the same 4096 configurations: a
 * line per function with its name and the least ns a configuration, single and in a batch, of as many rounds as the
 * argument says.
 */
#define _GNU_SOURCE
#include SOURCE
#include BATCHES

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { COUNT = 4096 };

static double q[COUNT][N], wrench[COUNT][6], task_stiffness[36], springs[N * N], increment[6], result[COUNT][N * N];

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

static void fill(double *numbers, int count, double most)
{
    for (int k = 0; k < count; ++k) {
        numbers[k] = most * (2.0 * rand() / RAND_MAX - 1.0);
    }
}

#define MORE_NONE
#define MORE_INCREMENT increment,
#define STEPS_NONE
#define STEPS_INCREMENT increment, 0,
#define PAIR(function, stiffness, more) \
    static void single_##function(void) \
    { \
        for (int c = 0; c < COUNT; ++c) { \
            iiwa14_hybrid_##function(q[c], wrench[c], stiffness, MORE_##more result[c]); \
        } \
    } \
    static void batch_##function(void) \
    { \
        iiwa14_hybrid_##function##_batch(COUNT, q[0], N, wrench[0], 6, stiffness, 0, STEPS_##more result[0]); \
    }
PAIR(joint_stiffness, task_stiffness, NONE)
PAIR(loaded_hessian, springs, NONE)
PAIR(tip_compliance, springs, NONE)
PAIR(tip_stiffness, springs, NONE)
PAIR(deflection, springs, INCREMENT)
PAIR(stability, springs, NONE)

#define ROW(function) {#function, {single_##function, batch_##function}}

int main(int argc, char **argv)
{
    static const struct {
        const char *name;
        void (*run[2])(void);
    } rows[] = {
        ROW(joint_stiffness), ROW(loaded_hessian), ROW(tip_compliance),
        ROW(tip_stiffness),   ROW(deflection),     ROW(stability),
    };
    enum { ROWS = sizeof rows / sizeof rows[0] };
    double least[ROWS][2];
    fill(q[0], COUNT * N, 2.0);
    fill(wrench[0], COUNT * 6, 20.0);
    fill(task_stiffness, 36, 100.0);
    fill(increment, 6, 1.0);
    for (int k = 0; k < N; ++k) {
        springs[N * k + k] = 500.0 + 100.0 * k; /* stable under these wrenches */
    }
    for (int round = 0; argc == 2 && round < atoi(argv[1]); ++round) {
        for (int k = 0; k < 2 * ROWS; ++k) {
            const double start = now();
            rows[k / 2].run[k % 2]();
            const double ns = (now() - start) / COUNT;
            least[k / 2][k % 2] = round > 0 && least[k / 2][k % 2] < ns ? least[k / 2][k % 2] : ns;
        }
    }
    for (int k = 0; k < ROWS; ++k) {
        printf("%s %.1f %.1f\n", rows[k].name, least[k][0], least[k][1]);
    }
    return 0;
}
