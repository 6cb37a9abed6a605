// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_EVENTS_H
#define FRI_CLIENT_EVENTS_H

#include <cstdint>

/* What may happen in a session: bits of the log's column `events`, of what happened since the row before. */
enum Event {
    EVENT_LOST_CYCLES = 1 << 0,
    EVENT_MISSING_FIELD = 1 << 1,
    EVENT_BAD_TIMESTAMP = 1 << 2,
    EVENT_QUALITY_DROP = 1 << 3,
    EVENT_BAD_DATAGRAM = 1 << 4,
    EVENT_NO_TORQUE_MODE = 1 << 5,
    EVENT_GUARD = 1 << 6,
    EVENT_SENSOR_SILENT = 1 << 7,
    EVENT_HOLD = 1 << 8,
    EVENT_DONE = 1 << 9,
    EVENT_EXCEPTION = 1 << 10,
    EVENT_IMPLAUSIBLE = 1 << 11,
    EVENT_NO_TIME = 1 << 12,
    EVENT_SLOWED = 1 << 13,
    EVENT_PERIOD = 1 << 14,
    EVENT_STOPPED = 1 << 15,
    EVENT_CONTROLLER_FAULT = 1 << 16,
    EVENT_LET_GO = 1 << 17,
    EVENT_OTHER_VERSION = 1 << 18,
    EVENT_WRENCH_REFUSED = 1 << 19
};

/* What it is called, what it is, and what the client did: the line on the terminal, and the table in docs/fri.md. */
struct EventText {
    std::uint32_t bit;
    const char *name, *what, *done;
};

const EventText EVENT_TEXTS[] = {
    {EVENT_LOST_CYCLES, "lost cycles", "the robot's counter shows messages that never came, or came too late",
     "missed samples: the torque is held, three are a fault of the controller"},
    {EVENT_MISSING_FIELD, "missing field", "the message lacked a value that is needed", "a missed sample"},
    {EVENT_BAD_TIMESTAMP, "bad time stamp", "the robot's clock was left out, or set",
     "the counter of the messages tells the time"},
    {EVENT_QUALITY_DROP, "quality drop", "the robot's rating of the connection got worse", "nothing"},
    {EVENT_BAD_DATAGRAM, "bad datagram", "something arrived that was no message, or one out of order", "not answered"},
    {EVENT_NO_TORQUE_MODE, "not in torque mode", "commanding, but not in torque mode", "nothing was sent"},
    {EVENT_GUARD, "torque cut", "the torque sent is not the controller's: a limit, a release, or a dry run",
     "cut to the limits"},
    {EVENT_SENSOR_SILENT, "sensor silent", "no fresh wrench from the sensor", "a missed sample"},
    {EVENT_HOLD, "held", "the button is pressed", "the trajectory stands still"},
    {EVENT_DONE, "trajectory done", "its end is reached", "the end is held"},
    {EVENT_EXCEPTION, "exception", "the FRI library refused a call", "nothing was sent"},
    {EVENT_IMPLAUSIBLE, "implausible position", "a position far beyond the joint limits", "a missed sample"},
    {EVENT_NO_TIME, "no time passed", "the robot's clock does not follow the counter of its messages",
     "a missed sample"},
    {EVENT_SLOWED, "slowed", "tip's distance, governor's lag, stored energy or contact force near its limit",
     "the trajectory is slowed down, at the limit it stands still"},
    {EVENT_PERIOD, "send period", "the robot reports another send period", "the old one is kept; for long: let go"},
    {EVENT_STOPPED, "robot stopped", "safety stop, drives off, or another operation mode", "let go"},
    {EVENT_CONTROLLER_FAULT, "controller fault", "the controller latched a fault",
     "spring released, damping; reset if messages were lost, else: let go"},
    {EVENT_LET_GO, "let go", "the client gives up, see the last line",
     "torque to zero within 0.25 s, still answering"},
    {EVENT_OTHER_VERSION, "other version", "the messages have not the fields of this FRI version",
     "nothing: build the client for the robot's version"},
    {EVENT_WRENCH_REFUSED, "wrench refused", "the wrench is beyond what the controller takes (500 N, 100 N m)",
     "it counts as a contact force at its limit"},
};

#endif
