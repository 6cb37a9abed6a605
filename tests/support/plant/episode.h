/* SPDX-License-Identifier: MIT */
/*
 * Closed loop of plant, sensors and controller at the sample time, described by segments. Every claim about a controller
 * is measured here, from the plant's exact state and the torque that really acted.
 */
#ifndef EPISODE_H
#define EPISODE_H

#include "law.h"

enum { STUCK_HELD = 1, STUCK_ZERO = 2 };
enum { RESTART_OFF = 1, RESTART_IN_FORCE = 2 }; /* no torque acts before it; the last one does */
enum { DRIVEN_RATE = 1, DRIVEN_POSTURE = 2, DRIVEN_ALONG = 3 }; /* at rates, to a posture, at rates along the torque */

/* Values from `start` until the next segment. */
typedef struct {
    int start;                   /* [samples] */
    int config;                  /* which configuration */
    int skip;                    /* number of calls omitted after each call; the last torque stays */
    int missed;                  /* 1: called without a sample */
    int reset;                   /* 1: faults are acknowledged at the segment's first sample */
    int restart;                 /* RESTART_, at the segment's first sample */
    int late_torque;             /* [samples] of delay from a restart on, besides the episode's */
    int measure_wrench;          /* 1: the true wrench is measured; 0: zero is given */
    int clamp;                   /* 1: the tip is clamped where it was when this began */
    int frozen_counter;          /* 1: the sample counter stands still */
    int q_stuck, dq_stuck;       /* STUCK_, of the joints in the masks */
    int q_mask, dq_mask;         /* bits of joints */
    double wanted[N];            /* [rad] posture whose tip pose is the equilibrium */
    int shaped;                  /* 1: said to be a point of a motion that has ramps */
    int driven;                  /* the environment moves the arm whatever it does, DRIVEN_ */
    double driven_to[N];         /* [rad/s] these rates (along the torque: their size), or [rad] this posture */
    double driven_at[N];         /* [rad/s] at most at these rates, if to a posture */
    double driven_by[N];         /* [rad/s^2] at most at these accelerations */
    double joint;                /* [N m/rad] posture stiffness */
    double wanted_rate[N];       /* [rad/s] moves `wanted` from the segment's start on */
    double jitter;               /* [rad] added to every joint of `wanted` with alternating sign */
    double translation[9 * SPRINGS], rotation[9 * SPRINGS];
    double load[6], push[N];     /* the load at the first tip */
    double wrench_command[6 * TWISTS]; /* [N, N m] */
    double tool[4 * TIPS];       /* [m], [rad] tools of robots that take them: position in the tip, turn about its x axis */
    double torque_offset[N];     /* [N m] torque that the caller adds: its work is not the law's */
    double acceleration[N];      /* [rad/s^2] of the plan, as stated */
    double hand_target[N], hand_stiffness, hand_damping;
    double wrench_bias[6];       /* [N, N m] added to what is measured */
    double q_offset[N], dq_offset[N]; /* added to the measurement; NaN for a NaN */
} segment_t;

typedef struct {
    plant_t plant;
    double sample_time;
    int delay;                   /* [samples] from a sample to when its torque acts */
    int differences;             /* [samples] over which the velocity is a difference of measured positions, at most 16; 0: true */
    double quantum;              /* [rad] of the encoder; 0: exact */
    double q[N], v[N];           /* at the start */
    double velocity_limit[N];    /* [rad/s] what speeds are compared with */
    double effort[N], rate[N];   /* [N m], [N m/s] that the torque must keep */
    double engagement;           /* [J] that each return from a fault may bring in */
    int streamed;                /* seed of a hostile commander (policy_law.c); its path is unknown: travel is the time */
    int limited;                 /* 1: speeds of a driven arm are relative to the velocity limits in force, and calls come as
                                    often as the gap in force says */
    double early;                /* [1] share of the sample time by which a call may come too early */
    int wrapped;                 /* bits of joints whose encoder begins its turn again at half a turn; their q0, too */
    int single;                  /* 1: velocities, commands and stiffness have single precision */
    int single_positions;        /* 1: measured positions have single precision; what they are off by is `allowance` */
    double late;                 /* [1] chance that a call is late by a sample time, until call_gap in force is used up */
    double stale;                /* [1] chance that a call has the sample of the call before it, with its counter */
    uint32_t first_counter;      /* of the samples; it may wrap */
    double fastest;              /* [1] over the velocity limit: the episode ends when the arm is faster; 0: never */
} episode_t;

typedef struct {
    double speed;                /* [1] largest |v| over the velocity limit */
    double excursion;            /* [rad] largest |q - wanted| */
    double wander;               /* [rad] largest |q - start| */
    double error;                /* [rad] |q - wanted| at the end */
    double final_speed;          /* [rad/s] largest |v| during the last tenth */
    double ripple;               /* [rad] largest range of a joint during the last tenth */
    double torque;               /* [N m] largest */
    double torque_step;          /* [1] largest change relative to the rate limit */
    double effort;               /* [1] largest torque over the effort limit */
    double port;                 /* [J] put out at the robot's port since the law began: sum of torque . change of q */
    double port_most;            /* [J] most of it at any time */
    double excess;               /* [J] most of port - engagement x resets at any time */
    double excess_supplied;      /* [J] most of port - allowance - what the law has supplied, from the first sample on */
    double allowance;            /* [J] that measured positions in single precision may be off by in the account */
    double travel;               /* [s] of the governor, at its default velocity limits, for the path of `wanted` */
    double excess_travel;        /* [J] most of port - engagement x (resets + travel, at most the time) at any time */
    double first_energy;         /* [J] of springs and limit avoidance there, by the law's account */
    double kinetic;              /* [J] at the end */
    double energy_error;         /* [J] of the integration: change of kinetic energy less all work */
    double reference_speed;      /* [1] largest change of the equilibrium in use, over the velocity limit */
    double tip_reference_speed;  /* [m/s] of its tip */
    double tip_speed;            /* [m/s] of the tip */
    double fell;                 /* [J] elastic energy when the last fault began */
    int faults;                  /* times that control was lost */
    int faulted;                 /* samples without control */
    int reason, fault_at;        /* of the first fault; the sample */
    int resets;                  /* times that control came back */
    int finite;                  /* every torque was */
    int codes;                   /* steps that returned an error */
    int restarts, lates, stales; /* restarts, late calls and old samples */
    int finished;                /* samples done; fewer if the state became non-finite */
    uint32_t status_or, status_last;
    double q[N], v[N], reference[N], acted[N];
    double wrench[6];            /* at the tip, at the end */
    double moment_most, force_most;
} summary_t;

typedef struct {
    double q[N], v[N], acted[N], reference[N], wrench[6];
    double port, energy, tank, deficit, scale, kinetic;
    uint32_t status;
    int faulted;
} row_t;

/*
 * Run. configs: pointers to configurations; state: law_state_size() bytes; output: law_output_size() bytes, or count of them
 * with every_output; rows: NULL or one per sample. Returns what initialising returned.
 */
int episode_run(const episode_t *episode, int samples, int segments, const segment_t *segment,
                const void *const *configs, void *state, void *output, int every_output, row_t *rows,
                summary_t *summary);

#endif
