/* SPDX-License-Identifier: MIT */
/*
 * Springs against the plain hybrid joint stiffness: one process, in turn, the same postures.
 * Compiled with -DROBOT_C="..."; the iiwa 14 of benchmarks/run.py. springs INPUTS COUNT ROUNDS prints, a function a line,
 * its name and ROUNDS times in ns a configuration.
 *
 * INPUTS: doubles q[COUNT][7], wrench[COUNT][6], then one task stiffness (36), equilibrium (16), translation stiffness
 * (9), rotation stiffness (9).
 */
#define _POSIX_C_SOURCE 199309L
#include ROBOT_C
#include BATCH_C

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { REPEAT = 1 }; /* short enough to fall between two interruptions */

static double q[4096][7], wrench[4096][6], stiffness[36], equilibrium[16], translation[9], rotation[9];
static double energy[4096], torque[4096][7], matrix[4096][49];

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

static void run(int what, size_t count)
{
    if (what == 0) {
        for (size_t c = 0; c < count; ++c) {
            iiwa14_hybrid_joint_stiffness(q[c], wrench[c], stiffness, matrix[c]);
        }
    } else if (what == 1) {
        for (size_t c = 0; c < count; ++c) {
            iiwa14_spring_torque(q[c], equilibrium, translation, rotation, torque[c]);
        }
    } else if (what == 2) {
        for (size_t c = 0; c < count; ++c) {
            iiwa14_spring_linearization(q[c], equilibrium, translation, rotation, &energy[c], torque[c], matrix[c]);
        }
    } else if (what == 3) {
        iiwa14_hybrid_joint_stiffness_batch(count, q[0], 7, wrench[0], 6, stiffness, 0, matrix[0]);
    } else if (what == 4) {
        iiwa14_spring_torque_batch(count, q[0], 7, equilibrium, 0, translation, 0, rotation, 0, torque[0]);
    } else {
        iiwa14_spring_linearization_batch(count, q[0], 7, equilibrium, 0, translation, 0, rotation, 0, energy,
                                          torque[0], matrix[0]);
    }
}

int main(int argc, char **argv)
{
    static const char *const names[] = {"single hybrid.joint_stiffness", "single spring.torque",
                                        "single spring.linearization",   "batch hybrid.joint_stiffness",
                                        "batch spring.torque",           "batch spring.linearization"};
    FILE *file = argc == 4 ? fopen(argv[1], "rb") : NULL;
    const size_t count = argc == 4 ? (size_t)atoi(argv[2]) : 0;
    const int rounds = argc == 4 ? atoi(argv[3]) : 0;
    static double times[6][1024];
    if (file == NULL || count == 0 || count > 4096 || rounds < 1 || rounds > 1024
        || fread(q, sizeof q[0], count, file) != count || fread(wrench, sizeof wrench[0], count, file) != count
        || fread(stiffness, sizeof stiffness, 1, file) != 1 || fread(equilibrium, sizeof equilibrium, 1, file) != 1
        || fread(translation, sizeof translation, 1, file) != 1 || fread(rotation, sizeof rotation, 1, file) != 1) {
        return 2;
    }
    fclose(file);
    for (int round = -1; round < rounds; ++round) { /* the first one warms up */
        for (int what = 0; what < 6; ++what) {
            const double start = now();
            for (int k = 0; k < REPEAT; ++k) {
                run(what, count);
            }
            if (round >= 0) {
                times[what][round] = (now() - start) / (REPEAT * (double)count);
            }
        }
    }
    for (int what = 0; what < 6; ++what) {
        printf("%s;", names[what]);
        for (int round = 0; round < rounds; ++round) {
            printf(" %.3f", times[what][round]);
        }
        printf("\n");
    }
    return 0;
}
