#ifndef FOLLOW_H
#define FOLLOW_H

#include "../shared/shared.h"
/* Sizes, structs and kernels of a robot, which the generator writes: the stub in tests/support/stub_follow. */
#include "robot.h"

enum { ROWS = 6 * TIPS, WIDE = (int)N > ROWS, /* of J, as its sides */
       SHORT = WIDE ? ROWS : (int)N, LONG = WIDE ? (int)N : ROWS };
enum { READY = 0x51f0110, LONGEST = 1000000 }; /* mark of init; calls at which a counter stands still */

/* Data of one call. Twists, of all tips and linear first in hybrid axes, and J have rotations multiplied by RADIAN. */
typedef struct {
    const double *tool;     /* poses of tools, or NULL */
    double rest[ROWS];      /* [m] twists from here to the goal */
    double J[ROWS * N];     /* Jacobian of the twists */
    double low[N], high[N]; /* [rad/s] velocities that each joint may have */
} step_t;

/* ---- functions, by file ---- */
void weighed_twists(const double *from, const double *to, double *twists);
void weighed_jacobian(const double *q, const double *tool, double *J);
void multiply(const double *J, const double *velocity, double *twists);
int is_rotation(int row);
double full_speed(const config_t *c, int row);
double over_full_speed(const config_t *c, const double *twists);
void solve_bounded(const double *J, const double *twists, const double *low, const double *high, double *velocity);
void keep_margin(state_t *s, const step_t *k, double *velocity);
int start(const config_t *c, state_t *s, const double *q);
int follow(state_t *s, const input_t *input, output_t *out);

#endif
