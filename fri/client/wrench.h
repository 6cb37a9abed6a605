// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_WRENCH_H
#define FRI_CLIENT_WRENCH_H

#include "calibration.h"
#include "ring.h"

#include <atomic>
#include <cmath>
#include <thread>

/* Return the size of a force or moment. */
inline double size_of(const double *x)
{
    return std::sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]);
}

/* Return whether a wrench is one that an LBR can meet: at most 500 N and 100 N m. */
inline bool is_plausible(const double *wrench)
{
    return size_of(wrench) <= 500.0 && size_of(wrench + 3) <= 100.0;
}

/* Interface of a force/torque sensor; the robot is generated with its place and sign (--sensor). */
class WrenchSensor {
public:
    virtual ~WrenchSensor() {}

    /*
     * Read the newest reading (force, moment) [N, N m], as the sensor reports it: in sensor axes about its origin, with
     * bias and the tool's weight. Return false if none has come since the last call. Called once per cycle from the FRI
     * thread: it must not wait, lock or allocate.
     */
    virtual bool read(double reading[6]) = 0;
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
    virtual bool read(double reading[6]);

private:
    struct Sample {
        double reading[6];
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
    /* sensor: may be NULL; damping: of the least squares (NAME_sensor.h); sign: of the external torque. */
    WrenchSource(WrenchSensor *sensor, const Calibration &calibration, double damping, double sign);

    bool uses_external_torque() const { return sensor_ == NULL; }

    /* Take the sensor's newest reading; call once per message with the seconds since the last one, and positions. */
    void observe(double seconds, const double *q);

    /* Return whether the sensor has been silent for too long. */
    bool silent() const;

    /* Return whether the sensor has said the same to the last bit for long, while the arm moved: no sensor does. */
    bool frozen() const;

    /* Newest reading (6); NaN before the first one. */
    const double *reading() const { return reading_; }

    /* Compute the wrench that the environment applies to the robot at the tip, in base axes; false if there is none. */
    bool read(const double *q, const double *external_torque, double *wrench) const;

private:
    WrenchSensor *const sensor_;
    const Calibration calibration_;
    const double damping_, sign_;
    double reading_[6];
    double age_;  /* [s] */
    double same_; /* [s] for which the reading has been the same, and the positions before it */
    double since_[7];
    bool moved_; /* a joint has moved since */
};

#endif
