// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_CLOCK_H
#define FRI_CLIENT_CLOCK_H

#include <cstdint>

/*
 * The robot's time, on the fixed grid of its send period.
 *
 * The messages' counter says how many periods have passed; the time stamps, which jitter, only watch that it does not
 * count faster than time passes: what is integrated over this clock never runs ahead of the robot's by more than SLACK
 * periods. A clock that is set, forward or back, costs nothing: the grid is laid anew. Without a counter (it counts
 * anew after a silence) the time stamps say, rounded to the grid, how long the gap was.
 */
class RobotClock {
public:
    RobotClock();

    /*
     * A message: periods that the counter advanced by (0: it counts anew), time stamp [ns] (0: left out), send period
     * [s] (0: not known yet).
     */
    void update(std::uint32_t advance, std::int64_t stamp, double period);

    int periods() const { return periods_; }    /* since the last message; 0: no new sample */
    int lost() const { return periods_ - 1; }   /* messages that never came; -1 with 0 periods */
    double time() const { return 1e-9 * static_cast<double>(time_); } /* [s] since the first message */
    bool bad_stamp() const { return bad_; }     /* left out, or the clock was set */
    bool standing() const { return standing_; } /* the time stamps have not changed for long */

private:
    void lay(std::int64_t stamp);
    void begin_anew(std::int64_t stamp, double passed, double period);
    void follow(std::uint32_t advance, std::int64_t stamp, double passed);

    bool known_;
    std::int64_t time_; /* [ns] */
    int periods_;
    bool bad_, standing_;
    std::int64_t last_; /* [ns] last time stamp; 0: none since the grid was laid */
    double ahead_;      /* periods: grid point reached, minus that of the last time stamp */
    int same_;          /* messages since the time stamp changed */
};

#endif
