#ifndef POSTURE_H
#define POSTURE_H

/* The robot's sizes and kernels. The generator writes them, and these files with all functions static, into
 * NAME_find_posture.c; tests/support/stub_posture has a robot to compile the files by themselves. */
#include "robot.h"

#include <float.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

enum { ROWS = 6 * TIPS };                  /* of the Jacobians of all tips */
static const double FARTHEST = 1e6;        /* [m] or [rad] beyond which a number is a mistake */
static const double HALF_TURN = 3.14159265358979324;

/* ---- functions, by file ---- */

double dot(int n, const double *a, const double *b);
double norm(int n, const double *a);
int all_within(const double *x, int count, double least, double most);
int clean_pose(const double *pose, double *clean);
void compare_poses(const double *from, const double *to, double *twists);

int search(const double *poses, const double *tool, const double *start, const double *low, const double *high,
           double *posture);

#endif
