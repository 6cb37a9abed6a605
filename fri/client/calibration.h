// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_CALIBRATION_H
#define FRI_CLIENT_CALIBRATION_H

#include <string>

/* Bias (6) and payload (4) of a sensor, from a file of 'stiffgen calibrate'. */
struct Calibration {
    double bias[6], payload[4];

    /* No bias and no payload: for the recording from which a calibration is made. */
    Calibration();

    /* Throws std::runtime_error if the file cannot be read, or is the calibration of another sensor. */
    explicit Calibration(const std::string &path);
};

#endif
