/* SPDX-License-Identifier: MIT */
/*
 * The hybrid joint stiffness and its vector-Jacobian product in turn on the same 4096 configurations, single and in a batch:
 * least ns a configuration of as many rounds as its argument says.
 */
#define _GNU_SOURCE
#include SOURCE
#include BATCHES

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { COUNT = 4096 };

static double q[COUNT][N], wrench[COUNT][6], task_stiffness[36], cotangent[COUNT][N * N];
static double result[COUNT][N * N], q_bar[COUNT][N], wrench_bar[COUNT][6], task_stiffness_bar[COUNT][36];

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

static void fill(double *numbers, int count)
{
    for (int k = 0; k < count; ++k) {
        numbers[k] = 4.0 * rand() / RAND_MAX - 2.0;
    }
}

static void function(void)
{
    for (int c = 0; c < COUNT; ++c) {
        iiwa14_hybrid_joint_stiffness(q[c], wrench[c], task_stiffness, result[c]);
    }
}

static void product(void)
{
    for (int c = 0; c < COUNT; ++c) {
        iiwa14_hybrid_joint_stiffness_vjp(
            q[c], wrench[c], task_stiffness, cotangent[c], q_bar[c], wrench_bar[c], task_stiffness_bar[c]);
    }
}

static void function_batch(void)
{
    iiwa14_hybrid_joint_stiffness_batch(COUNT, q[0], N, wrench[0], 6, task_stiffness, 0, result[0]);
}

static void product_batch(void)
{
    iiwa14_hybrid_joint_stiffness_vjp_batch(COUNT, q[0], N, wrench[0], 6, task_stiffness, 0, cotangent[0], N * N,
        q_bar[0], wrench_bar[0], task_stiffness_bar[0]);
}

int main(int argc, char **argv)
{
    void (*const run[])(void) = {function, product, function_batch, product_batch};
    double least[4] = {1e300, 1e300, 1e300, 1e300};
    fill(q[0], COUNT * N);
    fill(wrench[0], COUNT * 6);
    fill(task_stiffness, 36);
    fill(cotangent[0], COUNT * N * N);
    for (int round = 0; argc == 2 && round < atoi(argv[1]); ++round) {
        for (int k = 0; k < 4; ++k) {
            const double start = now();
            run[k]();
            const double ns = (now() - start) / COUNT;
            least[k] = ns < least[k] ? ns : least[k];
        }
    }
    printf("%.2f %.2f %.2f %.2f\n", least[0], least[1], least[2], least[3]);
    return 0;
}
