// SPDX-License-Identifier: MIT
#include "wrench.h"

#include "filters.h"
#include "robot.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <stdexcept>

namespace {

/* Bytes of a reading, six doubles; [ms] how late the end may be seen. */
enum { READING_BYTES = 6 * 8, END_DELAY = 100 };

double little_endian_double(const unsigned char *bytes)
{
    std::uint64_t bits = 0;
    double number;
    for (int k = 7; k >= 0; --k) {
        bits = bits << 8 | bytes[k];
    }
    std::memcpy(&number, &bits, sizeof number);
    return number;
}

} // namespace

/* Bind the port on this computer, and start the thread that receives. */
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

/* Receive readings until the end: datagrams of six doubles, little-endian, all finite. */
void UdpWrenchSensor::receive()
{
    while (!stop_) {
        struct pollfd ready = {socket_, POLLIN, 0};
        unsigned char bytes[READING_BYTES]; /* of a longer datagram recv returns the whole length */
        if (::poll(&ready, 1, END_DELAY) != 1 || ::recv(socket_, bytes, sizeof bytes, MSG_TRUNC) != READING_BYTES) {
            continue;
        }
        Sample sample;
        for (int i = 0; i < 6; ++i) {
            sample.reading[i] = little_endian_double(bytes + 8 * i);
        }
        if (all_finite(sample.reading, 6)) {
            ring_.push(sample);
        }
    }
}

/* Take the newest reading; false if none came since the last call. */
bool UdpWrenchSensor::read(double reading[6])
{
    Sample sample;
    bool any = false;
    while (ring_.pop(&sample)) {
        any = true;
    }
    if (any) {
        std::memcpy(reading, sample.reading, sizeof sample.reading);
    }
    return any;
}

namespace {

/* [s] A sensor that has been silent for so long has failed. */
const double SENSOR_PATIENCE = 0.05;

/* [s] of the same reading to the last bit, and [rad] that a joint moves meanwhile, after which the sensor is frozen. */
const double FROZEN_TIME = 0.25, FROZEN_MOVE = 1e-4;

} // namespace

WrenchSource::WrenchSource(WrenchSensor *sensor, const Calibration &calibration, double damping, double sign)
    : sensor_(sensor), calibration_(calibration), damping_(damping), sign_(sign), age_(1e9), same_(0.0), moved_(false)
{
    std::fill(reading_, reading_ + 6, std::nan(""));
    std::fill(since_, since_ + 7, 0.0);
}

/* Take a reading, and note for how long it has been the same and whether the arm moved meanwhile. */
void WrenchSource::observe(double seconds, const double *q)
{
    if (sensor_ == NULL) {
        return;
    }
    double before[6];
    copy(reading_, before, 6);
    age_ = sensor_->read(reading_) ? 0.0 : age_ + seconds;
    if (!std::equal(before, before + 6, reading_)) {
        same_ = 0.0;
        return;
    }
    if (same_ <= 0.0) { /* the first repetition: from here on the arm may move */
        copy(q, since_, JOINTS);
        moved_ = false;
    }
    same_ += seconds;
    for (int i = 0; i < JOINTS; ++i) {
        moved_ = moved_ || std::fabs(q[i] - since_[i]) > FROZEN_MOVE;
    }
}

bool WrenchSource::frozen() const
{
    return same_ > FROZEN_TIME && moved_;
}

bool WrenchSource::silent() const
{
    return sensor_ != NULL && age_ > SENSOR_PATIENCE;
}

/* Return the wrench at the tip [N, N m], from sensor or external torques; false if there is none. */
bool WrenchSource::read(const double *q, const double *external_torque, double *wrench) const
{
    if (sensor_ != NULL) {
        robot::tip_wrench(q, reading_, calibration_.bias, calibration_.payload, wrench);
        return !silent();
    }
    double torque[JOINTS];
    for (int i = 0; i < JOINTS; ++i) {
        torque[i] = sign_ * external_torque[i];
    }
    robot::external_wrench(q, torque, damping_, wrench);
    return all_finite(wrench, 6);
}
