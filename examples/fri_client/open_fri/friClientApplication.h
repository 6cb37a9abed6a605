/* Part of open_fri, the small open FRI client library of stiffgen's FRI example. */
#ifndef OPEN_FRI_CLIENT_APPLICATION_H
#define OPEN_FRI_CLIENT_APPLICATION_H

#include "friLBRClient.h"
#include "friUdpConnection.h"

namespace open_fri {

/* What went over the wire since the application was made. Not in KUKA's library. */
struct Statistics {
    std::uint64_t messages; /* taken: a callback ran, or the session is idle */
    std::uint64_t answers;  /* sent */
    std::uint64_t timeouts; /* after the first message, receive gave nothing: a timeout or an error */
    std::uint64_t send_failures;
    std::uint64_t lost_messages;       /* gaps in the robot's sequence counter */
    std::uint64_t lost_answers;        /* answers of ours that the robot never reflected, a later one it did */
    std::uint64_t late_answers;        /* messages that did not reflect our last answer */
    std::uint64_t faults[FAULT_COUNT]; /* datagrams not taken, by open_fri::Fault */
};

} // namespace open_fri

namespace KUKA {
namespace FRI {

/*
 * One message in, one callback, one answer out.
 *
 * A datagram that cannot be taken (open_fri::Fault) is counted and skipped: no callback, no answer, and step() is still
 * true, since one bad datagram is no reason to end a session. Nothing is allocated after the constructor.
 */
class ClientApplication {
public:
    ClientApplication(IConnection &connection, IClient &client);

    bool connect(int port, const char *remoteHost = NULL);
    void disconnect();

    /* False: not connected, nothing received (timeout or error), or the answer could not be sent. Call again, or end
     * the session: after a timeout the next message may have any sequence counter. */
    bool step();

    const open_fri::Statistics &statistics() const { return statistics_; }

private:
    ClientApplication(const ClientApplication &);
    ClientApplication &operator=(const ClientApplication &);
    open_fri::Fault order();
    void reflection();
    bool callback(LBRState &state);

    IConnection &connection_;
    IClient &client_;
    open_fri::Statistics statistics_;
    open_fri::Monitoring incoming_;
    std::uint8_t received_[open_fri::DATAGRAM_SIZE], sent_[open_fri::DATAGRAM_SIZE];
    ESessionState state_;
    std::uint32_t sent_count_;   /* the sequence counter of the next answer */
    std::uint32_t since_answer_; /* messages since the last answer */
    std::uint32_t sequence_;     /* of the last message taken */
    bool sequence_known_;
    std::uint32_t reflected_; /* last counter of ours that came back */
    bool reflection_known_;
};

} // namespace FRI
} // namespace KUKA

#endif
