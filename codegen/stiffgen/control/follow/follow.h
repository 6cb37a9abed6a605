#ifndef FOLLOW_H
#define FOLLOW_H

/* The robot's sizes, structs and kernels. The generator writes them, and these files with all functions static, into
 * NAME_follow.c; tests/support/stub_follow has a robot to compile the files by themselves. */
#include "robot.h"

#include <float.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

enum { ROWS = 6 * TIPS, WIDE = (int)N > 6 * TIPS, SHORT = WIDE ? 6 * TIPS : (int)N }; /* of the Jacobians of all tips */
enum { READY = 0x51f0110, LONGEST = 1000000 }; /* mark of init; calls at which a counter stands still */

/* [m] that counts as much as one radian. Twists, of all tips and linear first in hybrid axes, have their rotations
 * multiplied by it here, and so has the Jacobian J. */
static const double RADIAN = 0.2;
static const double FARTHEST = 1e6; /* [m] or [rad] beyond which a number is a mistake */

/* What one call works with. */
typedef struct {
    const double *tool;     /* poses of tools, or NULL */
    double rest[ROWS];      /* [m] twists from here to the goal */
    double J[ROWS * N];     /* Jacobian of the twists */
    double low[N], high[N]; /* [rad/s] velocities that each joint may have */
} step_t;

/* ---- functions, by file ---- */

double dot(int n, const double *a, const double *b);
double norm(int n, const double *a);
double clamp(double x, double least, double most);
int all_within(const double *x, int count, double least, double most);
int clean_pose(const double *pose, double *clean);
void compare_poses(const double *from, const double *to, double *twists);
double way_of(const config_t *c, const double *twists);

void weighed_jacobian(const double *q, const double *tool, double *J);

void factorise(int n, const double *A, double *L);
void solve(int n, const double *L, double *x);
void multiply(const double *J, const double *velocity, double *twists);
void solve_bounded(const double *J, const double *twists, const double *low, const double *high, double *velocity);

void keep_margin(state_t *s, const step_t *k, double *velocity);

int start(const config_t *c, state_t *s, const double *q);
int follow(state_t *s, const input_t *input, output_t *out);

#endif
