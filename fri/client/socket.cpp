// SPDX-License-Identifier: MIT
#include "socket.h"

#include <arpa/inet.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <ctime>

namespace {

/* [s] since a time stamp of the kernel's. */
double since(const struct timespec &then)
{
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    return static_cast<double>(now.tv_sec - then.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec - then.tv_nsec);
}

/* Return a port of this computer, at all of its addresses. */
struct sockaddr_in any_address(int port)
{
    struct sockaddr_in address;
    std::memset(&address, 0, sizeof address);
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_ANY);
    address.sin_port = htons(static_cast<unsigned short>(port));
    return address;
}

/* Return how long ago [s] the kernel received a datagram, by the time stamp that came with it; 0 without one. */
double age_of(struct msghdr &message)
{
    double age = 0.0;
    for (struct cmsghdr *item = CMSG_FIRSTHDR(&message); item != NULL; item = CMSG_NXTHDR(&message, item)) {
        if (item->cmsg_level == SOL_SOCKET && item->cmsg_type == SCM_TIMESTAMPNS) {
            struct timespec then;
            std::memcpy(&then, CMSG_DATA(item), sizeof then);
            age = std::max(0.0, since(then));
        }
    }
    return age;
}

} // namespace

UdpSocket::UdpSocket() : socket_(-1), connected_(false)
{
    std::memset(&peer_, 0, sizeof peer_);
    std::memset(&from_, 0, sizeof from_);
}

UdpSocket::~UdpSocket()
{
    UdpSocket::close();
}

/* Bind the port, to any sender or to one host alone; every datagram gets a time stamp. False if it cannot. */
bool UdpSocket::open(int port, const char *host)
{
    UdpSocket::close();
    struct sockaddr_in local = any_address(port), remote = local; /* the robot sends from the same port */
    std::memset(&peer_, 0, sizeof peer_);
    std::memset(&from_, 0, sizeof from_);
    connected_ = host != NULL && host[0] != '\0';
    if (port < 1 || port > 65535 || (connected_ && inet_pton(AF_INET, host, &remote.sin_addr) != 1)) {
        return false;
    }
    socket_ = ::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    if (socket_ < 0) {
        return false;
    }
    if (connected_) {
        peer_ = remote;
    }
    const int on = 1;
    if (::setsockopt(socket_, SOL_SOCKET, SO_TIMESTAMPNS, &on, sizeof on) != 0 ||
        ::bind(socket_, reinterpret_cast<struct sockaddr *>(&local), sizeof local) != 0 ||
        (connected_ && ::connect(socket_, reinterpret_cast<struct sockaddr *>(&remote), sizeof remote) != 0)) {
        UdpSocket::close();
        return false;
    }
    return true;
}

void UdpSocket::close()
{
    if (socket_ >= 0) {
        ::close(socket_);
        socket_ = -1;
    }
}

/* Wait [s] for a datagram; return its size, -1 for none, SIGNALLED after a signal. age: how long ago it came [s]. */
int UdpSocket::receive(std::uint8_t *bytes, std::size_t capacity, double wait, double *age)
{
    if (socket_ < 0) {
        return -1;
    }
    if (wait > 0.0) {
        struct pollfd ready = {socket_, POLLIN, 0};
        const int count = ::poll(&ready, 1, static_cast<int>(std::ceil(1e3 * std::min(wait, 1e6))));
        if (count != 1) {
            return count < 0 && errno == EINTR ? static_cast<int>(SIGNALLED) : -1;
        }
    }
    union {
        struct cmsghdr aligned;
        char bytes[CMSG_SPACE(sizeof(struct timespec))];
    } control;
    struct iovec part = {bytes, capacity};
    struct msghdr message;
    std::memset(&message, 0, sizeof message);
    message.msg_name = &from_;
    message.msg_namelen = sizeof from_;
    message.msg_iov = &part;
    message.msg_iovlen = 1;
    message.msg_control = control.bytes;
    message.msg_controllen = sizeof control.bytes;
    /* MSG_TRUNC: the datagram's true size, so that one that was cut can be told. */
    const ssize_t count = ::recvmsg(socket_, &message, MSG_TRUNC | MSG_DONTWAIT);
    if (count < 0) {
        return -1;
    }
    *age = age_of(message);
    return static_cast<int>(count);
}

/* Return whether the last datagram came from the session's robot, or there is none yet. */
bool UdpSocket::from_peer() const
{
    return connected_ || peer_.sin_port == 0 ||
           (from_.sin_addr.s_addr == peer_.sin_addr.s_addr && from_.sin_port == peer_.sin_port);
}

/* Send to the peer; false if the datagram did not leave whole. */
bool UdpSocket::send(const std::uint8_t *bytes, std::size_t size)
{
    if (socket_ < 0) {
        return false;
    }
    const ssize_t count =
        connected_ ? ::send(socket_, bytes, size, 0)
                   : ::sendto(socket_, bytes, size, 0, reinterpret_cast<struct sockaddr *>(&peer_), sizeof peer_);
    return count == static_cast<ssize_t>(size);
}
