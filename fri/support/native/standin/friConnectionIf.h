/* SPDX-License-Identifier: MIT */
/* A library in the place of KUKA's, for tests: README.md. */
#ifndef FRI_STANDIN_CONNECTION_IF_H
#define FRI_STANDIN_CONNECTION_IF_H

namespace KUKA {
namespace FRI {

class IConnection {
public:
    virtual ~IConnection() {}
    virtual bool open(int port, const char *remoteHost) = 0;
    virtual void close() = 0;
    virtual bool isOpen() const = 0;
#if STANDIN_VERSION >= 207
    virtual int receive(char *const buffer, const unsigned int maxSize) = 0;
    virtual bool send(const char *const buffer, unsigned int size) = 0;
#else
    virtual int receive(char *buffer, int maxSize) = 0;
    virtual bool send(const char *buffer, int size) = 0;
#endif
};

} // namespace FRI
} // namespace KUKA

#endif
