// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_PACE_H
#define FRI_CLIENT_PACE_H

#include <algorithm>

/* Limits at which the trajectory stands still; 0 switches a limit off. */
struct PaceLimits {
    double error;    /* [m] distance of the tip from the trajectory */
    double lag;      /* [rad] distance of the controller's reference from the trajectory */
    double energy;   /* [J] elastic energy of the springs */
    double force;    /* [N] contact force */
    double patience; /* [s] longest standstill; creeping counts in part */
};

/*
 * Rate of the trajectory's time: 1 as in the file, 0 at a standstill. It is 1 up to 70 % of a limit and falls to 0 at
 * the limit, so that a blocked arm does not wind the torque up.
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

    /* Update the rate from the last step's values; hold: a person stops the trajectory on purpose. */
    void update(double error, double lag, double energy, double force, bool hold, double seconds)
    {
        double wanted = 1.0;
        reason_ = FREE;
        consider(error, limits_.error, ERROR, &wanted);
        consider(lag, limits_.lag, LAG, &wanted);
        consider(energy, limits_.energy, ENERGY, &wanted);
        consider(force, limits_.force, FORCE, &wanted);
        /* Near a limit the rate may swing, so that creeping counts as standing in part, and a faster rate against. */
        const double stands = 1.0 - std::min(wanted, pace_) / CREEP;
        standing_ = hold ? 0.0 : std::max(standing_ + seconds * stands, 0.0);
        wanted = hold ? 0.0 : wanted;
        const double most = seconds / TIME;
        pace_ += std::min(std::max(wanted - pace_, -most), most);
    }

    double value() const { return pace_; }
    Reason reason() const { return reason_; }                      /* limit that slows the trajectory down */
    bool out_of_patience() const { return standing_ > limits_.patience; } /* the trajectory stood still for too long */

private:
    /* [s] from the full rate to a standstill, and back. */
    static constexpr double TIME = 0.25;
    /* Share of a limit up to which the rate is full; rate below which creeping counts as standing in part. */
    static constexpr double FULL = 0.7, CREEP = 0.1;

    void consider(double value, double limit, Reason reason, double *wanted)
    {
        if (limit <= 0.0) {
            return;
        }
        const double pace = std::min(std::max((1.0 - value / limit) / (1.0 - FULL), 0.0), 1.0);
        if (!(pace >= *wanted)) { /* also if not a number */
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
