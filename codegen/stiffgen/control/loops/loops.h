/*
 * ---- closed loops: the controller's q are the motors' positions, from which the other joints follow ----
 *
 * The joints are found by Newton's method from those of the last sample (m->arm.joints), on whose branch they stay.
 * Along the arm's motion they are a smooth function of the motors' positions, and so is the energy of the springs.
 */
#ifndef LOOPS_H
#define LOOPS_H

/* The robot's memory, its joints and the functions of its tree. The generator writes them, and these files with all
 * functions static, into the NAME_impedance.c of robots with closed loops; tests/support/stub_loops has a robot to
 * compile the files by themselves. */
#include "robot.h"

#include <float.h>
#include <math.h>
#include <string.h>

enum { RETRACTIONS = 20, FIRST_PARTS = 16 };
static const double SAME_BRANCH = 1e-6; /* [rad] or [m] up to which joints are the same */

/* ---- functions, by file ---- */

extern const double loop_start[JOINTS];
extern const int loop_motors[N];

void stiffgen_tree_poses(const double *q, const memory_t *m, double *pose);
void stiffgen_tree_jacobians(const double *q, const memory_t *m, double *jacobian);
double stiffgen_tree_spring_energy(const double *q, const memory_t *m, const double *equilibrium,
    const double *translation_stiffness, const double *rotation_stiffness);
double stiffgen_tree_spring(const double *q, const memory_t *m, const double *equilibrium,
    const double *translation_stiffness, const double *rotation_stiffness, double *torque, double *joint_stiffness);
void stiffgen_tree_spring_wrench(const double *q, const memory_t *m, const double *equilibrium,
    const double *translation_stiffness, const double *rotation_stiffness, double *wrench);

#endif
