// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_COPIES_H
#define FRI_CLIENT_COPIES_H

#include "filters.h"

#include <algorithm>
#include <cmath>

/*
 * Measured positions that repeat earlier ones to the last bit and in their order: late copies. A real joint passes the
 * same positions again, but not by the same steps. A step counts by the bits of its size, in units of the smallest step
 * so far: a coarse encoder needs a longer copy, and at rest nothing counts. A pattern that repeats itself within the
 * copy is an oscillation, or a bit that toggles.
 */
class Copies {
public:
    Copies() { reset(); }

    void reset()
    {
        count_ = 0;
        time_ = 0.0;
        joint_ = -1;
        std::fill(finest_, finest_ + JOINTS, 1.0);
        std::fill(lag_, lag_ + JOINTS, 0);
        late_ = 0;
        std::fill(bits_, bits_ + JOINTS, 0);
        std::fill(begin_, begin_ + JOINTS, 0u);
    }

    /*
     * Take the positions [rad] of a new message, `elapsed` after the one before. Copies are searched as far back as
     * LONGEST messages of this period [s] last: where messages are lost, a slow motion may have come round.
     */
    void add(const double *q, double elapsed, double period)
    {
        time_ += elapsed;
        span_ = static_cast<int>(LONGEST) * period;
        for (int i = 0; i < JOINTS; ++i) {
            const double step = count_ > 0 ? std::fabs(q[i] - past(i, 1)) : 0.0;
            if (step > 0.0) {
                finest_[i] = std::min(finest_[i], step);
                compare(i, q[i], step);
            }
            if (bits_[i] >= BITS) {
                joint_ = i;
                late_ = lag_[i];
            }
        }
        copy(q, past_[count_ % LONGEST], JOINTS);
        when_[count_ % LONGEST] = time_;
        ++count_;
    }

    int joint() const { return joint_; } /* whose positions are copies; -1: none */
    int late() const { return late_; }   /* messages by which they are late */

private:
    /* Messages kept; bits that a copy must have, and that one step counts at most; positions compared before one. */
    enum { LONGEST = 128, BITS = 24, BITS_OF_STEP = 5, LONGEST_MATCH = 4 };

    double past(int joint, int back) const { return past_[(count_ - static_cast<unsigned>(back)) % LONGEST][joint]; }

    double when(int back) const { return when_[(count_ - static_cast<unsigned>(back)) % LONGEST]; }

    /* Compare a position with the one as many messages ago as before, or else search for its copy. */
    void compare(int i, double q, double step)
    {
        const bool goes_on = lag_[i] > 0 && past(i, lag_[i]) == q;
        const bool repeats_itself = count_ - begin_[i] >= static_cast<unsigned>(lag_[i]);
        if (!goes_on || repeats_itself) {
            lag_[i] = find(i, q);
            begin_[i] = count_;
            bits_[i] = 0;
        } else {
            bits_[i] += std::min<int>(std::ilogb(step / finest_[i]), BITS_OF_STEP);
        }
    }

    /* Return how many positions before the one `back` messages ago are those before the newest: up to LONGEST_MATCH. */
    int common(int i, int back) const
    {
        int same = 0;
        while (same < LONGEST_MATCH && past(i, back + same + 1) == past(i, same + 1)) {
            ++same;
        }
        return same;
    }

    /* Return how many messages ago a joint was at q, with the most positions before it in common; 0: never. */
    int find(int i, double q) const
    {
        const int most = static_cast<int>(std::min<unsigned>(count_, LONGEST)) - LONGEST_MATCH;
        int found = 0, longest = -1;
        for (int back = 2; back <= most && time_ - when(back) <= span_; ++back) {
            const int same = past(i, back) == q ? common(i, back) : -1;
            if (same > longest) {
                found = back;
                longest = same;
            }
        }
        return found;
    }

    unsigned count_;       /* messages */
    double time_, span_;   /* [s] of the last message; how far back copies are searched */
    double when_[LONGEST]; /* [s] of a message */
    int joint_, late_;
    int lag_[JOINTS], bits_[JOINTS]; /* messages; [bit] that were repeated with this lag */
    unsigned begin_[JOINTS];         /* message at which this lag began */
    double finest_[JOINTS];          /* [rad] smallest step of an encoder so far */
    double past_[LONGEST][JOINTS];
};

#endif
