// SPDX-License-Identifier: MIT
/* Part of open_fri, the small open FRI client library of stiffgen's FRI example. */
#ifndef OPEN_FRI_CLIENT_APPLICATION_H
#define OPEN_FRI_CLIENT_APPLICATION_H

#include "friLBRClient.h"
#include "friUdpConnection.h"

namespace KUKA {
namespace FRI {

/*
 * One message in, one callback, one answer out. Nothing is allocated after the constructor.
 */
class ClientApplication {
public:
    ClientApplication(IConnection &connection, IClient &client);

    bool connect(int port, const char *remoteHost = NULL);
    void disconnect();

    /* False: not connected, nothing received (timeout or error), no message, or the answer could not be sent. */
    bool step();

private:
    ClientApplication(const ClientApplication &);
    ClientApplication &operator=(const ClientApplication &);
    bool callback(LBRState &state);

    IConnection &connection_;
    IClient &client_;
    open_fri::Monitoring incoming_;
    std::uint8_t received_[open_fri::DATAGRAM_SIZE], sent_[open_fri::DATAGRAM_SIZE];
    ESessionState state_;
    std::uint32_t sent_count_;   /* the sequence counter of the next answer */
    std::uint32_t since_answer_; /* messages since the last answer */
};

} // namespace FRI
} // namespace KUKA

#endif
