/* SPDX-License-Identifier: MIT */
/*
 * Times contenders, each a shared library with run() and maybe run_batch(), in turn on the same inputs: every other
 * round backwards, so that none always follows the same one.
 * driver INPUTS COUNT ROUNDS LIBRARY... reads COUNT q (7) and wrenches (6) and one task stiffness (36) from INPUTS.
 * The first library is the floor, the second one the reference of the values. First line: ns of a processor's cycle in
 * every round. Then one line a contender: name, largest relative difference, and ns a configuration of every round.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

typedef void run_function(const double *, const double *, const double *, double *);
typedef void batch_function(size_t, const double *, const double *, const double *, double *);
typedef void setup_function(void);

enum { MAX = 64 };

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

/* Nanoseconds of a cycle: multiplications of integers, each waiting for the one before, take three cycles on x86-64. */
static double cycle(void)
{
#if defined(__x86_64__)
    enum { LINKS = 20000 };
    unsigned long value = 3;
    const double start = now();
    for (int k = 0; k < LINKS; k += 10) {
        __asm__ volatile(
            "imul %0, %0\n\timul %0, %0\n\timul %0, %0\n\timul %0, %0\n\timul %0, %0\n\t"
            "imul %0, %0\n\timul %0, %0\n\timul %0, %0\n\timul %0, %0\n\timul %0, %0" : "+r"(value) : : "cc");
    }
    return (now() - start) / (3 * LINKS);
#else
    return 0.0;
#endif
}

int main(int argc, char **argv)
{
    const size_t count = (size_t)atol(argv[2]);
    const int rounds = atoi(argv[3]), given = argc - 4;
    double *q = malloc(7 * count * sizeof(double)), *wrench = malloc(6 * count * sizeof(double)), K[36];
    double *found = malloc(49 * count * sizeof(double)), *reference = malloc(49 * count * sizeof(double));
    double *times = malloc((size_t)rounds * MAX * sizeof(double)), *cycles = malloc((size_t)rounds * sizeof(double));
    const char *names[MAX];
    run_function *run[MAX];
    batch_function *batch[MAX];
    int n = 0;
    FILE *file = fopen(argv[1], "rb");
    if (!file || fread(q, 56, count, file) != count || fread(wrench, 48, count, file) != count || fread(K, 288, 1, file) != 1) {
        return 1;
    }
    for (int k = 0; k < given; ++k) {
        void *library = dlopen(argv[4 + k], RTLD_NOW | RTLD_LOCAL);
        if (!library) {
            fprintf(stderr, "%s\n", dlerror());
            return 1;
        }
        setup_function *setup = (setup_function *)dlsym(library, "setup");
        if (setup) {
            setup();
        }
        names[n] = argv[4 + k];
        run[n] = (run_function *)dlsym(library, "run");
        batch[n++] = NULL;
        if (dlsym(library, "run_batch")) {
            names[n] = argv[4 + k];
            run[n] = NULL;
            batch[n++] = (batch_function *)dlsym(library, "run_batch");
        }
    }
    double difference[MAX] = {0.0};
    for (int k = 1; k < n; ++k) {
        if (batch[k]) {
            batch[k](count, q, wrench, K, found);
        } else {
            for (size_t c = 0; c < count; ++c) {
                run[k](q + 7 * c, wrench + 6 * c, K, found + 49 * c);
            }
        }
        if (k == 1) {
            memcpy(reference, found, 49 * count * sizeof(double));
        }
        for (size_t c = 0; c < count; ++c) {
            double size = 0.0, off = 0.0;
            for (size_t e = 49 * c; e < 49 * (c + 1); ++e) {
                size = fmax(size, fabs(reference[e]));
                off = fmax(off, fabs(found[e] - reference[e]));
            }
            difference[k] = fmax(difference[k], off / size);
        }
    }
    for (int round = 0; round < rounds; ++round) {
        cycles[round] = cycle();
        for (int turn = 0; turn < n; ++turn) {
            const int k = round % 2 ? n - 1 - turn : turn;
            const double start = now();
            if (batch[k]) {
                batch[k](count, q, wrench, K, found);
            } else {
                for (size_t c = 0; c < count; ++c) {
                    run[k](q + 7 * c, wrench + 6 * c, K, found + 49 * c);
                }
            }
            times[(size_t)rounds * (size_t)k + (size_t)round] = (now() - start) / (double)count;
        }
    }
    for (int round = 0; round < rounds; ++round) {
        printf("%.5f%c", cycles[round], round + 1 < rounds ? ' ' : '\n');
    }
    for (int k = 0; k < n; ++k) {
        printf("%s%s %g", names[k], batch[k] ? "+batch" : "", difference[k]);
        for (int round = 0; round < rounds; ++round) {
            printf(" %.2f", times[rounds * k + round]);
        }
        putchar('\n');
    }
    return 0;
}
