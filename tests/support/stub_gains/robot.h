/* SPDX-License-Identifier: MIT */
/* The golden iiwa14, as far as codegen/stiffgen/control/gains needs it to compile by itself. */
#ifndef ROBOT_H
#define ROBOT_H

#include "iiwa14_gains.h"

#define ID(name) IIWA14_##name

enum { N = 7 };

#endif
