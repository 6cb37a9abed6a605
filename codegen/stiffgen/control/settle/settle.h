#ifndef SETTLE_H
#define SETTLE_H

#include "../shared/shared.h"
/* Sizes, structs and kernels of a robot, which the generator writes: the stub in tests/support/stub_settle. */
#include "robot.h"

enum { READY = 0x5e771e }; /* mark of init */
enum { TRANSLATION, ROTATION }; /* kinds of errors and springs, in the order of arrays [m], [rad] */

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
