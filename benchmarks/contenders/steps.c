/* SPDX-License-Identifier: MIT */
/*
 * Counts the instructions that a contender executes, one by one, also where the machine has no counters and no
 * simulator knows its vectors: the parent steps its child through the calls.
 * steps INPUTS COUNT LIBRARY FUNCTION, FUNCTION run or run_batch. One line an address: file, offset in it, how often.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#if defined(__linux__) && defined(__x86_64__)
#include <signal.h>
#include <stddef.h>
#include <sys/ptrace.h>
#include <sys/user.h>
#include <sys/wait.h>

typedef void run_function(const double *, const double *, const double *, double *);
typedef void batch_function(size_t, const double *, const double *, const double *, double *);
typedef void setup_function(void);

enum { SLOTS = 1 << 17 };
static struct { unsigned long address, count; } seen[SLOTS];

__attribute__((noinline)) static void started(void)
{
    __asm__ volatile("# starts" ::: "memory");
}

__attribute__((noinline)) static void finished(void)
{
    __asm__ volatile("# ends" ::: "memory"); /* two functions of the same code would become one */
}

static void count_at(unsigned long address)
{
    unsigned long slot = address * 11400714819323198485ul >> 47;
    while (seen[slot].address && seen[slot].address != address) {
        slot = (slot + 1) % SLOTS;
    }
    seen[slot].address = address;
    ++seen[slot].count;
}

static int step_to(pid_t child, unsigned long end, int counting)
{
    unsigned long last = 0;
    for (;;) {
        int status;
        if (ptrace(PTRACE_SINGLESTEP, child, 0, 0) || waitpid(child, &status, 0) != child || !WIFSTOPPED(status)) {
            return 1;
        }
        const unsigned long address = (unsigned long)ptrace(PTRACE_PEEKUSER, child, offsetof(struct user_regs_struct, rip), 0);
        if (address == end) {
            return 0;
        }
        if (counting && address != last) { /* a repeated string instruction stops once a repetition */
            count_at(address);
        }
        last = address;
    }
}

int main(int argc, char **argv)
{
    const size_t count = argc == 5 ? (size_t)atol(argv[2]) : 0;
    double *q = malloc(7 * count * sizeof(double)), *wrench = malloc(6 * count * sizeof(double)), K[36];
    double *found = malloc(49 * count * sizeof(double));
    FILE *file = count ? fopen(argv[1], "rb") : NULL;
    if (!file || fread(q, 56, count, file) != count || fread(wrench, 48, count, file) != count || fread(K, 288, 1, file) != 1) {
        return 2;
    }
    void *library = dlopen(argv[3], RTLD_NOW | RTLD_LOCAL);
    void *function = library ? dlsym(library, argv[4]) : NULL;
    setup_function *setup = library ? (setup_function *)dlsym(library, "setup") : NULL;
    if (!function) {
        return 2;
    }
    if (setup) {
        setup();
    }
    const int many = !strcmp(argv[4], "run_batch");
    const pid_t child = fork();
    if (child == 0) {
        ptrace(PTRACE_TRACEME, 0, 0, 0);
        for (int warm = 0; warm < 2; ++warm) { /* the first time resolves symbols and touches memory */
            if (warm) {
                raise(SIGSTOP);
                started();
            }
            if (many) {
                ((batch_function *)function)(count, q, wrench, K, found);
            } else {
                for (size_t c = 0; c < count; ++c) {
                    ((run_function *)function)(q + 7 * c, wrench + 6 * c, K, found + 49 * c);
                }
            }
        }
        finished();
        _exit(0);
    }
    int status;
    if (waitpid(child, &status, 0) != child || !WIFSTOPPED(status) || step_to(child, (unsigned long)started, 0)
        || step_to(child, (unsigned long)finished, 1)) {
        return 3;
    }
    kill(child, SIGKILL);
    Dl_info own;
    dladdr((void *)(size_t)finished, &own);
    for (int k = 0; k < SLOTS; ++k) {
        Dl_info where;
        if (seen[k].address && dladdr((void *)seen[k].address, &where) && where.dli_fbase != own.dli_fbase) {
            printf("%s %lx %lu\n", where.dli_fname, seen[k].address - (unsigned long)where.dli_fbase, seen[k].count);
        }
    }
    return 0;
}
#else
int main(void)
{
    return 3;
}
#endif
