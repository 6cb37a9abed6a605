#ifndef POSTURE_H
#define POSTURE_H

/* The robot's sizes and kernels. The generator writes them, and these files with all functions static, into
 * NAME_find_posture.c; tests/support/stub_posture has a robot to compile the files by themselves. */
#include "../shared/shared.h"
#include "robot.h"

#include <float.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

enum { ROWS = 6 * TIPS };                  /* of the Jacobians of all tips */

/* ---- functions, by file ---- */
int search(const double *poses, const double *tool, const double *start, const double *low, const double *high,
           double *posture);

#endif
