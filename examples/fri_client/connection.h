// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_CONNECTION_H
#define FRI_CLIENT_CONNECTION_H

#include "frame.h"
#include "socket.h"
#include "timing.h"

#include <cstring> /* before KUKA's headers, which do not include it */

#include <friUdpConnection.h>

/* What went over the wire, counted. */
struct Traffic {
    unsigned long long received;            /* datagrams */
    unsigned long long faults[FAULT_COUNT]; /* of them refused, by reason */
    unsigned long long other_framing;       /* of those, messages of a version with another framing */
    unsigned long long messages;            /* handed to the FRI library */
    unsigned long long overtaken;           /* sound, but a newer one was already there: not answered */
    unsigned long long timeouts;            /* after the first message: silences */
    unsigned long long lost_messages;       /* gaps in the robot's counter */
    unsigned long long lost_answers;        /* answers of ours that the robot never reflected, a later one it did */
    unsigned long long unseen_answers;      /* messages that do not reflect our last answer yet */
    unsigned long long send_failures;
    unsigned long long other_version; /* messages with the fields of another version of the same framing */

    unsigned long long refused() const;
};

/* What came with the message that the FRI library has now. */
struct Arrival {
    Message message;
    std::uint32_t advance; /* of the robot's counter since the message before; 0: it counts anew */
    bool refused;          /* something was refused since the message before */
    bool other_version;    /* it has, or has not, what this version of the FRI has not, or always has */
    double age;            /* [s] since the kernel received it, when it was handed on */
};

/*
 * The connection that the FRI library is given. Only sound messages get through, in order, and of several that wait
 * the newest (with a receive multiplier above 1 all of them): whatever is refused is counted, and the library never sees it. Nothing is allocated.
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

    /* A silence of so many seconds ends receive. */
    Connection(Datagrams &datagrams, double patience);

    bool open(int port, const char *host) override { return datagrams_.open(port, host); }
    void close() override { datagrams_.close(); }
    bool isOpen() const override { return datagrams_.is_open(); }
    int receive(Buffer buffer, Size size) override;
    bool send(SendBytes bytes, Size size) override;

    /* From now on receive ends with this monotonic time [s] at the latest. */
    void set_deadline(double time) { deadline_ = time; }

    /* Whether the last receive gave a message. */
    bool handed_on() const { return handed_on_; }

    const Arrival &arrival() const { return arrival_; }
    const Traffic &traffic() const { return traffic_; }
    std::uint32_t sequence() const { return sequence_; } /* the robot's, last taken */
    /* [s] from the kernel's receipt of a datagram to the end of its answer's sending. */
    const Durations &answers() const { return answers_; }

private:
    bool take(const std::uint8_t *bytes, int size, Message *message, std::uint32_t *advance);
    Fault order(const Message &message, std::uint32_t *advance);
    void reflection(const Message &message);

    Datagrams &datagrams_;
    const double patience_;
    double deadline_;
    std::uint8_t scratch_[DATAGRAM_SIZE];
    Arrival arrival_;
    Traffic traffic_;
    Durations answers_;
    bool handed_on_;
    double handing_time_; /* [s] monotonic */
    std::uint32_t sequence_;
    bool sequence_known_;
    std::uint32_t elsewhere_; /* counter of the last message that counts from elsewhere */
    int in_a_row_;            /* such messages */
    std::uint32_t last_answer_, reflected_;
    bool answered_, reflection_known_;
};

#endif
