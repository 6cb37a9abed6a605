/* SPDX-License-Identifier: MIT */
/* Kernels of the generated robot, in the coordinates that its controller has. */
#include "plant.h"

#include <string.h>

#ifdef PLANT_START /* closed loops: joints of a closed configuration, separated by commas */

enum { JOINTS_OF_TREE = UPPER_(DOF) };

static void close_loops(const double *q, double *joints)
{
    static const double start[JOINTS_OF_TREE] = {PLANT_START};
    ROBOT_(close)(q, start, joints);
}

void robot_poses(const double *q, const double *tools, double *poses)
{
    double joints[JOINTS_OF_TREE];
    (void)tools;
    close_loops(q, joints);
    ROBOT_(forward_kinematics)(joints, poses);
}

void robot_jacobian(const double *q, double *J)
{
    double joints[JOINTS_OF_TREE], G[JOINTS_OF_TREE * N], tree[6 * JOINTS_OF_TREE];
    close_loops(q, joints);
    ROBOT_(motors_jacobian)(joints, G);
    ROBOT_(hybrid_jacobian)(joints, tree);
    memset(J, 0, 6 * N * sizeof *J);
    for (int k = 0; k < 6 * JOINTS_OF_TREE; ++k) {
        for (int i = 0; i < N; ++i) {
            J[k / JOINTS_OF_TREE * N + i] += tree[k] * G[k % JOINTS_OF_TREE * N + i];
        }
    }
}

void robot_mass_matrices(int count, const double *q, double *M)
{
    for (int k = 0; k < count; ++k) {
        double joints[JOINTS_OF_TREE];
        close_loops(q + k * N, joints);
        ROBOT_(motors_mass_matrix)(joints, M + k * N * N);
    }
}

double robot_depth(int i, double q)
{
    (void)i;
    (void)q;
    return 0.0;
}

#else

#ifdef PLANT_TOOLS
static const double NO_TOOL[16] = {1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0};
#define TOOL_(tip) , tools != NULL ? tools + 16 * (tip) : NO_TOOL
#else
#define TOOL_(tip)
#endif

void robot_poses(const double *q, const double *tools, double *poses)
{
    (void)tools;
    FIRST_(forward_kinematics)(q TOOL_(0), poses);
#ifdef PLANT_SECOND
    SECOND_(forward_kinematics)(q TOOL_(1), poses + 16);
#endif
}

void robot_jacobian(const double *q, double *J)
{
    const double *const tools = NULL;
    (void)tools;
    FIRST_(hybrid_jacobian)(q TOOL_(0), J);
}

void robot_mass_matrices(int count, const double *q, double *M)
{
    if (count == 1) {
        ROBOT_(mass_matrix)(q, M);
    } else {
        ROBOT_(mass_matrix_batch)((size_t)count, q, N, M);
    }
}

double robot_depth(int i, double q)
{
    const double above = q - ROBOT_(upper)[i], below = q - ROBOT_(lower)[i];
    if (above > 0.0) {
        return above;
    }
    return below < 0.0 ? below : 0.0;
}

#endif
