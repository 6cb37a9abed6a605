/* SPDX-License-Identifier: MIT */
/* The golden iiwa14, as far as codegen/stiffgen/control/paper needs it to compile by itself. */
#ifndef ROBOT_H
#define ROBOT_H

#include "iiwa14_paper.h"

#define CALL(name) iiwa14_##name

enum { N = 7 };

#endif
