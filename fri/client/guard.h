// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_GUARD_H
#define FRI_CLIENT_GUARD_H

#include "filters.h"

#include <algorithm>
#include <cmath>

/*
 * Last check of the torque before it is sent. The torque sent is finite, within the effort limit, and moves by no
 * more than the rate limit per send period and in this machine's time, so that answers in a burst do not add up. A
 * torque that is not finite counts as zero. After release() the torque goes to zero.
 */
class TorqueGuard {
public:
    TorqueGuard() : budget_(0.0), share_(1.0), releasing_(false) { reset(); }

    /* Start from torque zero. */
    void reset()
    {
        std::fill(sent_, sent_ + JOINTS, 0.0);
        share_ = 1.0;
        releasing_ = false;
    }

    /* Bring the torque to zero within RELEASE_TIME; at_once: at the rate limit, as where the positions are false. */
    void release(bool at_once)
    {
        releasing_ = true;
        share_ = at_once ? 0.0 : share_;
    }
    bool releasing() const { return releasing_; }

    /* Return whether a release has brought the torque to zero. */
    bool released() const
    {
        return releasing_ && std::all_of(sent_, sent_ + JOINTS, [](double torque) { return torque == 0.0; });
    }

    /* Add time of this machine [s]; for a simulated robot, the robot's own. */
    void pass(double seconds, double period) { budget_ = std::min(budget_ + seconds, 2.0 * period); }

    /*
     * Compute the next torque, sent(), from the wanted one. limit [N m], rate [N m/s], period [s] of the robot. Return
     * whether the two are equal.
     */
    bool next(const double *wanted, const double *limit, const double *rate, double period)
    {
        const double time = std::max(0.0, std::min(period, budget_));
        budget_ -= time;
        share_ = releasing_ ? std::max(0.0, share_ - time / RELEASE_TIME) : 1.0;
        bool same = true;
        for (int i = 0; i < JOINTS; ++i) {
            const double most = rate[i] * time;
            double torque = std::isfinite(wanted[i]) ? std::min(std::max(wanted[i], -limit[i]), limit[i]) : 0.0;
            torque *= share_;
            if (std::fabs(torque - sent_[i]) > most * (1.0 + 1e-9)) {
                torque = sent_[i] + std::min(std::max(torque - sent_[i], -most), most);
            }
            same = same && torque == wanted[i];
            sent_[i] = torque;
        }
        return same;
    }

    const double *sent() const { return sent_; }

private:
    /* [s] */
    static constexpr double RELEASE_TIME = 0.25;

    double sent_[JOINTS]; /* [N m] last torque sent */
    double budget_;       /* [s] of the rate limit that may be used at once */
    double share_;        /* share of the torque that is left in a release */
    bool releasing_;
};

#endif
