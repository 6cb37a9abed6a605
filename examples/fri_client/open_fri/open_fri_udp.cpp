/* UDP sockets. Part of open_fri. */
#include "friUdpConnection.h"

#include <arpa/inet.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstring>

namespace KUKA {
namespace FRI {

UdpConnection::UdpConnection(unsigned int receiveTimeoutMs)
    : socket_(-1), timeout_(receiveTimeoutMs > 0 ? static_cast<int>(receiveTimeoutMs) : -1), connected_(false)
{
    std::memset(&peer_, 0, sizeof peer_);
}

UdpConnection::~UdpConnection()
{
    UdpConnection::close();
}

bool UdpConnection::open(int port, const char *remoteHost)
{
    UdpConnection::close();
    struct sockaddr_in local;
    std::memset(&local, 0, sizeof local);
    local.sin_family = AF_INET;
    local.sin_addr.s_addr = htonl(INADDR_ANY);
    local.sin_port = htons(static_cast<unsigned short>(port));
    peer_ = local;
    connected_ = remoteHost != NULL && remoteHost[0] != '\0';
    if (port < 1 || port > 65535 || (connected_ && inet_pton(AF_INET, remoteHost, &peer_.sin_addr) != 1)) {
        return false;
    }
    socket_ = ::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    if (socket_ < 0) {
        return false;
    }
    if (::bind(socket_, reinterpret_cast<struct sockaddr *>(&local), sizeof local) != 0 ||
        (connected_ && ::connect(socket_, reinterpret_cast<struct sockaddr *>(&peer_), sizeof peer_) != 0)) {
        UdpConnection::close();
        return false;
    }
    return true;
}

void UdpConnection::close()
{
    if (socket_ >= 0) {
        ::close(socket_);
        socket_ = -1;
    }
}

bool UdpConnection::isOpen() const
{
    return socket_ >= 0;
}

int UdpConnection::receive(ReceiveBuffer buffer, BufferSize maxSize)
{
    struct pollfd ready = {socket_, POLLIN, 0};
    if (socket_ < 0 || ::poll(&ready, 1, timeout_) != 1) {
        return -1;
    }
    struct sockaddr_in from;
    socklen_t size = sizeof from;
    /* MSG_TRUNC: the datagram's true size, so that one that was cut can be told. */
    const ssize_t count = ::recvfrom(socket_, buffer, static_cast<size_t>(maxSize), MSG_TRUNC,
                                     reinterpret_cast<struct sockaddr *>(&from), &size);
    if (count >= 0 && !connected_) {
        peer_ = from;
    }
    return static_cast<int>(count);
}

bool UdpConnection::send(SendBuffer buffer, BufferSize size)
{
    if (socket_ < 0) {
        return false;
    }
    const size_t length = static_cast<size_t>(size);
    const ssize_t count =
        connected_ ? ::send(socket_, buffer, length, 0)
                   : ::sendto(socket_, buffer, length, 0, reinterpret_cast<struct sockaddr *>(&peer_), sizeof peer_);
    return count == static_cast<ssize_t>(length);
}

} // namespace FRI
} // namespace KUKA
