#ifndef GAINS_H
#define GAINS_H

/* The robot's number of joints and names. The generator writes them, and these files into NAME_gains.c;
 * tests/support/stub_gains has a robot to compile the files by themselves. */
#include "robot.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

/* ---- functions, by file ---- */

#endif
