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

/* Return whether no value is NaN or infinite. */
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
 * Joint velocities [rad/s] from positions: the difference over a span [s], or over as many positions as are known. It is
 * late by half the span, and 0 as soon as the positions have stood still for it.
 */
class VelocityDifference {
public:
    explicit VelocityDifference(double span) : span_(span), count_(0), time_(0.0)
    {
        fill(quotient_, 0.0, JOINTS);
        fill(velocity_, 0.0, JOINTS);
    }

    /* elapsed: [s] since the last position; 0: unknown, the velocity stays as it was. */
    void update(const double *q, double elapsed)
    {
        count_ = elapsed > 0.0 ? count_ : 0;
        time_ += elapsed;
        unsigned back = count_ > 0 ? 1 : 0; /* position at least a span before this one, or the first; 0: none */
        while (back < std::min<unsigned>(count_, LONGEST - 1) && time_ - when(back) < (1.0 - ROUNDED) * span_) {
            ++back;
        }
        copy(q, past_[count_ % LONGEST], JOINTS);
        when_[count_ % LONGEST] = time_;
        ++count_;
        for (int i = 0; i < JOINTS && back > 0; ++i) {
            /* past(1) is this position now: the last one is past(2), and the span's beginning past(back + 1). */
            velocity_[i] = (q[i] - past(back + 1)[i]) / (time_ - when(back + 1));
            quotient_[i] = (q[i] - past(2)[i]) / elapsed;
        }
    }

    const double *velocity() const { return velocity_; }
    const double *quotient() const { return quotient_; } /* over the last period alone */

private:
    enum { LONGEST = 64 };
    static constexpr double ROUNDED = 1e-6; /* share of the span by which sums of periods may fall short */

    const double *past(unsigned back) const { return past_[(count_ - back) % LONGEST]; }
    double when(unsigned back) const { return when_[(count_ - back) % LONGEST]; }

    double span_;
    unsigned count_; /* positions known */
    double time_;    /* [s] of the last one */
    double when_[LONGEST], past_[LONGEST][JOINTS], quotient_[JOINTS], velocity_[JOINTS];
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

    /*
     * elapsed: t [s] since the last position, > 0. With the time constant T the output moves by 1 - e^(-t/T) of its
     * distance from the old input, and by 1 - T/t (1 - e^(-t/T)) of the input's straight way to the new one.
     */
    void update(const double *q, double elapsed)
    {
        const double of_distance = -std::expm1(-elapsed / TIME_CONSTANT);
        const double of_way = 1.0 - TIME_CONSTANT / elapsed * of_distance;
        for (int i = 0; i < JOINTS; ++i) {
            const double moved = of_distance * (input_[i] - output_[i]) + of_way * (q[i] - input_[i]);
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
