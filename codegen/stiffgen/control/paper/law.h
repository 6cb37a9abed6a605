#ifndef LAW_H
#define LAW_H

/* The robot's number of joints and its configuration. The generator writes them, and these files with all functions
 * static, into NAME_paper.c; tests/support/stub_paper has a robot to compile the files by themselves. */
#include "robot.h"

#include <math.h>
#include <stdint.h>
#include <string.h>

enum { SWEEPS = 16 }; /* of rotations that diagonalise a matrix */

/* ---- functions, by file ---- */

int all_within(const double *x, int count, double least, double most);
int design_damping(const CALL(paper_config) *c, const double *M, const double *K, double *B);
int is_stiffness(const double *K);

#endif
