// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_RECORD_H
#define FRI_CLIENT_RECORD_H

#include "filters.h"
#include "ring.h"

#include <cstdint>

/* One record from the FRI thread to the log: a controller step, a change of session state, or events without a step. */
struct Record {
    enum Kind { STEP, STATE, NOTE };

    Kind kind;
    double time;  /* [s] of the robot's clock since the first message */
    int from, to; /* session states */

    int start; /* 1: the controller was initialised just before this step */
    int reset; /* 1: a latched fault was reset just before this step */
    int sample_valid;
    std::uint32_t counter;
    double q[JOINTS], dq[JOINTS], q0[JOINTS], wrench[6]; /* inputs of the step; wrench at the tip */
    double wrench_command[6];                            /* the same: of Press, [N, N m] */
    double torque[JOINTS];                               /* output of the step */
    std::uint32_t status;
    int mode;
    double tank_energy, elastic_energy;

    double sent_torque[JOINTS], sent_position[JOINTS];
    double measured_torque[JOINTS], external_torque[JOINTS];
    double reading[6]; /* of the sensor; NaN without one */
    int quality;
    double tracking;
    double pace;          /* rate of the trajectory's time, 0 to 1 */
    double callback_time; /* [s] of the callback before this one */
    std::uint32_t events; /* events.h */
};

typedef Ring<Record, 4096> Records;

#endif
