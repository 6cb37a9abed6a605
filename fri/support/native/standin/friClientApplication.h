/* SPDX-License-Identifier: MIT */
/* A library in the place of KUKA's, for tests: README.md. */
#ifndef FRI_STANDIN_CLIENT_APPLICATION_H
#define FRI_STANDIN_CLIENT_APPLICATION_H

namespace KUKA {
namespace FRI {

class IClient;
class IConnection;
struct ClientData;

class ClientApplication {
public:
    ClientApplication(IConnection &connection, IClient &client);
    bool connect(int port, const char *remoteHost = 0);
    void disconnect();
    bool step();

private:
    IConnection &connection_;
    IClient &client_;
    ClientData *data_;
};

} // namespace FRI
} // namespace KUKA

#endif
