/* SPDX-License-Identifier: MIT */
/* The golden iiwa14, as far as codegen/stiffgen/control/follow needs it to compile by itself. */
#ifndef ROBOT_H
#define ROBOT_H

#include "iiwa14_follow.h"

#include <stddef.h>

#define ID(name) IIWA14_##name

enum { N = 7, TIPS = 1 };

typedef iiwa14_follow_config config_t;
typedef iiwa14_follow_state state_t;
typedef iiwa14_follow_input input_t;
typedef iiwa14_follow_output output_t;

void stiffgen_poses(const double *q, const double *tool, double *poses);
void stiffgen_jacobians(const double *q, const double *tool, double *jacobians);
const double *stiffgen_tool(const input_t *input);
double *stiffgen_kept_tool(state_t *state);

#endif
