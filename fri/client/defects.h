// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_DEFECTS_H
#define FRI_CLIENT_DEFECTS_H

#include <algorithm>

/* Why a message is no good sample. */
enum Defect {
    DEFECT_NONE,
    DEFECT_POSITION,  /* no measured position */
    DEFECT_TORQUE,    /* no external torque */
    DEFECT_LIMIT,     /* a position far beyond a joint's limit */
    DEFECT_TIME,      /* the robot's clock does not follow the messages' counter */
    DEFECT_STANDING,  /* the robot's clock stands still */
    DEFECT_CLOCK_SET, /* the robot's clock was set; the counter tells the time, but no velocity */
    DEFECT_SENSOR,    /* no wrench from the sensor */
    DEFECT_COUNT
};

/*
 * Time lost with defective messages. A defect now and then is a missed sample; a session of which more than a fifth is
 * defective has lost LONGEST after some seconds, even if good samples come in between.
 */
class Defects {
public:
    Defects() { reset(); }

    void reset()
    {
        lost_ = 0.0;
        messages_ = 0;
        std::fill(counts_, counts_ + DEFECT_COUNT, 0ull);
    }

    /* Count a message after so many seconds. */
    void add(Defect defect, double seconds)
    {
        lost_ += defect != DEFECT_NONE ? seconds : -GOOD * seconds;
        if (lost_ <= 0.0) {
            reset();
            return;
        }
        ++messages_;
        ++counts_[defect];
    }

    /* Whether too much time was lost. */
    bool too_many() const { return lost_ > LONGEST; }

    /* Most frequent defect since no time was lost. */
    Defect worst() const
    {
        return static_cast<Defect>(std::max_element(counts_ + 1, counts_ + DEFECT_COUNT) - counts_);
    }

    /* Share of the messages with that defect. */
    double share(Defect defect) const
    {
        return static_cast<double>(counts_[defect]) / static_cast<double>(std::max(messages_, 1ull));
    }

private:
    /* [s]; time regained per time with good messages */
    static constexpr double LONGEST = 1.0, GOOD = 0.25;

    double lost_; /* [s] */
    unsigned long long messages_, counts_[DEFECT_COUNT];
};

#endif
