// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_WRENCH_H
#define FRI_CLIENT_WRENCH_H

#include "ring.h"

#include <atomic>
#include <string>
#include <thread>

/*
 * Wrench (force, moment) [N, N m] at the tip in base axes from joint torques: the least-squares solution of
 * J^T wrench = torque, damped, (J J^T + damping^2 I)^-1 J torque. J (6 x 7) is the hybrid Jacobian. damping is in the
 * Jacobian's units (m and rad, mixed); it costs a share damping^2 / (s^2 + damping^2) of what belongs to the singular
 * value s, and bounds the wrench near singular postures. False, and zeros, if the inverse does not exist.
 */
bool wrench_from_torque(const double *jacobian, const double *torque, double damping, double *wrench);

/* A force/torque sensor at the tip. Implement it for yours. */
class WrenchSensor {
public:
    virtual ~WrenchSensor() {}

    /*
     * The newest wrench (force, moment) [N, N m] that the ENVIRONMENT APPLIES TO THE ROBOT, about the tip's origin in
     * tip axes, with the tool's own weight taken out. False if there has been none since the last call. Called once a
     * cycle from the FRI thread: it must not wait, lock or allocate.
     */
    virtual bool read(double wrench[6]) = 0;
};

/*
 * Example sensor: datagrams of six little-endian doubles, as WrenchSensor::read gives them, on a UDP port of the
 * loopback interface. A thread receives; a ring hands over.
 */
class UdpWrenchSensor : public WrenchSensor {
public:
    /* Throws std::runtime_error if the port cannot be had. */
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

/* The wrench that the controller is given: from the external joint torque, or from a sensor. */
class WrenchSource {
public:
    /* sensor may be NULL. damping, sign: of wrench_from_torque, and of the external torque. */
    WrenchSource(WrenchSensor *sensor, double damping, double sign);

    bool uses_external_torque() const { return sensor_ == NULL; }

    /* Once a message: periods [s] that have passed with it. */
    void observe(double seconds);

    /* Whether the sensor has been silent for too long. */
    bool silent() const;

    /* The wrench that the environment applies to the robot at the tip, in base axes. False: there is none. */
    bool read(const double *q, const double *external_torque, double *wrench) const;

private:
    WrenchSensor *const sensor_;
    const double damping_, sign_;
    double told_[6]; /* by the sensor */
    double age_;     /* [s] */
};

#endif
