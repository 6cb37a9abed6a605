// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_TIMING_H
#define FRI_CLIENT_TIMING_H

#include <cmath>
#include <ctime>

/* Return the time [s] of a monotonic clock. */
inline double monotonic_time()
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

/* Histogram of durations, in steps of 0.1 us up to 2 ms. */
class Durations {
public:
    Durations() : count_(0), most_(0.0)
    {
        for (unsigned long long &bin : bins_) {
            bin = 0;
        }
    }

    void add(double seconds)
    {
        const double bin = seconds * 1e7;
        ++bins_[bin < 0.0 ? 0 : bin < BINS - 1 ? static_cast<int>(bin) : BINS - 1];
        most_ = seconds > most_ ? seconds : most_;
        ++count_;
    }

    unsigned long long count() const { return count_; }
    double most() const { return most_; }

    /* Return the least upper edge [s] of a bin that this share of the durations does not exceed. */
    double quantile(double share) const
    {
        const double wanted = std::ceil(share * static_cast<double>(count_));
        double sum = 0.0;
        for (int i = 0; i < BINS - 1; ++i) {
            sum += static_cast<double>(bins_[i]);
            if (sum >= wanted) {
                return std::fmin((i + 1) * 1e-7, most_);
            }
        }
        return most_;
    }

private:
    enum { BINS = 20001 };
    unsigned long long bins_[BINS];
    unsigned long long count_;
    double most_;
};

#endif
