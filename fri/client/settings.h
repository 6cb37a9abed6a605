// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_SETTINGS_H
#define FRI_CLIENT_SETTINGS_H

#include "calibration.h"
#include "pace.h"

/* Settings from the command line. */
struct Settings {
    double task_stiffness[6];    /* [N/m, N m/rad] diagonal, hybrid frame */
    bool paper;                  /* law of the paper instead of the exact spring, for comparison */
    bool conventional;           /* law of the paper without the correction */
    double damping_ratio;        /* [1] for every mode */
    double posture_stiffness;    /* [N m/rad] */
    double motor_inertia;        /* [kg m^2] */
    double friction[7];          /* [N m] coulomb_friction of each joint, fed forward; 0: none */
    double settle_force[2];      /* [N, N m] most that Settle lets the springs exert more; 0, 0: none */
    double press_force;          /* [N] that Press holds along the tool's z axis; 0: none */
    double effort_share;         /* share of the robot's effort limits */
    double torque_rise;          /* [s] least time from zero torque to the effort limit */
    double speed_share;          /* share of the velocity limits at which the client lets go */
    double sample_time;          /* [s] expected send period; 0: any */
    double approach_time;        /* [s] least duration of the move to the trajectory */
    double approach_limit;       /* [rad] longest way of a joint without a question */
    bool approach_anyway;        /* a long way needs no question */
    bool may_ask;                /* a person is at the terminal */
    double velocity_span;        /* [s] over which positions are differenced */
    int delay_samples;           /* from a message to the one from which its torque acts */
    double position_quantum;     /* [rad] resolution of the measured positions; 0: finer than 1e-6 */
    double wrench_damping;       /* damping of the least squares from the external torque */
    double external_torque_sign; /* 1: the external torque is J^T times the wrench that the environment applies; -1 */
    Calibration calibration;     /* of the sensor */
    PaceLimits pace;
    bool dry_run;        /* send zero torque */
    bool simulated_time; /* the robot's time is not this machine's: lockstep */

    Settings();
};

#endif
