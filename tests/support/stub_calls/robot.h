/* SPDX-License-Identifier: MIT */
/* The golden iiwa14, as far as codegen/stiffgen/core/emit/casadi/library needs it to compile by itself. */
#ifndef ROBOT_H
#define ROBOT_H

#include "iiwa14.h"

#include <stddef.h>

#define CALL(name) iiwa14_##name

enum { MAX_OPERANDS = 9 };

#endif
