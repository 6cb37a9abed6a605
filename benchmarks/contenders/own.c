/* SPDX-License-Identifier: MIT */
/* The generated code, single calls and batches. The robot's source is included to build it with any flags. */
#include "iiwa14.c"
#include "iiwa14_batch.c"

void run(const double *q, const double *wrench, const double *task_stiffness, double *joint_stiffness)
{
    iiwa14_hybrid_joint_stiffness(q, wrench, task_stiffness, joint_stiffness);
}

void run_batch(size_t count, const double *q, const double *wrench, const double *task_stiffness, double *joint_stiffness)
{
    iiwa14_hybrid_joint_stiffness_batch(count, q, 7, wrench, 6, task_stiffness, 0, joint_stiffness);
}
