// SPDX-License-Identifier: MIT
/* Part of open_fri, the small open FRI client library of stiffgen's FRI example. */
#ifndef OPEN_FRI_UDP_CONNECTION_H
#define OPEN_FRI_UDP_CONNECTION_H

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

/* Source and destination of datagrams; the client has its own (connection.h). */
class IConnection {
public:
    virtual ~IConnection() {}
    virtual bool open(int port, const char *remoteHost) = 0;
    virtual void close() = 0;
    virtual bool isOpen() const = 0;

    /* Waits for one datagram. Returns its size; -1 after a timeout or an error. */
    virtual int receive(ReceiveBuffer buffer, BufferSize maxSize) = 0;

    virtual bool send(SendBuffer buffer, BufferSize size) = 0;
};

} // namespace FRI
} // namespace KUKA

#endif
