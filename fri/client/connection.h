// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_CONNECTION_H
#define FRI_CLIENT_CONNECTION_H

#include "frame.h"
#include "socket.h"
#include "timing.h"

#include <cstring> /* before KUKA's headers, which do not include it */

#include <friUdpConnection.h>

/* Counters of the wire. */
struct Traffic {
    unsigned long long received;            /* datagrams */
    unsigned long long faults[FAULT_COUNT]; /* refused datagrams, by reason */
    unsigned long long other_framing;       /* refused messages of a version with another framing */
    unsigned long long messages;            /* handed to the FRI library */
    unsigned long long overtaken;           /* sound messages not answered, because a newer one was there */
    unsigned long long timeouts;            /* silences after the first message */
    unsigned long long lost_messages;       /* gaps in the robot's counter */
    unsigned long long lost_answers;        /* answers that the robot skipped: it reflected a later one */
    unsigned long long unseen_answers;      /* messages that do not reflect our last answer yet */
    unsigned long long send_failures;
    unsigned long long other_version; /* messages with the fields of another version of the same framing */

    unsigned long long refused() const;
};

/* Facts about the message that the FRI library is processing. */
struct Arrival {
    Message message;
    std::uint32_t advance; /* steps of the robot's counter since the last message; 0: the counter restarted */
    bool refused;          /* a datagram was refused since the last message */
    bool other_version;    /* its fields are not those of this FRI version */
    double age;            /* [s] from the kernel's receipt to the FRI library */
};

/*
 * Connection for the FRI library. It hands on sound messages alone, in order, and of several waiting ones the newest
 * (with a receive multiplier above 1 all of them). It counts the datagrams that it refuses, and allocates nothing.
 */
class Connection : public KUKA::FRI::IConnection {
public:
#if FRI_VERSION >= 207
    typedef char *const Buffer;
    typedef const char *const SendBytes;
    typedef unsigned int Size;
#else
    typedef char *Buffer;
    typedef const char *SendBytes;
    typedef int Size;
#endif

    /* patience: silence [s] that ends receive. */
    Connection(Datagrams &datagrams, double patience);

    bool open(int port, const char *host) override { return datagrams_.open(port, host); }
    void close() override { datagrams_.close(); }
    bool isOpen() const override { return datagrams_.is_open(); }
    int receive(Buffer buffer, Size size) override;
    bool send(SendBytes bytes, Size size) override;

    /* Set the monotonic time [s] at which receive ends at the latest. */
    void set_deadline(double time) { deadline_ = time; }

    /* Return whether the last receive gave a message. */
    bool handed_on() const { return handed_on_; }

    const Arrival &arrival() const { return arrival_; }
    const Traffic &traffic() const { return traffic_; }
    std::uint32_t sequence() const { return sequence_; } /* counter of the robot's last message */
    /* [s] from the kernel's receipt of a datagram to the end of its answer's sending. */
    const Durations &answers() const { return answers_; }

private:
    int next(double wait, double *age);
    int collect(Buffer buffer, std::size_t capacity, double give_up, std::uint32_t *advance);
    bool take(const std::uint8_t *bytes, int size, Message *message, std::uint32_t *advance);
    Fault follow_counter(const Message &message, std::uint32_t *advance);
    bool counts_anew(std::uint32_t counter);
    void count_answers(const Message &message);
    void note_silence();

    Datagrams &datagrams_;
    const double patience_;
    double deadline_;
    std::uint8_t scratch_[DATAGRAM_SIZE];
    Arrival arrival_;
    Traffic traffic_;
    Durations answers_;
    bool handed_on_, signalled_; /* the last receive gave a message; a signal ended its wait */
    double handing_time_; /* [s] monotonic */
    std::uint32_t sequence_;
    bool sequence_known_;
    std::uint32_t elsewhere_; /* last counter far from the session's */
    int in_a_row_;            /* messages with such a counter */
    std::uint32_t last_answer_, reflected_;
    bool answered_, reflection_known_;
};

#endif
