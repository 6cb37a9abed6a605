// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_WRENCH_H
#define FRI_CLIENT_WRENCH_H

#include "ring.h"

#include <atomic>
#include <string>
#include <thread>

/*
 * Compute the wrench (force, moment) [N, N m] at the tip in base axes from joint torques: the damped least-squares
 * solution of J^T wrench = torque, (J J^T + damping^2 I)^-1 J torque. J (6 x 7) is the hybrid Jacobian. damping is in
 * the Jacobian's units (m and rad, mixed); it removes a share damping^2 / (s^2 + damping^2) of the component of the
 * singular value s, and bounds the wrench near singular postures. Return false, and zeros, if the inverse does not
 * exist.
 */
bool wrench_from_torque(const double *jacobian, const double *torque, double damping, double *wrench);

/* Interface of a force/torque sensor at the tip. */
class WrenchSensor {
public:
    virtual ~WrenchSensor() {}

    /*
     * Read the newest wrench (force, moment) [N, N m] that the ENVIRONMENT APPLIES TO THE ROBOT, about the tip's origin
     * in tip axes, without the tool's weight. Return false if none has come since the last call. Called once per cycle
     * from the FRI thread: it must not wait, lock or allocate.
     */
    virtual bool read(double wrench[6]) = 0;
};

/*
 * Example sensor: datagrams of six little-endian doubles, as WrenchSensor::read gives them, on a UDP port of the
 * loopback interface. A thread receives; a ring hands over.
 */
class UdpWrenchSensor : public WrenchSensor {
public:
    /* Throws std::runtime_error if the port cannot be opened. */
    explicit UdpWrenchSensor(int port);
    virtual ~UdpWrenchSensor();
    virtual bool read(double wrench[6]);

private:
    struct Sample {
        double wrench[6];
    };

    UdpWrenchSensor(const UdpWrenchSensor &);
    UdpWrenchSensor &operator=(const UdpWrenchSensor &);
    void receive();

    int socket_;
    std::atomic<bool> stop_;
    Ring<Sample, 256> ring_;
    std::thread thread_;
};

/* Source of the controller's wrench: the external joint torque, or a sensor. */
class WrenchSource {
public:
    /* sensor: may be NULL; damping: of wrench_from_torque; sign: of the external torque. */
    WrenchSource(WrenchSensor *sensor, double damping, double sign);

    bool uses_external_torque() const { return sensor_ == NULL; }

    /* Take the sensor's newest wrench; call once per message with the seconds since the last one. */
    void observe(double seconds);

    /* Return whether the sensor has been silent for too long. */
    bool silent() const;

    /* Compute the wrench that the environment applies to the robot at the tip, in base axes; false if there is none. */
    bool read(const double *q, const double *external_torque, double *wrench) const;

private:
    WrenchSensor *const sensor_;
    const double damping_, sign_;
    double told_[6]; /* by the sensor */
    double age_;     /* [s] */
};

#endif
