// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_OPTIONS_H
#define FRI_CLIENT_OPTIONS_H

#include "settings.h"

#include <string>

/* Options of the command line. */
struct Options {
    Settings settings;
    std::string trajectory, log, summary, host, calibration;
    double trajectory_period; /* [s] */
    int port, sensor_port;
    unsigned int timeout; /* [ms] of silence that ends the session */
    double wait;          /* [s] for the robot's first usable message */
    int realtime;         /* priority; 0: none */
    bool sensor;

    Options();

    /* Parse; false if only help was asked for. Throws std::runtime_error, naming the option and the remedy. */
    bool parse(int argc, char **argv);

private:
    void check_settle() const;
    void check_press() const;
    void read_calibration();
};

#endif
