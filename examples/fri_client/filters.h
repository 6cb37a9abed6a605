#ifndef FRI_CLIENT_FILTERS_H
#define FRI_CLIENT_FILTERS_H

#include <cmath>

enum { JOINTS = 7 };

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
 * Joint velocities [rad/s] from positions: difference quotient, then a first-order low pass that is exact for an input
 * held between samples. The first position gives zero.
 */
class VelocityFilter {
public:
    explicit VelocityFilter(double time_constant) : time_constant_(time_constant), known_(false)
    {
        for (int i = 0; i < JOINTS; ++i) {
            last_[i] = velocity_[i] = 0.0;
        }
    }

    /* elapsed [s] since the last position, > 0. */
    void update(const double *q, double elapsed)
    {
        const double weight = time_constant_ > 0.0 ? -std::expm1(-elapsed / time_constant_) : 1.0;
        for (int i = 0; i < JOINTS; ++i) {
            if (known_) {
                velocity_[i] += weight * ((q[i] - last_[i]) / elapsed - velocity_[i]);
            }
            last_[i] = q[i];
        }
        known_ = true;
    }

    const double *velocity() const { return velocity_; }

private:
    double time_constant_;
    bool known_;
    double last_[JOINTS], velocity_[JOINTS];
};

/*
 * The joint position to command in torque mode: the measured one through y = 0.8816 y' + 0.0592 (x + x'), x' and y' of
 * the sample before. Gain 1 at rest; it starts at the first position, so there is no transient to wait for.
 */
class PositionFollower {
public:
    PositionFollower() : known_(false)
    {
        for (int i = 0; i < JOINTS; ++i) {
            input_[i] = output_[i] = 0.0;
        }
    }

    void update(const double *q)
    {
        for (int i = 0; i < JOINTS; ++i) {
            output_[i] = known_ ? 0.8816 * output_[i] + 0.0592 * (q[i] + input_[i]) : q[i];
            input_[i] = q[i];
        }
        known_ = true;
    }

    bool known() const { return known_; }
    const double *position() const { return output_; }

private:
    bool known_;
    double input_[JOINTS], output_[JOINTS];
};

#endif
