// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_TRAJECTORY_H
#define FRI_CLIENT_TRAJECTORY_H

#include "filters.h"

#include <string>
#include <vector>

/* Zero-force joint trajectory [rad] from a file, through its samples, smooth in between. */
class Trajectory {
public:
    /*
     * Read comma-separated numbers without a header: one row per joint (7 rows) or one column per joint (7 columns),
     * samples `period` seconds apart. Throws std::runtime_error, naming file, place and remedy, for a file that
     * cannot be read, rows of different length, numbers that are not finite, a position beyond the robot's limits, a
     * step faster than a velocity limit, and a start or end that is not at rest.
     */
    Trajectory(const std::string &path, double period);

    double duration() const { return (count() - 1) * period_; }

    /* Compute the position at a time [s], clamped to 0 .. duration. */
    void at(double time, double *q) const;

private:
    struct Sample {
        double q[JOINTS], dq[JOINTS];
    };

    const Sample &sample(int s) const { return samples_[static_cast<size_t>(s)]; }
    int count() const { return static_cast<int>(samples_.size()); }
    void check(const std::string &path) const;
    void differentiate();

    double period_;
    std::vector<Sample> samples_;
};

/* Minimum-jerk move between two configurations at rest: 10 s^3 - 15 s^4 + 6 s^5. */
class Approach {
public:
    Approach() : duration_(0.0) {}

    /* Plan a move of `least` seconds, or longer where a joint would exceed a quarter of its velocity limit. */
    void plan(const double *from, const double *to, double least);

    double duration() const { return duration_; }
    void at(double time, double *q) const;

private:
    double duration_;
    double from_[JOINTS], to_[JOINTS];
};

#endif
