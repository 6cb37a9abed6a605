#ifndef PRESS_H
#define PRESS_H

/* The robot's sizes, structs and kernels. The generator writes them, and these files with all functions static, into
 * NAME_press.c; tests/support/stub_press has a robot to compile the files by themselves. */
#include "../shared/shared.h"
#include "robot.h"

#include <float.h>
#include <math.h>
#include <string.h>

enum { READY = 0x94e55 }; /* mark of init */

/* What the arm is along the axis: gain of the integral [1/s], stiffness of the springs [N/m]. */
typedef struct {
    double gain, stiffness;
} tuning_t;

/* ---- functions, by file ---- */

int start(const config_t *c, const controller_t *controller, state_t *s);
int press(state_t *s, const input_t *in, const last_t *last, output_t *out);

#endif
