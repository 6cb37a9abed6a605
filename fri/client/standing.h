// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_STANDING_H
#define FRI_CLIENT_STANDING_H

#include "filters.h"

#include <algorithm>
#include <cmath>

/*
 * Positions that take two values at most, as of an encoder that stands still but for a bit, while the controller's torque
 * moves on: a sound encoder shows that its joint gives way. The controller itself finds a fine position that is the same
 * to the last bit. A coarse one takes two values in stiction, too: it stands at one, under twice as much torque.
 */
class Standing {
public:
    /* range: share of the effort limit that the torque ranges over before a position stands. */
    explicit Standing(double range) : range_(range) { reset(); }

    void reset()
    {
        joint_ = -1;
        std::fill(value_, value_ + JOINTS, std::nan(""));
        std::fill(other_, other_ + JOINTS, std::nan(""));
        std::fill(time_, time_ + JOINTS, 0.0);
        std::fill(least_, least_ + JOINTS, 0.0);
        std::fill(most_, most_ + JOINTS, 0.0);
    }

    /*
     * Take positions [rad], the torque before them and the effort limits [N m], `elapsed` [s] after the last ones.
     * coarse: friction and contacts may hold a joint within one step of its encoder.
     */
    void add(const double *q, const double *torque, const double *effort, bool coarse, double elapsed)
    {
        const double share = (coarse ? 2.0 : 1.0) * range_;
        for (int i = 0; i < JOINTS; ++i) {
            const bool stands = q[i] == value_[i] || (!coarse && q[i] == other_[i]);
            if (!stands) {
                other_[i] = value_[i];
                value_[i] = q[i];
            }
            time_[i] = stands ? time_[i] + elapsed : 0.0;
            least_[i] = stands ? std::min(least_[i], torque[i]) : torque[i];
            most_[i] = stands ? std::max(most_[i], torque[i]) : torque[i];
            joint_ = time_[i] >= TIME && most_[i] - least_[i] > share * effort[i] ? i : joint_;
        }
    }

    int joint() const { return joint_; } /* whose position stands; -1: none */

private:
    static constexpr double TIME = 0.02; /* [s] */

    const double range_;
    int joint_;
    double value_[JOINTS], other_[JOINTS], time_[JOINTS], least_[JOINTS], most_[JOINTS];
};

#endif
