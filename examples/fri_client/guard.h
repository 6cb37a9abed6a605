// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_GUARD_H
#define FRI_CLIENT_GUARD_H

#include "filters.h"

#include <algorithm>
#include <cmath>

/*
 * The last look at the torque before the wire. What it lets through is finite, within the effort limit, and moves by no
 * more than the rate limit: per send period of the robot, and per second of this machine's time too, so that answers
 * that leave in a burst do not add up. On release it brings the torque to zero, whatever is wanted.
 */
class TorqueGuard {
public:
    TorqueGuard() : budget_(0.0), share_(1.0), releasing_(false) { reset(); }

    /* Torque zero, nothing released. */
    void reset()
    {
        std::fill(sent_, sent_ + JOINTS, 0.0);
        share_ = 1.0;
        releasing_ = false;
    }

    /* From now on down to zero within RELEASE_TIME. */
    void release() { releasing_ = true; }
    bool releasing() const { return releasing_; }

    /* Whether the torque has come down to zero on release. */
    bool released() const
    {
        return releasing_ && std::all_of(sent_, sent_ + JOINTS, [](double torque) { return torque == 0.0; });
    }

    /* Time of this machine that has passed [s]; a simulated robot's is not the same, then its period is told. */
    void pass(double seconds, double period) { budget_ = std::min(budget_ + seconds, 2.0 * period); }

    /*
     * Torque to be sent next (sent()), from the one that is wanted. limit [N m], rate [N m/s], period [s] of the robot.
     * False if it had to be another one.
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
    double budget_;       /* [s] for which the rate limit may be used up at once */
    double share_;        /* of the effort limit that is left on release */
    bool releasing_;
};

#endif
