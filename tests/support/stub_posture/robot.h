/* SPDX-License-Identifier: MIT */
/* The golden iiwa14, as far as codegen/stiffgen/control/posture needs it to compile by itself. */
#ifndef ROBOT_H
#define ROBOT_H

#include "iiwa14_find_posture.h"

#define ID(name) IIWA14_##name

enum { N = 7, TIPS = 1 };

void stiffgen_poses(const double *q, const double *tool, double *poses);
void stiffgen_jacobians(const double *q, const double *tool, double *jacobians);

#endif
