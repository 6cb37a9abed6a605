/* SPDX-License-Identifier: MIT */
/* A controller as the episodes see it: one file per control law implements these functions on its own structs. */
#ifndef LAW_H
#define LAW_H

#include "plant.h"

#include <stddef.h>
#include <stdint.h>

/* Values of the sensors and the planner at a sample. */
typedef struct {
    int valid;                 /* 0: the sample was missed */
    uint32_t counter;          /* of the samples */
    int reset;                 /* acknowledge faults */
    double q[N], dq[N];        /* [rad], [rad/s] measured */
    double wanted[N];          /* [rad] q0 */
    double wanted_rate[N];     /* [rad/s] */
    int shaped;                /* 1: q0 is a point of a motion that has ramps already, as stated */
    double acceleration[N];    /* [rad/s^2] of the plan, as stated */
    double joint;              /* [N m/rad] posture stiffness */
    double wrench_command[6 * TWISTS]; /* [N, N m] wrench that the tip is to exert, base axes */
    double tool[16 * TIPS];    /* [m] poses of the tools in the tips, for robots that take them */
    double torque_offset[N];   /* [N m] torque that the caller adds */
    double wrench[6 * TIPS];   /* [N, N m] measured wrench of the environment on the robot, base axes */
    double translation[9 * SPRINGS]; /* [N/m] base axes */
    double rotation[9 * SPRINGS]; /* [N m/rad] axes of the tip at the equilibrium */
} sample_t;

/* Values of a step that the episodes read, for every law. */
typedef struct {
    double torque[N];          /* [N m] commanded, held; motors with gains: tau_ff */
    double offset[N];          /* [N m] the caller's part of it */
    double kp[N], kd[N];       /* [N m/rad], [N m s/rad] gains of the motors' own loops */
    double q_des[N];           /* [rad] position where kp is at rest */
    double reference[N];       /* [rad] equilibrium posture in use */
    double equilibrium[16 * TIPS]; /* [m] pose in use */
    double translation[9 * SPRINGS], rotation[9 * SPRINGS]; /* [N/m], [N m/rad] in use */
    double joint[N];           /* [N m/rad] posture stiffness */
    double scale;              /* [1] of the elastic energy: below 1 while it is released */
    double energy;             /* [J] elastic and of the limits, by the law's account */
    double tank, deficit;      /* [J] */
    double supplied;           /* [J] that can have left the port so far, by the law's account */
    double velocity_limit[N];  /* [rad/s] in force; 0: the law has none */
    int call_gap;              /* [samples] in force; 0: the law has none */
    uint32_t status;
    int faulted;               /* not under control: fallback or latched */
    int reason;                /* for that, the law's own number */
    int code;                  /* what the step returned */
} command_t;

size_t law_config_size(void);
size_t law_state_size(void);
size_t law_output_size(void);
void law_default_config(void *config);
/* torque: in force; tool: poses of tools, for robots that take them */
int law_init(const void *config, void *state, const double *torque, const double *tool);
/* output: the law's whole own output struct */
void law_step(void *state, const sample_t *sample, void *output, command_t *command);

#endif
