// SPDX-License-Identifier: MIT
#include "clock.h"

#include <algorithm>
#include <cmath>

namespace {

/* Periods that the counter may be ahead of the time stamps: jitter, and stamps that are cut to whole milliseconds. */
const double SLACK = 3.0;

/* Share of the remaining offset between stamps and grid that each message corrects: clocks drift. */
const double DRIFT = 1.0 / 64.0;
/* Periods above which it is no drift. */
const double LARGEST_DRIFT = 1.5;

/* Messages with one and the same time stamp that are no coarse clock's any more. */
const int STANDING = 20;

/* Periods that fit into an int with room, whatever the stamps say. */
const double MOST_PERIODS = 1e6;

/* [s] A gap that is told by the time stamps alone is not believed beyond this: the clock was set. */
const double BRIDGED_GAP = 10.0;

} // namespace

RobotClock::RobotClock()
    : known_(false), time_(0), periods_(1), bad_(false), standing_(false), last_(0), ahead_(0.0), same_(0)
{
}

/* Lay the grid of periods anew, with a point at a stamp. */
void RobotClock::lay(std::int64_t stamp)
{
    last_ = stamp;
    ahead_ = 0.0;
}

/* A counter that counts anew: the time stamps alone tell the periods; passed: of them, -1 if they are not usable. */
void RobotClock::begin_anew(std::int64_t stamp, double passed, double period)
{
    const bool gap = passed >= 0.5 && passed * period <= BRIDGED_GAP;
    periods_ = gap ? static_cast<int>(std::lround(passed)) : 1;
    bad_ = bad_ || !gap;
    lay(stamp);
}

/*
 * A counter that advanced, and a time stamp, `passed` periods after the last one: the counter tells the periods, unless
 * these would lead the grid more than SLACK ahead of the stamps.
 */
void RobotClock::follow(std::uint32_t advance, std::int64_t stamp, double passed)
{
    const double ahead = ahead_ + advance - passed; /* by all that the counter tells */
    const bool is_set_back = passed < -SLACK, is_set_forward = ahead < -SLACK;
    if (last_ == 0 || is_set_back || is_set_forward) {
        bad_ = bad_ || last_ != 0;
        periods_ = static_cast<int>(advance);
        lay(stamp);
        return;
    }
    const double excess = std::min(std::max(0.0, std::ceil(ahead - SLACK)), MOST_PERIODS);
    periods_ = std::max(0, static_cast<int>(advance) - static_cast<int>(excess));
    last_ = stamp;
    ahead_ = ahead_ + periods_ - passed;
    ahead_ -= std::fabs(ahead_) < LARGEST_DRIFT ? DRIFT * ahead_ : 0.0;
}

/* Take a message: `advance` of its counter (0: anew), its stamp [ns] (0: none), and the send period [s]. */
void RobotClock::update(std::uint32_t advance, std::int64_t stamp, double period)
{
    bad_ = stamp == 0;
    same_ = stamp != 0 && stamp == last_ ? same_ + 1 : 0;
    standing_ = same_ >= STANDING;
    if (!known_ || !(period > 0.0)) {
        periods_ = 1;
        known_ = true;
        lay(stamp);
        return;
    }
    /* Periods according to the time stamps; -1 if these are not usable. */
    const double passed = stamp != 0 && last_ != 0 ? 1e-9 * static_cast<double>(stamp - last_) / period : -1.0;
    if (advance == 0) {
        begin_anew(stamp, passed, period);
    } else if (stamp == 0) {
        periods_ = static_cast<int>(advance);
        last_ = 0; /* the grid restarts with the next stamp */
    } else {
        follow(advance, stamp, passed);
    }
    time_ += periods_ * static_cast<std::int64_t>(std::llround(1e9 * period));
}
