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

/* Histogram of durations: bins of 0.1 us up to 2 ms, then of 1 % of their duration, up to 11 days. */
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
        ++bins_[place(seconds)];
        most_ = seconds > most_ ? seconds : most_;
        ++count_;
    }

    unsigned long long count() const { return count_; }
    double most() const { return most_; }

    /*
     * Return the least upper edge [s] of a bin that this share of the durations does not exceed: at most 0.1 us or 1 %
     * above the exact quantile, whichever is more.
     */
    double quantile(double share) const
    {
        const double wanted = std::ceil(share * static_cast<double>(count_));
        double sum = 0.0;
        for (int i = 0; i < BINS; ++i) {
            sum += static_cast<double>(bins_[i]);
            if (sum >= wanted) {
                return std::fmin(upper_edge(i), most_);
            }
        }
        return most_;
    }

private:
    enum { FINE = 20000, BINS = FINE + 2014 };

    static double fine() { return 1e-7; }           /* [s] width of a fine bin */
    static double begin() { return static_cast<int>(FINE) * fine(); } /* [s] of the first wide bin */
    static double ratio() { return 1.01; }          /* of a wide bin's edges */

    static int place(double seconds)
    {
        if (!(seconds >= begin())) {
            const int bin = static_cast<int>(std::fmax(seconds, 0.0) / fine());
            return bin < FINE ? bin : FINE - 1;
        }
        const double bin = std::log(seconds / begin()) / std::log(ratio());
        return bin < BINS - FINE ? FINE + static_cast<int>(bin) : BINS - 1;
    }

    static double upper_edge(int bin)
    {
        return bin < FINE ? (bin + 1) * fine() : begin() * std::pow(ratio(), bin - FINE + 1);
    }

    unsigned long long bins_[BINS];
    unsigned long long count_;
    double most_;
};

#endif
