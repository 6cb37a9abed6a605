#ifndef FOLLOW_H
#define FOLLOW_H

/* The robot's sizes, structs and kernels. The generator writes them, and these files with all functions static, into
 * NAME_follow.c; tests/support/stub_follow has a robot to compile the files by themselves. */
#include "../shared/shared.h"
#include "robot.h"

#include <float.h>
#include <math.h>
#include <string.h>

enum { ROWS = 6 * TIPS, WIDE = (int)N > ROWS, SHORT = WIDE ? ROWS : (int)N, LONG = WIDE ? (int)N : ROWS };
enum { READY = 0x51f0110, LONGEST = 1000000 }; /* mark of init; calls at which a counter stands still */

/* Data of one call. Twists, of all tips and linear first in hybrid axes, and J have rotations multiplied by RADIAN. */
typedef struct {
    const double *tool;     /* poses of tools, or NULL */
    double rest[ROWS];      /* [m] twists from here to the goal */
    double J[ROWS * N];     /* Jacobian of the twists */
    double low[N], high[N]; /* [rad/s] velocities that each joint may have */
} step_t;

/* ---- functions, by file ---- */

void compare_poses(const double *from, const double *to, double *twists);
void weighed_jacobian(const double *q, const double *tool, double *J);
void multiply(const double *J, const double *velocity, double *twists);
double full_speed(const config_t *c, int r);
double way_of(const config_t *c, const double *twists);
void solve_bounded(const double *J, const double *twists, const double *low, const double *high, double *velocity);
void keep_margin(state_t *s, const step_t *k, double *velocity);
double stopping_speed(double way, double slope, double T);
int start(const config_t *c, state_t *s, const double *q);
int follow(state_t *s, const input_t *input, output_t *out);

#endif
