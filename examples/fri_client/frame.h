// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_FRAME_H
#define FRI_CLIENT_FRAME_H

#include <cstddef>
#include <cstdint>

enum { DATAGRAM_SIZE = 1500 };

/* Name of the button at the media flange, as the robot application registers it. */
extern const char *const BUTTON;

/* Why a datagram is not handed to the FRI library. */
enum Fault {
    FAULT_NONE,
    FAULT_EMPTY,        /* a datagram without bytes */
    FAULT_TOO_LONG,     /* longer than DATAGRAM_SIZE */
    FAULT_FRAME,        /* 2.7: the length in front is not that of the datagram */
    FAULT_CHECKSUM,     /* 2.7 */
    FAULT_DECODE,       /* no such message, a required field missing, an array or a string too long */
    FAULT_IDENTIFIER,   /* a message of another kind */
    FAULT_JOINT_COUNT,  /* an array of joint values, or the drives, without exactly seven */
    FAULT_RANGE,        /* an enumeration has a value that it does not know */
    FAULT_INCOMPLETE,   /* cut at the border of a field, or a part left out: connection, measurement, interpolator */
    FAULT_DUPLICATE,    /* the same sequence counter as the last message */
    FAULT_OUT_OF_ORDER, /* an older sequence counter */
    FAULT_SENDER,       /* sound, but not from where the session's messages come from */
    FAULT_COUNT
};

/* A word for a fault, "checksum". */
const char *fault_name(int fault);

/* What the client wants to know of a monitoring message and the FRI library does not tell. */
struct Message {
    std::uint32_t sequence, reflected; /* the robot's counter; ours that it saw last */
    std::uint32_t state, multiplier;                 /* every so many messages are answered */
    std::int64_t stamp;                              /* [ns] Unix time of the robot; 0: left out */
    bool has_position, has_external_torque, has_ipo; /* measured; interpolator's position */
    bool has_commanded_position;                     /* 1.x alone sends it */
    bool has_robot;                                  /* safety state, drives and operation mode, all three */
    bool has_measurement, has_connection, has_interpolator;
    bool has_button;
};

/*
 * Looks through a datagram, by a table of the protocol's fields, before the FRI library's decoder sees it: that one
 * trusts the lengths in it, keeps values of earlier messages, and shifts joint values where there are not seven. Checks
 * frame, wire format, required fields, counts and ranges; reads no byte beyond size. FAULT_NONE, or why not.
 */
Fault check_datagram(const std::uint8_t *datagram, std::size_t size, Message *message);

/* The counter in an answer as it is sent; false if it is none. */
bool answer_counter(const std::uint8_t *datagram, std::size_t size, std::uint32_t *sequence);

/* Whether a datagram that was refused would be a monitoring message of the other framing: 2.7 has one, 1.x and 2.5 do
 * not. */
bool other_framing(const std::uint8_t *datagram, std::size_t size);

#endif
