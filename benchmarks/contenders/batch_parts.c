/* SPDX-License-Identifier: MIT */
/*
 * Where the time of a batch goes: hybrid joint stiffness of the iiwa 14, one task stiffness for all, as it is and with
 * parts left out. Prints a line a part: its name and the least ns a configuration of all rounds.
 * batch_parts COUNT ROUNDS INPUTS, INPUTS with COUNT q (7) and wrenches (6), and one task stiffness (36).
 */
#define _GNU_SOURCE
#include "iiwa14.c"
#include "iiwa14_batch.c"

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#define FORGET __asm__ volatile("" ::: "memory") /* the compiler takes all memory as changed and as read */
enum { RESULT = N * N, ARGUMENTS = N + 6 };

static double *q, *wrench, *task_stiffness, *result;
static lanes q_lanes[N], wrench_lanes[6], task_stiffness_lanes[36], result_lanes[RESULT];
static lanes *all_arguments, *all_results;

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

static void load(size_t done, size_t count)
{
    load_lanes(q, N, done, count, N, q_lanes);
    load_lanes(wrench, 6, done, count, 6, wrench_lanes);
}

static void compute(void)
{
    hybrid_joint_stiffness_lanes(q_lanes, wrench_lanes, task_stiffness_lanes, result_lanes);
}

static void libm(size_t count)
{
    for (size_t k = 0; k < N * count; ++k) {
        sincos(q[k], &result[2 * (k % N)], &result[2 * (k % N) + 1]);
    }
}

static void whole_batch(size_t count)
{
    iiwa14_hybrid_joint_stiffness_batch(count, q, N, wrench, 6, task_stiffness, 0, result);
}

static void packed_batch(size_t count)
{
    iiwa14_hybrid_joint_stiffness_packed_batch(count, q, N, wrench, 6, task_stiffness, 0, result);
}

#define PART(name, ...)                                         \
    static void name(size_t count)                              \
    {                                                           \
        for (size_t done = 0; done < count; done += LANES) {    \
            FORGET;                                             \
            __VA_ARGS__;                                        \
            FORGET;                                             \
        }                                                       \
    }

PART(sines, lanes s[6]; lanes c[6]; sine_cosine(q_lanes, s, c, 6); __asm__ volatile("" : : "r"(s), "r"(c) : "memory"))
PART(columns, lanes J[6][N]; hybrid_columns_lanes(q_lanes, J); __asm__ volatile("" : : "r"(J) : "memory"))
PART(arithmetic, compute())
PART(in, load(done, count))
PART(out, store_lanes(result_lanes, count - done, RESULT, result + RESULT * done))
PART(no_in, compute(); store_lanes(result_lanes, count - done, RESULT, result + RESULT * done))
PART(no_out, load(done, count); compute())
PART(ahead, load(done, count); compute(); for (int k = LANES * RESULT; k < 2 * LANES * RESULT; k += 8) {
    __builtin_prefetch(result + RESULT * done + k, 1);
} store_lanes(result_lanes, count - done, RESULT, result + RESULT * done))
PART(lanes_in_memory, const lanes *const a = all_arguments + ARGUMENTS * (done / LANES);
    hybrid_joint_stiffness_lanes(a, a + N, task_stiffness_lanes, all_results + RESULT * (done / LANES)))
PART(structure_of_arrays, lanes a[ARGUMENTS]; lanes r[RESULT]; for (size_t k = 0; k < ARGUMENTS; ++k) {
    memcpy(&a[k], (const double *)all_arguments + k * count + done, sizeof a[k]);
} hybrid_joint_stiffness_lanes(a, a + N, task_stiffness_lanes, r); for (size_t k = 0; k < RESULT; ++k) {
    const lanes finite = finite_lanes(r[k]);
    memcpy(result + k * count + done, &finite, sizeof finite);
})
PART(fill, for (int k = 0; k < RESULT; ++k) { all_results[RESULT * (done / LANES) + (size_t)k] = result_lanes[0]; })

/* As many multiplications as the kernel has without its sines (546, in the comment over it), each with an addition, none of
 * which waits for the one before: 39 times 14 of them. */
static void peak(size_t count)
{
    lanes sum[14];
    const lanes factor = 0.0 * q_lanes[0] + 0.5, term = q_lanes[1];
    FORGET;
    memcpy(sum, result_lanes, sizeof sum);
    for (size_t done = 0; done < count; done += LANES) {
        for (int k = 0; k < 39; ++k) {
            _Pragma("GCC unroll 14")
            for (int n = 0; n < 14; ++n) {
                sum[n] = sum[n] * factor + term;
            }
        }
    }
    memcpy(result_lanes, sum, sizeof sum);
}

static const struct {
    const char *name;
    void (*run)(size_t count);
} parts[] = {
    {"seven libm sincos", libm},
    {"the batch", whole_batch},
    {"the packed batch: upper triangles, 28 numbers instead of 49", packed_batch},
    {"without transposes in", no_in},
    {"without transposes out", no_out},
    {"arithmetic alone, in the first cache", arithmetic},
    {"of it, columns with sines", columns},
    {"of these, sines", sines},
    {"546 independent multiplications with additions", peak},
    {"transposes in alone", in},
    {"transposes out alone", out},
    {"results written, nothing else", fill},
    {"tried: the next results' places fetched ahead", ahead},
    {"tried: arguments and results as lanes", lanes_in_memory},
    {"tried: arguments and results as structures of arrays", structure_of_arrays},
};
enum { PARTS = sizeof parts / sizeof parts[0] };

static void *room(size_t numbers)
{
    void *memory = aligned_alloc(64, (numbers * sizeof(double) + 127) / 64 * 64);
    if (!memory) {
        exit(1);
    }
    return memory;
}

int main(int argc, char **argv)
{
    const size_t count = argc == 4 ? (size_t)atol(argv[1]) / LANES * LANES : 0;
    const int rounds = argc == 4 ? atoi(argv[2]) : 0;
    FILE *file = argc == 4 ? fopen(argv[3], "rb") : NULL;
    double least[PARTS];
    if (count == 0) {
        return 2;
    }
    q = room(N * count);
    wrench = room(6 * count);
    task_stiffness = room(36);
    all_arguments = room(ARGUMENTS * count);
    result = room(RESULT * count);
    all_results = (lanes *)result;
    if (!file || fread(q, 8 * N, count, file) != count || fread(wrench, 48, count, file) != count
        || fread(task_stiffness, 288, 1, file) != 1) {
        return 1;
    }
    load_lanes(task_stiffness, 0, 0, count, 36, task_stiffness_lanes);
    for (size_t done = 0; done < count; done += LANES) {
        lanes *const a = all_arguments + ARGUMENTS * (done / LANES);
        load_lanes(q, N, done, count, N, a);
        load_lanes(wrench, 6, done, count, 6, a + N);
    }
    load(0, count);
    compute();
    const int repeats = count < 65536 ? (int)(65536 / count) : 1;
    for (int round = 0; round < rounds; ++round) {
        for (int k = 0; k < PARTS; ++k) {
            const double start = now();
            for (int r = 0; r < repeats; ++r) {
                parts[k].run(count);
            }
            const double ns = (now() - start) / ((double)repeats * (double)count);
            least[k] = round == 0 || ns < least[k] ? ns : least[k];
        }
    }
    for (int k = 0; k < PARTS; ++k) {
        printf("%s\t%.2f\n", parts[k].name, least[k]);
    }
    return 0;
}
