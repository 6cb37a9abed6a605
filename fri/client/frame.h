// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_FRAME_H
#define FRI_CLIENT_FRAME_H

#include <cstddef>
#include <cstdint>

enum { DATAGRAM_SIZE = 1500 };

/* Name of the button at the media flange, as the robot application registers it. */
extern const char *const BUTTON;

/* Reasons to refuse a datagram. */
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
    FAULT_SENDER,       /* sound, but from another address or port than the session's */
    FAULT_COUNT
};

/* Return the word for a fault, as in "checksum". */
const char *fault_name(int fault);

/* Facts about a monitoring message that the FRI library does not tell. */
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
 * Check a datagram against a table of the protocol's fields: frame, wire format, required fields, counts and ranges.
 * Read no byte beyond size. The FRI library's decoder must see checked datagrams alone: KUKA's trusts the lengths in
 * them, keeps values of earlier messages, and shifts joint values that are not seven. Return FAULT_NONE, or the
 * reason.
 */
Fault check_datagram(const std::uint8_t *datagram, std::size_t size, Message *message);

/* Read the counter of an answer; false if the datagram is none. */
bool answer_counter(const std::uint8_t *datagram, std::size_t size, std::uint32_t *sequence);

/*
 * Return whether a refused datagram is a monitoring message of the other framing: 2.7 has a frame, 1.x and 2.5 do
 * not.
 */
bool other_framing(const std::uint8_t *datagram, std::size_t size);

#endif
