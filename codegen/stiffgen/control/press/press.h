#ifndef PRESS_H
#define PRESS_H

#include "../shared/shared.h"
/* Sizes, structs and kernels of a robot, which the generator writes: the stub in tests/support/stub_press. */
#include "robot.h"

enum { READY = 0x94e55 }; /* mark of init */

/* What is known of a step along the axis, which points from the tip into the surface. */
typedef struct {
    double here[16];  /* measured pose of the tip */
    double measured;  /* [N] force that the tip exerts, by the sensor */
    double gain;      /* [1/s] of the integral */
    double stiffness; /* [N/m] of the springs */
} step_t;

/* ---- functions, by file ---- */

int start(const config_t *c, const controller_t *controller, state_t *s);
int press(state_t *s, const input_t *in, const last_t *last, output_t *out);

#endif
