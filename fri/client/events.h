// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_EVENTS_H
#define FRI_CLIENT_EVENTS_H

#include <cstdint>

/* Events of a session: bits of the log's column `events`, for the time since the row before. */
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
    EVENT_CONTACT_LOST = 1 << 19,
    EVENT_SENSOR_DOUBTED = 1 << 20
};

/* Name and meaning of an event, and the client's action: printed on the terminal. */
struct EventText {
    std::uint32_t bit;
    const char *name, *what, *done;
};

const EventText EVENT_TEXTS[] = {
    {EVENT_LOST_CYCLES, "lost cycles", "messages of the robot never came, or came too late",
     "the robot holds its torque; nine in a row are a fault of the controller"},
    {EVENT_MISSING_FIELD, "missing field", "the message lacks a value that is needed",
     "a missed sample"},
    {EVENT_BAD_TIMESTAMP, "bad time stamp", "the robot's clock was left out, or set",
     "the messages' counter tells the time; if it goes on, lets go"},
    {EVENT_QUALITY_DROP, "quality drop", "the robot rates the connection worse than before",
     "nothing"},
    {EVENT_BAD_DATAGRAM, "bad datagram", "a datagram is no message, or is out of order",
     "does not answer it"},
    {EVENT_NO_TORQUE_MODE, "not in torque mode", "the robot is commanding, but not in torque mode",
     "sends no command"},
    {EVENT_GUARD, "torque cut", "the torque sent is not the controller's: a limit, a release, or a dry run",
     "cuts it to the limits"},
    {EVENT_SENSOR_SILENT, "sensor silent", "the sensor has sent no wrench for 50 ms",
     "a missed sample; if it goes on, lets go"},
    {EVENT_HOLD, "held", "the button is pressed",
     "holds the trajectory"},
    {EVENT_DONE, "trajectory done", "the trajectory's end is reached",
     "holds the end"},
    {EVENT_EXCEPTION, "exception", "the FRI library refused a call",
     "sends no command"},
    {EVENT_IMPLAUSIBLE, "implausible position", "a position is far beyond a joint's limits",
     "a missed sample; if it goes on, lets go"},
    {EVENT_NO_TIME, "no time passed", "the robot's clock does not follow the messages' counter",
     "a missed sample; if it goes on, lets go"},
    {EVENT_SLOWED, "slowed",
     "the tip's distance, the reference's lag, the energy or the contact force is near its limit",
     "slows the trajectory down; at the limit it stands still"},
    {EVENT_PERIOD, "send period", "the robot reports another send period",
     "keeps the old one; if it goes on, lets go"},
    {EVENT_STOPPED, "robot stopped", "the robot reports a safety stop, inactive drives, or another operation mode",
     "lets go"},
    {EVENT_CONTROLLER_FAULT, "controller fault", "the controller latched a fault",
     "releases the springs; resets the fault if messages were lost, else lets go"},
    {EVENT_LET_GO, "let go", "the client gives up; the last line says why",
     "brings the torque to zero within 0.25 s, still answering"},
    {EVENT_OTHER_VERSION, "other version", "the messages lack the fields of this FRI version",
     "nothing: build the client for the robot's version"},
    {EVENT_CONTACT_LOST, "contact lost", "the tip presses on nothing any more, or has found nothing",
     "presses no more; the pose goes back"},
    {EVENT_SENSOR_DOUBTED, "sensor doubted",
     "the springs press much harder than the sensor says, or it says always the same",
     "presses no more; the pose goes back"},
};

#endif
