// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_SOCKET_H
#define FRI_CLIENT_SOCKET_H

#include <netinet/in.h>

#include <cstddef>
#include <cstdint>

/* Source and sink of datagrams. */
class Datagrams {
public:
    virtual ~Datagrams() {}
    virtual bool open(int port, const char *host) = 0;
    virtual void close() = 0;
    virtual bool is_open() const = 0;

    /*
     * Receive a datagram; return its size, which is larger than `capacity` if it was cut, -1 if none came in `wait`
     * seconds, or SIGNALLED if a signal came first. `age`: [s] since the kernel received it.
     */
    enum { SIGNALLED = -2 };
    virtual int receive(std::uint8_t *bytes, std::size_t capacity, double wait, double *age) = 0;

    /* Return whether the last datagram came from the peer; true while there is none. */
    virtual bool from_peer() const { return true; }

    /* Make the sender of the last datagram the peer that gets the answers. */
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

    /* Return false if the host is no numeric IPv4 address ("": none) or the port is taken. */
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
    struct sockaddr_in peer_, from_; /* receiver of answers; last sender; port 0: none */
};

#endif
