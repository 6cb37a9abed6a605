/* SPDX-License-Identifier: MIT */
/* The golden iiwa14, as far as codegen/stiffgen/control/settle needs it to compile by itself. */
#ifndef ROBOT_H
#define ROBOT_H

#include "iiwa14_settle.h"

#include <stddef.h>

#define ID(name) IIWA14_##name

enum { N = 7, TRANSLATION_TURNS = 0, ROTATION_TURNS = 1 };

typedef iiwa14_settle_config config_t;
typedef iiwa14_settle_state state_t;
typedef iiwa14_settle_input input_t;
typedef iiwa14_settle_output output_t;
typedef iiwa14_impedance_config controller_t;
typedef iiwa14_impedance_output last_t;

void stiffgen_poses(const double *q, const double *tool, double *poses);
void stiffgen_jacobians(const double *q, const double *tool, double *jacobians);
void stiffgen_mass_matrix(const double *q, double *mass_matrix);
const double *stiffgen_tool(const controller_t *controller);

#endif
