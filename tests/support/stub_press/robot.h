/* SPDX-License-Identifier: MIT */
/* The golden iiwa14, as far as codegen/stiffgen/control/press needs it to compile by itself. */
#ifndef ROBOT_H
#define ROBOT_H

#include "iiwa14_press.h"
#include "iiwa14_settle.h"

#include <stddef.h>

#define ID(name) IIWA14_##name
#define CALL(name) iiwa14_##name

enum { N = 7 };

typedef iiwa14_press_config config_t;
typedef iiwa14_press_state state_t;
typedef iiwa14_press_input input_t;
typedef iiwa14_press_output output_t;
typedef iiwa14_impedance_config controller_t;
typedef iiwa14_impedance_output last_t;

void stiffgen_pose(const controller_t *controller, const double *q, double *pose);

#endif
