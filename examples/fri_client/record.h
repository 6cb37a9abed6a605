#ifndef FRI_CLIENT_RECORD_H
#define FRI_CLIENT_RECORD_H

#include "filters.h"
#include "ring.h"

#include <cstdint>

/* Bits of the log's column `events`: what happened since the row before. docs/fri.md describes them. */
enum Event {
    EVENT_LOST_CYCLES = 1 << 0,   /* the robot's clock advanced by more than one period */
    EVENT_MISSING_FIELD = 1 << 1, /* the message lacked a value that is needed; the cycle counts as missed */
    EVENT_BAD_TIMESTAMP = 1
        << 2, /* the robot's clock was left out, not ahead, or far off; a message that is not new counts as missed */
    EVENT_QUALITY_DROP = 1 << 3,   /* the robot's rating of the connection got worse */
    EVENT_BAD_DATAGRAM = 1 << 4,   /* something arrived that was no message, or one out of order */
    EVENT_NO_TORQUE_MODE = 1 << 5, /* commanding, but not in torque mode: nothing was sent */
    EVENT_GUARD = 1 << 6,          /* the torque sent is not the controller's: cut, or a dry run */
    EVENT_SENSOR_SILENT = 1 << 7,  /* no fresh wrench from the sensor; the cycle counts as missed */
    EVENT_HOLD = 1 << 8,           /* the button is pressed: the trajectory stands still */
    EVENT_DONE = 1 << 9,           /* the trajectory's end is reached */
    EVENT_EXCEPTION = 1 << 10,     /* the FRI library refused a call */
    EVENT_IMPLAUSIBLE = 1 << 11    /* a position far beyond the joint limits; the cycle counts as missed */
};

/* One record from the FRI thread to the log: a controller step or a change of session state. */
struct Record {
    enum Kind { STEP, STATE };

    Kind kind;
    double time;  /* [s] of the robot's clock since the first message */
    int from, to; /* session states */

    int start; /* 1: the controller was initialised just before this step */
    int sample_valid;
    double q[JOINTS], dq[JOINTS], q0[JOINTS], dq0[JOINTS], wrench[6]; /* into the step */
    double torque[JOINTS];                                            /* out of it */
    std::uint32_t status;
    int mode;
    double antisymmetric, tank_energy, elastic_energy;

    double sent_torque[JOINTS], sent_position[JOINTS];
    double measured_torque[JOINTS], external_torque[JOINTS];
    int quality;
    double tracking;
    double callback_time; /* [s] of the callback before this one */
    std::uint32_t events;
};

typedef Ring<Record, 4096> Records;

#endif
