#ifndef FRI_CLIENT_TRAFFIC_H
#define FRI_CLIENT_TRAFFIC_H

#include "timing.h"

#include <cstring> /* before KUKA's headers, which do not include it */

#include <friClientApplication.h>
#include <friUdpConnection.h>

/* The UDP connection, watched: what came, and how long the answers took. */
class Traffic : public KUKA::FRI::UdpConnection {
public:
#if FRI_VERSION >= 207
    typedef char *const Buffer;
    typedef const char *const Bytes;
    typedef unsigned int Size;
#else
    typedef char *Buffer;
    typedef const char *Bytes;
    typedef int Size;
#endif

    explicit Traffic(unsigned int timeout_ms)
        : KUKA::FRI::UdpConnection(timeout_ms), last_size_(-1), received_(0), unreadable_(0), arrival_(0.0)
    {
    }

    int receive(Buffer buffer, Size size) override
    {
        last_size_ = KUKA::FRI::UdpConnection::receive(buffer, size);
        arrival_ = monotonic_time();
        received_ += last_size_ >= 0 ? 1 : 0;
        return last_size_;
    }

    bool send(Bytes bytes, Size size) override
    {
        const bool sent = KUKA::FRI::UdpConnection::send(bytes, size);
        answers_.add(monotonic_time() - arrival_);
        return sent;
    }

    /* After a step of the application: one that failed although something had come means a bad datagram. */
    void note_step(bool stepped) { unreadable_ += !stepped && last_size_ >= 0 ? 1 : 0; }

    int last_size() const { return last_size_; } /* -1: timeout or error */
    unsigned long long received() const { return received_; }
    unsigned long long unreadable() const { return unreadable_; }
    const Durations &answers() const { return answers_; } /* [s] from a datagram's receipt to the end of its answer */

private:
    int last_size_;
    unsigned long long received_, unreadable_;
    double arrival_;
    Durations answers_;
};

/* Datagrams that were no message in order: known exactly with open_fri, else by the steps that failed. */
inline unsigned long long bad_datagrams(const KUKA::FRI::ClientApplication &application, const Traffic &traffic)
{
#ifdef OPEN_FRI
    unsigned long long sum = 0;
    for (const std::uint64_t count : application.statistics().faults) {
        sum += count;
    }
    (void)traffic;
    return sum;
#else
    (void)application;
    return traffic.unreadable();
#endif
}

#endif
