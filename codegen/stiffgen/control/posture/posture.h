#ifndef POSTURE_H
#define POSTURE_H

#include <stdint.h>

#include "../shared/shared.h"
/* Sizes and kernels of a robot, which the generator writes: the stub in tests/support/stub_posture. */
#include "robot.h"

enum { ROWS = 6 * TIPS }; /* of the Jacobians of all tips: three of a tip's translation before three of its rotation */

/* ---- functions, by file ---- */
int search(const double *poses, const double *tool, const double *start, const double *low, const double *high,
           double *posture);

#endif
