// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_REFERENCE_H
#define FRI_CLIENT_REFERENCE_H

#include "trajectory.h"

#include <algorithm>
#include <cmath>

/* Where the arm is to be: a move to the trajectory, the trajectory, then its end. */
class Reference {
public:
    /* approach_time [s]: the move's least duration. */
    Reference(const Trajectory &trajectory, double approach_time)
        : trajectory_(trajectory), approach_time_(approach_time), clock_(0.0), progress_(0.0), done_(false)
    {
    }

    /* From a posture to where the trajectory stopped, or its beginning. */
    void begin(const double *q)
    {
        double goal[JOINTS], rate[JOINTS];
        trajectory_.at(progress_, goal, rate);
        approach_.plan(q, goal, approach_time_);
        clock_ = 0.0;
    }

    /* The joint that is furthest from where begin would lead, and how far [rad]. */
    double distance(const double *q, int *joint) const
    {
        double goal[JOINTS], rate[JOINTS], most = -1.0;
        trajectory_.at(progress_, goal, rate);
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
        clock_ += seconds;
        const double beyond = clock_ - approach_.duration();
        if (beyond > 0.0) {
            clock_ = approach_.duration();
            progress_ = std::min(progress_ + beyond, trajectory_.duration());
            /* Within rounding: the last sample is the end. */
            done_ = done_ || progress_ > trajectory_.duration() - 1e-9;
        }
    }

    /* Position and velocity; pace is that of its time. */
    void at(double pace, double *q, double *dq) const
    {
        if (clock_ < approach_.duration()) {
            approach_.at(clock_, q, dq);
        } else {
            trajectory_.at(progress_, q, dq);
        }
        for (int i = 0; i < JOINTS; ++i) {
            dq[i] *= pace;
        }
    }

    /* Whether it is on its way to where the trajectory stopped, with a speed there that it has not yet. */
    bool returning() const { return progress_ > 0.0 && clock_ < approach_.duration(); }
    double progress() const { return progress_; } /* [s] in the trajectory */
    bool done() const { return done_; }

private:
    const Trajectory &trajectory_;
    const double approach_time_;
    Approach approach_;
    double clock_, progress_; /* [s] in the approach and in the trajectory */
    bool done_;
};

#endif
