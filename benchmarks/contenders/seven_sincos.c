/* SPDX-License-Identifier: MIT */
/* The floor: seven sines and cosines of the C library. */
#define _GNU_SOURCE
#include <math.h>

void run(const double *q, const double *wrench, const double *task_stiffness, double *result)
{
    (void)wrench;
    (void)task_stiffness;
    for (int k = 0; k < 7; ++k) {
        sincos(q[k], &result[k], &result[7 + k]);
    }
}
