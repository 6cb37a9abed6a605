#ifndef SETTLE_H
#define SETTLE_H

/* The robot's sizes, structs and kernels. The generator writes them, and these files with all functions static, into
 * NAME_settle.c; tests/support/stub_settle has a robot to compile the files by themselves. */
#include "../shared/shared.h"
#include "robot.h"

#include <float.h>
#include <math.h>
#include <string.h>

enum { READY = 0x5e771e }; /* mark of init */

/* Error of one kind, translation or rotation, and what the springs make of it. */
typedef struct {
    double size;      /* [m] or [rad] */
    double axis[3];   /* unit vector along the error, in base axes */
    double stiffness; /* along it, in force [N/m] or [N m/rad] */
} error_t;

/* ---- functions, by file ---- */

/* decay.c */
double square_in(const double *K, int turns, const double *pose, const double *v);
double find_decay(const controller_t *c, const double *q, const double *Kt, const double *Ko, const double *wrench,
                  double *stiffness);

/* settle.c */
int start(const config_t *c, const controller_t *controller, state_t *s);
int settle(state_t *s, const input_t *in, const last_t *last, output_t *out);

#endif
