// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_SOCKET_H
#define FRI_CLIENT_SOCKET_H

#include <netinet/in.h>

#include <cstddef>
#include <cstdint>

/* Where datagrams come from and go to. */
class Datagrams {
public:
    virtual ~Datagrams() {}
    virtual bool open(int port, const char *host) = 0;
    virtual void close() = 0;
    virtual bool is_open() const = 0;

    /*
     * The next datagram: its size, which is larger than `capacity` if it was cut; -1 if none came in `wait` seconds (0:
     * none is there), SIGNALLED if a signal came first. `age` [s]: since the kernel received it.
     */
    enum { SIGNALLED = -2 };
    virtual int receive(std::uint8_t *bytes, std::size_t capacity, double wait, double *age) = 0;

    /* Whether the last datagram came from where answers go to; true while they go nowhere yet. */
    virtual bool from_peer() const { return true; }

    /* From now on answers go to where the last datagram came from. */
    virtual void adopt_peer() {}

    virtual bool send(const std::uint8_t *bytes, std::size_t size) = 0;
};

/*
 * UDP over IPv4 with the kernel's receive time stamps. Listens on a port of all interfaces; the robot sends first.
 *
 * With a host, only datagrams from that address and the same port number arrive.
 */
class UdpSocket : public Datagrams {
public:
    UdpSocket();
    virtual ~UdpSocket();

    /* False if the host is no numeric IPv4 address ("" is as none) or the port is taken. */
    virtual bool open(int port, const char *host);
    virtual void close();
    virtual bool is_open() const { return socket_ >= 0; }
    virtual int receive(std::uint8_t *bytes, std::size_t capacity, double wait, double *age);
    virtual bool from_peer() const;
    virtual void adopt_peer() { peer_ = from_; }
    virtual bool send(const std::uint8_t *bytes, std::size_t size);

private:
    UdpSocket(const UdpSocket &);
    UdpSocket &operator=(const UdpSocket &);

    int socket_;
    bool connected_;
    struct sockaddr_in peer_, from_; /* where answers go; where the last datagram came from; no port: nobody yet */
};

#endif
