// SPDX-License-Identifier: MIT
#ifndef FRI_ATTACK_SCHEDULE_H
#define FRI_ATTACK_SCHEDULE_H

/* Schedules of the attack, and its virtual clock. */
#include "session.h"

#include "checksum.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <deque>
#include <functional>
#include <iostream>
#include <map>
#include <memory>
#include <random>
#include <sstream>
#include <stdexcept>

namespace {

std::int64_t now_ns = 0; /* [ns] of the virtual clock, both monotonic and real */
volatile std::sig_atomic_t interrupts = 0;

double seconds()
{
    return 1e-9 * static_cast<double>(now_ns);
}

const std::int64_t EPOCH = 1700000000000000000; /* [ns] Unix time at which it starts */

enum { IDLE, MONITORING_WAIT, MONITORING_READY, COMMANDING_WAIT, COMMANDING_ACTIVE };

/* Kinds of events. The comment has the meaning of the value. */
const char *const KINDS[] = {
    /* network */
    "drop",     /* share of the robot's messages lost */
    "deaf",     /* share of the client's answers lost */
    "delay",    /* [s] at most, of each message another one */
    "burst",    /* messages wait until the end, then come in their order */
    "twice",    /* share of messages that come twice */
    "replay",   /* messages so many before come again */
    "garbage",  /* share of messages that are random bytes */
    "cut",      /* share of the bytes that is left */
    /* what the robot says */
    "state", "quality", "safety", "drives", "operation", "mode", "period", "multiplier", /* this value */
    "clock",    /* [s] its clock is off */
    "jitter",   /* share of a period that it is off, to and fro */
    "coarse",   /* [s] its resolution */
    "frozen",   /* it stands still */
    "counter",  /* the sequence counter is off by so many */
    "counting", /* it grows by so many a message */
    "stuck",    /* it stands still */
    "without",  /* parts left out: 1 position, 2 external torque, 4 interpolator, 8 robot's states, 16 time, 32 measurement */
    "nan",      /* position of this joint */
    "offset",   /* [rad] of the position of joint 0 to 6, by the START's microseconds */
    "noise",    /* [rad] of the positions */
    "gain",     /* of the external torque */
    "still",    /* the positions of these joints stand still; a sum of 2^joint, as with the next two */
    "toggling", /* so do these, but for one bit of the mantissa: 100 times the joints, plus the bit */
    "late",     /* these joints' are old: 10000 times the joints, plus the number of messages */
    "hum",      /* [N m] noise of the external torque */
    "misled",   /* the robot's external torque believes positions that stand still: 1, it is the torque sent; 2, what the
                 * joint's torque sensor shows */
    "bias",     /* the external torque's offset, to both sides in turn, as a share of the client's effort limits */
    "motor",    /* [kg m^2] inertia of the motors */
    "quantum",  /* [rad] resolution of the positions */
    "button",   /* pressed */
    /* what happens to the arm */
    "held",     /* it does not move */
    "blocked",  /* this joint does not move */
    "push",     /* [N m] on joint 0 to 6, by the START's microseconds */
    "sticky",   /* dry friction, as a share of the client's effort limits; half as much again at rest */
    "silence",  /* the robot does nothing */
    "slow",     /* its periods take so many times as long */
    "patient",  /* it never breaks a motion off for missing answers, and holds the last torque */
    /* this machine, and the person */
    "stop",     /* the client stands still, for LENGTH, before it receives (0) or in its callback (1) */
    "interrupt", /* Ctrl-C; so many times */
    "answer",   /* to the question: 1 yes, 0 no */
    "settle",   /* [N] --settle, all the time; a tenth of it in N m */
    /* --press, and what it meets */
    "press",    /* [N] it, all the time, with a sensor */
    "wall",     /* stands so far [m] before the tip's start along its z axis, or at the tip, if that is beyond it */
    "numb",     /* the sensor's reading stands still */
    "mute",     /* the sensor sends no readings */
    "weak",     /* share of the truth that the sensor says */
};
enum { KIND_COUNT = sizeof KINDS / sizeof *KINDS };

struct Event {
    double start, length, value;
    bool done;
};

struct Schedule {
    unsigned seed;
    std::map<std::string, std::vector<Event>> events;

    explicit Schedule(const std::string &line) : seed(0)
    {
        std::istringstream stream(line);
        std::string kind;
        stream >> seed;
        while (stream >> kind) {
            Event event = {0.0, 0.0, 0.0, false};
            const bool known = std::any_of(KINDS, KINDS + KIND_COUNT, [&](const char *name) { return kind == name; });
            if (!(stream >> event.start >> event.length >> event.value) || !known) {
                throw std::runtime_error("schedule: " + kind);
            }
            events[kind].push_back(event);
        }
    }

    const Event *at(const char *kind, double time) const
    {
        const auto found = events.find(kind);
        if (found == events.end()) {
            return NULL;
        }
        for (const Event &event : found->second) {
            if (time >= event.start && time < event.start + event.length) {
                return &event;
            }
        }
        return NULL;
    }

    double value(const char *kind, double time, double otherwise) const
    {
        const Event *const event = at(kind, time);
        return event != NULL ? event->value : otherwise;
    }

    /* Value of the first event of a kind, whenever it is. */
    double first(const char *kind, double otherwise) const
    {
        const auto found = events.find(kind);
        return found != events.end() ? found->second.front().value : otherwise;
    }

    /* An event that begins now, once. */
    Event *due(const char *kind, double time)
    {
        const auto found = events.find(kind);
        if (found == events.end()) {
            return NULL;
        }
        for (Event &event : found->second) {
            if (!event.done && time >= event.start) {
                event.done = true;
                return &event;
            }
        }
        return NULL;
    }
};

/* A joint by an event's start: the time's microseconds, modulo 7. */
int joint_of(const Event &event)
{
    return static_cast<int>(std::llround(event.start * 1e6) % JOINTS);
}

} // namespace

#endif
