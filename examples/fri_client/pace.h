// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_PACE_H
#define FRI_CLIENT_PACE_H

#include <algorithm>

/* What the trajectory waits for; 0 of a limit turns that one off. */
struct PaceLimits {
    double error;    /* [m] of the tip from where the trajectory wants it */
    double lag;      /* [rad] of the posture that the governor lets the springs pull to, from the wanted one */
    double energy;   /* [J] stored in the spring */
    double force;    /* [N] of contact */
    double patience; /* [s] that it may stand still for one of these; longer where it creeps */
};

/*
 * How fast the trajectory's own time runs: 1 as in the file, 0 it stands still. The full pace up to 70 % of a limit,
 * none at the limit, so that an arm that is held does not wind the torque up. Never more than 1.
 */
class Pace {
public:
    enum Reason { FREE, ERROR, LAG, ENERGY, FORCE };

    explicit Pace(const PaceLimits &limits) : limits_(limits), pace_(1.0), reason_(FREE), standing_(0.0) {}

    void reset(double pace)
    {
        pace_ = pace;
        reason_ = FREE;
        standing_ = 0.0;
    }

    /* What the last step met, and whether somebody holds the trajectory back on purpose. */
    void update(double error, double lag, double energy, double force, bool hold, double seconds)
    {
        double wanted = 1.0;
        reason_ = FREE;
        consider(error, limits_.error, ERROR, &wanted);
        consider(lag, limits_.lag, LAG, &wanted);
        consider(energy, limits_.energy, ENERGY, &wanted);
        consider(force, limits_.force, FORCE, &wanted);
        /* Near a limit the pace may swing: what creeps stands, in part. */
        const double stands = 1.0 - std::min(wanted, pace_) / CREEP;
        standing_ = hold ? 0.0 : std::max(standing_ + seconds * stands, 0.0);
        wanted = hold ? 0.0 : wanted;
        const double most = seconds / TIME;
        pace_ += std::min(std::max(wanted - pace_, -most), most);
    }

    double value() const { return pace_; }
    Reason reason() const { return reason_; }                      /* what slows it down */
    bool out_of_patience() const { return standing_ > limits_.patience; } /* it stood still for too long */

private:
    /* [s] in which it comes to a stand, and from there to the full pace. */
    static constexpr double TIME = 0.25;
    static constexpr double FULL = 0.7, CREEP = 0.1;

    void consider(double value, double limit, Reason reason, double *wanted)
    {
        if (limit <= 0.0) {
            return;
        }
        const double pace = std::min(std::max((1.0 - value / limit) / (1.0 - FULL), 0.0), 1.0);
        if (!(pace >= *wanted)) { /* also for what is not a number */
            *wanted = pace >= 0.0 ? pace : 0.0;
            reason_ = reason;
        }
    }

    PaceLimits limits_;
    double pace_;
    Reason reason_;
    double standing_; /* [s] */
};

#endif
