// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_FILTERS_H
#define FRI_CLIENT_FILTERS_H

#include <algorithm>
#include <cmath>

enum { JOINTS = 7 };

inline void copy(const double *from, double *to, int count)
{
    std::copy(from, from + count, to);
}

inline void fill(double *x, double value, int count)
{
    std::fill(x, x + count, value);
}

inline bool all_finite(const double *values, int count)
{
    for (int i = 0; i < count; ++i) {
        if (!std::isfinite(values[i])) {
            return false;
        }
    }
    return true;
}

/*
 * Joint velocities [rad/s] from positions: difference quotient, then a first-order low pass. The filter is exact for
 * positions that are straight between samples, whose rate is the quotient. The first position gives zero.
 */
class VelocityFilter {
public:
    explicit VelocityFilter(double time_constant) : time_constant_(time_constant), known_(false)
    {
        for (int i = 0; i < JOINTS; ++i) {
            last_[i] = quotient_[i] = velocity_[i] = 0.0;
        }
    }

    /* elapsed: [s] since the last position; 0: unknown, the velocity stays as it was. */
    void update(const double *q, double elapsed)
    {
        const double weight = time_constant_ > 0.0 ? -std::expm1(-elapsed / time_constant_) : 1.0;
        for (int i = 0; i < JOINTS; ++i) {
            if (known_ && elapsed > 0.0) {
                quotient_[i] = (q[i] - last_[i]) / elapsed;
                velocity_[i] += weight * (quotient_[i] - velocity_[i]);
            }
            last_[i] = q[i];
        }
        known_ = true;
    }

    const double *velocity() const { return velocity_; }
    const double *quotient() const { return quotient_; } /* before the low pass */

private:
    double time_constant_;
    bool known_;
    double last_[JOINTS], quotient_[JOINTS], velocity_[JOINTS];
};

/*
 * Joint position to command in torque mode: the measured one through a first-order low pass that is exact for an input
 * that is straight between samples. Its lag at constant velocity is the time constant at every period and after every
 * gap. It starts at the first position, without a transient.
 */
class PositionFollower {
public:
    PositionFollower() : known_(false)
    {
        for (int i = 0; i < JOINTS; ++i) {
            input_[i] = output_[i] = 0.0;
        }
    }

    /* elapsed: [s] since the last position, > 0. */
    void update(const double *q, double elapsed)
    {
        const double gone = -std::expm1(-elapsed / TIME_CONSTANT), mean = TIME_CONSTANT / elapsed * gone;
        for (int i = 0; i < JOINTS; ++i) {
            /* Towards the old input for the whole time, and towards its ramp to the new one. */
            const double moved = gone * (input_[i] - output_[i]) + (1.0 - mean) * (q[i] - input_[i]);
            output_[i] = known_ ? output_[i] + moved : q[i];
            input_[i] = q[i];
        }
        known_ = true;
    }

    bool known() const { return known_; }
    const double *position() const { return output_; }

private:
    /* [s] time constant of the paper's filter at its period of 1 ms (7.95 samples). */
    static constexpr double TIME_CONSTANT = 0.008;

    bool known_;
    double input_[JOINTS], output_[JOINTS];
};

#endif
