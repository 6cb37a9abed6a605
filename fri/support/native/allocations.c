/* SPDX-License-Identifier: MIT */
/*
 * Preloaded into fri_wiping: counts allocations from the moment its port is bound until that socket is closed, in all
 * threads, and page faults of the thread that receives, from the first datagram until then. Writes allocations,
 * datagrams, and minor and major page faults to the file FRI_ALLOCATIONS names. glibc only.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

extern void *__libc_malloc(size_t size);
extern void *__libc_calloc(size_t count, size_t size);
extern void *__libc_realloc(void *memory, size_t size);
extern void *__libc_memalign(size_t alignment, size_t size);

static atomic_int watched = -1; /* the socket, once it is bound; -2: closed */
static atomic_ulong allocations, datagrams;
static struct rusage before;

static void count(void)
{
    if (watched >= 0) {
        ++allocations;
    }
}

void *malloc(size_t size)
{
    count();
    return __libc_malloc(size);
}

void *calloc(size_t number, size_t size)
{
    count();
    return __libc_calloc(number, size);
}

void *realloc(void *memory, size_t size)
{
    count();
    return __libc_realloc(memory, size);
}

void *memalign(size_t alignment, size_t size)
{
    count();
    return __libc_memalign(alignment, size);
}

void *aligned_alloc(size_t alignment, size_t size)
{
    count();
    return __libc_memalign(alignment, size);
}

int posix_memalign(void **memory, size_t alignment, size_t size)
{
    count();
    *memory = __libc_memalign(alignment, size);
    return *memory == NULL;
}

/* Replace the C library's: count datagrams, and note the page faults before the first one. */
ssize_t recvmsg(int fd, struct msghdr *message, int flags)
{
    ssize_t (*const real)(int, struct msghdr *, int) = dlsym(RTLD_NEXT, "recvmsg");
    const ssize_t received = real(fd, message, flags);
    if (received > 0 && datagrams++ == 0) {
        getrusage(RUSAGE_THREAD, &before);
    }
    return received;
}

int bind(int fd, const struct sockaddr *address, socklen_t length)
{
    int (*const real)(int, const struct sockaddr *, socklen_t) = dlsym(RTLD_NEXT, "bind");
    const int result = real(fd, address, length);
    watched = watched == -1 && result == 0 ? fd : watched;
    return result;
}

/* Replace the C library's: when the watched socket is closed, write allocations, datagrams and page faults. */
int close(int fd)
{
    int (*const real)(int) = dlsym(RTLD_NEXT, "close");
    if (fd == watched) {
        struct rusage after;
        getrusage(RUSAGE_THREAD, &after);
        watched = -2;
        FILE *const file = fopen(getenv("FRI_ALLOCATIONS"), "w");
        fprintf(file, "%lu %lu %ld %ld\n", (unsigned long)allocations, (unsigned long)datagrams,
                after.ru_minflt - before.ru_minflt, after.ru_majflt - before.ru_majflt);
        fclose(file);
    }
    return real(fd);
}
