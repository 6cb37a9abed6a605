// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_REFERENCE_H
#define FRI_CLIENT_REFERENCE_H

#include "trajectory.h"

#include <algorithm>
#include <cmath>

/* Reference of the controller: a move to the trajectory, the trajectory, then its end. */
class Reference {
public:
    /* approach_time: least duration of the move [s]. */
    Reference(const Trajectory &trajectory, double approach_time)
        : trajectory_(trajectory), approach_time_(approach_time), clock_(0.0), progress_(0.0), done_(false)
    {
    }

    /* Start a move from a configuration to where the trajectory stopped, or to its start. */
    void begin(const double *q)
    {
        double goal[JOINTS], rate[JOINTS];
        trajectory_.at(progress_, goal, rate);
        approach_.plan(q, goal, approach_time_);
        clock_ = 0.0;
    }

    /* Return the largest distance [rad] of a joint from the goal of begin, and the joint. */
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

    /* Compute position and velocity; pace: rate of the trajectory's time. */
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

    /* Return whether the arm moves back to where the trajectory stopped. */
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
