// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_REFERENCE_H
#define FRI_CLIENT_REFERENCE_H

#include "trajectory.h"

#include <algorithm>
#include <cmath>

/* Time [s] that adds up from many small parts, with the digits that each sum lost: an hour is as exact as a second. */
class Elapsed {
public:
    Elapsed() : sum_(0.0), lost_(0.0) {}
    void add(double seconds)
    {
        const double part = seconds + lost_, sum = sum_ + part;
        lost_ = part - (sum - sum_);
        sum_ = sum;
    }
    double seconds() const { return sum_; }

private:
    double sum_, lost_;
};

/* Reference of the controller: a move to the trajectory, the trajectory, then its end. */
class Reference {
public:
    /* approach_time: least duration of the move [s]. */
    Reference(const Trajectory &trajectory, double approach_time)
        : trajectory_(trajectory), approach_time_(approach_time), approaching_(false), done_(false)
    {
    }

    /* Start a move from a configuration to where the trajectory stopped, or to its start. */
    void begin(const double *q)
    {
        double goal[JOINTS];
        trajectory_.at(progress(), goal);
        approach_.plan(q, goal, approach_time_);
        clock_ = Elapsed();
        approaching_ = approach_.duration() > 0.0;
    }

    /* Return the largest distance [rad] of a joint from the goal of begin, and the joint. */
    double distance(const double *q, int *joint) const
    {
        double goal[JOINTS], most = -1.0;
        trajectory_.at(progress(), goal);
        for (int i = 0; i < JOINTS; ++i) {
            if (std::fabs(q[i] - goal[i]) > most) {
                most = std::fabs(q[i] - goal[i]);
                *joint = i;
            }
        }
        return most;
    }

    void advance(double seconds)
    {
        double beyond = seconds;
        if (approaching_) {
            beyond = seconds - (approach_.duration() - clock_.seconds());
            clock_.add(seconds);
            approaching_ = beyond < 0.0;
        }
        if (beyond > 0.0) {
            progress_.add(std::min(beyond, trajectory_.duration() - progress()));
            /* Within rounding: the last sample is the end. */
            done_ = done_ || progress() > trajectory_.duration() - 1e-9;
        }
    }

    /* Compute the position. */
    void at(double *q) const
    {
        if (approaching_) {
            approach_.at(clock_.seconds(), q);
        } else {
            trajectory_.at(progress(), q);
        }
    }

    /* Return whether the arm moves back to where the trajectory stopped. */
    bool returning() const { return progress() > 0.0 && approaching_; }
    bool approaching() const { return approaching_; } /* the arm is not on the trajectory yet */
    double progress() const { return progress_.seconds(); } /* [s] in the trajectory */
    bool done() const { return done_; }

private:
    const Trajectory &trajectory_;
    const double approach_time_;
    Approach approach_;
    Elapsed clock_, progress_; /* in the approach, and in the trajectory */
    bool approaching_, done_;
};

#endif
