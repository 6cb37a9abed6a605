// SPDX-License-Identifier: MIT
#include "wrench.h"

#include "filters.h"
#include "robot.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>
#include <cstring>
#include <stdexcept>

bool wrench_from_torque(const double *jacobian, const double *torque, double damping, double *wrench)
{
    /* Cholesky factor L of J J^T + damping^2 I, then two triangular solves. */
    double L[6][6], y[6];
    for (int i = 0; i < 6; ++i) {
        wrench[i] = 0.0;
    }
    for (int i = 0; i < 6; ++i) {
        for (int j = 0; j <= i; ++j) {
            double sum = i == j ? damping * damping : 0.0;
            for (int k = 0; k < JOINTS; ++k) {
                sum += jacobian[i * JOINTS + k] * jacobian[j * JOINTS + k];
            }
            for (int k = 0; k < j; ++k) {
                sum -= L[i][k] * L[j][k];
            }
            if (i == j && !(sum > 0.0)) {
                return false;
            }
            L[i][j] = i == j ? std::sqrt(sum) : sum / L[j][j];
        }
    }
    for (int i = 0; i < 6; ++i) {
        double sum = 0.0;
        for (int k = 0; k < JOINTS; ++k) {
            sum += jacobian[i * JOINTS + k] * torque[k];
        }
        for (int k = 0; k < i; ++k) {
            sum -= L[i][k] * y[k];
        }
        y[i] = sum / L[i][i];
    }
    for (int i = 5; i >= 0; --i) {
        double sum = y[i];
        for (int k = i + 1; k < 6; ++k) {
            sum -= L[k][i] * wrench[k];
        }
        wrench[i] = sum / L[i][i];
    }
    return true;
}

UdpWrenchSensor::UdpWrenchSensor(int port) : socket_(::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0)), stop_(false)
{
    struct sockaddr_in local;
    std::memset(&local, 0, sizeof local);
    local.sin_family = AF_INET;
    local.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    local.sin_port = htons(static_cast<std::uint16_t>(port));
    if (socket_ < 0 || ::bind(socket_, reinterpret_cast<struct sockaddr *>(&local), sizeof local) != 0) {
        const std::string reason = std::strerror(errno);
        if (socket_ >= 0) {
            ::close(socket_);
        }
        throw std::runtime_error("sensor port " + std::to_string(port) + ": " + reason + "; choose --sensor-port");
    }
    thread_ = std::thread(&UdpWrenchSensor::receive, this);
}

UdpWrenchSensor::~UdpWrenchSensor()
{
    stop_ = true;
    thread_.join();
    ::close(socket_);
}

void UdpWrenchSensor::receive()
{
    while (!stop_) {
        struct pollfd ready = {socket_, POLLIN, 0};
        unsigned char bytes[64];
        if (::poll(&ready, 1, 100) != 1 || ::recv(socket_, bytes, sizeof bytes, MSG_TRUNC) != 48) {
            continue;
        }
        Sample sample;
        for (int i = 0; i < 6; ++i) {
            std::uint64_t bits = 0;
            for (int k = 7; k >= 0; --k) {
                bits = bits << 8 | bytes[8 * i + k];
            }
            std::memcpy(&sample.wrench[i], &bits, sizeof bits);
        }
        if (all_finite(sample.wrench, 6)) {
            ring_.push(sample);
        }
    }
}

bool UdpWrenchSensor::read(double wrench[6])
{
    Sample sample;
    bool any = false;
    while (ring_.pop(&sample)) {
        any = true;
    }
    if (any) {
        std::memcpy(wrench, sample.wrench, sizeof sample.wrench);
    }
    return any;
}

namespace {

/* [s] A sensor that has been silent for so long has failed. */
const double SENSOR_PATIENCE = 0.05;

} // namespace

WrenchSource::WrenchSource(WrenchSensor *sensor, double damping, double sign)
    : sensor_(sensor), damping_(damping), sign_(sign), age_(1e9)
{
    std::memset(told_, 0, sizeof told_);
}

void WrenchSource::observe(double seconds)
{
    if (sensor_ != NULL) {
        age_ = sensor_->read(told_) ? 0.0 : age_ + seconds;
    }
}

bool WrenchSource::silent() const
{
    return sensor_ != NULL && age_ > SENSOR_PATIENCE;
}

bool WrenchSource::read(const double *q, const double *external_torque, double *wrench) const
{
    if (sensor_ == NULL) {
        double J[6 * JOINTS], torque[JOINTS];
        robot::jacobian(q, J);
        for (int i = 0; i < JOINTS; ++i) {
            torque[i] = sign_ * external_torque[i];
        }
        return wrench_from_torque(J, torque, damping_, wrench);
    }
    double pose[16];
    robot::pose(q, pose);
    for (int k = 0; k < 2; ++k) {
        for (int i = 0; i < 3; ++i) {
            wrench[3 * k + i] = pose[4 * i] * told_[3 * k] + pose[4 * i + 1] * told_[3 * k + 1] +
                                pose[4 * i + 2] * told_[3 * k + 2];
        }
    }
    return !silent();
}
