/* Part of open_fri, the small open FRI client library of stiffgen's FRI example. */
#ifndef OPEN_FRI_UDP_CONNECTION_H
#define OPEN_FRI_UDP_CONNECTION_H

#include <cstddef>
#include <netinet/in.h>

#ifndef FRI_VERSION
#error "define FRI_VERSION as 115, 205 or 207 (CMake: -DOPEN_FRI_VERSION=1.15, 2.5 or 2.7)"
#endif

namespace KUKA {
namespace FRI {

/* The types that receive and send have in the different versions of the interface. */
#if FRI_VERSION >= 207
typedef char *const ReceiveBuffer;
typedef const char *const SendBuffer;
typedef unsigned int BufferSize;
#else
typedef char *ReceiveBuffer;
typedef const char *SendBuffer;
typedef int BufferSize;
#endif

/* Where datagrams come from and go to. One's own makes a session without sockets. */
class IConnection {
public:
    virtual ~IConnection() {}
    virtual bool open(int port, const char *remoteHost) = 0;
    virtual void close() = 0;
    virtual bool isOpen() const = 0;

    /* Waits for one datagram. Returns its size, which is larger than maxSize if it was cut; -1 after a timeout or an
     * error. */
    virtual int receive(ReceiveBuffer buffer, BufferSize maxSize) = 0;

    virtual bool send(SendBuffer buffer, BufferSize size) = 0;
};

/*
 * UDP over IPv4. Listens on a port of all interfaces; the robot sends first.
 *
 * Without a host, answers go to where the last datagram came from. With one, only datagrams from that address and the
 * same port number are taken.
 */
class UdpConnection : public IConnection {
public:
    /* Timeout of receive in ms; 0 waits for ever. */
    explicit UdpConnection(unsigned int receiveTimeoutMs = 0);
    virtual ~UdpConnection();

    /* False if the host is no numeric IPv4 address ("" is as none) or the port is taken. */
    virtual bool open(int port, const char *remoteHost = NULL);
    virtual void close();
    virtual bool isOpen() const;
    virtual int receive(ReceiveBuffer buffer, BufferSize maxSize);
    virtual bool send(SendBuffer buffer, BufferSize size);

private:
    UdpConnection(const UdpConnection &);
    UdpConnection &operator=(const UdpConnection &);

    int socket_;
    int timeout_;
    bool connected_;
    struct sockaddr_in peer_;
};

} // namespace FRI
} // namespace KUKA

#endif
