// SPDX-License-Identifier: MIT
/* WipingClient: checks of every message. */
#include "wiping_client.h"

#include <algorithm>
#include <cmath>

namespace {

/* Send periods [s] at which torque can be commanded. */
const double SHORTEST_PERIOD = 0.001, LONGEST_PERIOD = 0.010;

/* [s] Longest one at which a force is held: at 10 ms it swings on a wall of 1e4 N/m. */
const double LONGEST_PRESSING = 0.0051;

/* [rad] Coarsest resolution whose last bits show that a joint gives way, also to the controller. */
const double FINE = 1e-6;

/* [rad] beyond a joint's limit that a position is believed: the controller's own tolerance. */
const double POSITION_TOLERANCE = 0.1;

/* [s] up to which periods are the same, and share of one: they are decimal fractions in binary. */
const double SAME_PERIOD = 1e-6, PERIOD_SHARE = 0.001;

/* Samples in a row beyond the speed limit that may be noise. */
const int FAST_SAMPLES = 2;

bool is_same_period(double a, double b)
{
    return std::fabs(a - b) < SAME_PERIOD;
}

/* Return the first joint that is measured far beyond its limits, -1 for none. */
int find_wild_joint(const double *q)
{
    for (int i = 0; i < JOINTS; ++i) {
        if (q[i] < robot::lower(i) - POSITION_TOLERANCE || q[i] > robot::upper(i) + POSITION_TOLERANCE) {
            return i;
        }
    }
    return -1;
}

} // namespace

/* Initialise the controller for a send period. */
void WipingClient::adopt(double period)
{
    sample_time_ = period;
    other_period_ = 0;
    config_.sample_time = period;
    config_.velocity_noise = settings_.position_quantum / std::max(settings_.velocity_span, period);
    controller_error_ = robot::init(&config_, &state_);
    if (controller_error_ != 0) {
        refuse(REFUSAL_CONTROLLER);
    }
    if (pressing_.wants() && period > LONGEST_PRESSING) {
        refuse(REFUSAL_PRESS_PERIOD);
    }
}

/* Adopt the first usable send period; another one only if it stays, and never while the controller runs. */
void WipingClient::watch_period()
{
    /* [s]; expected: 0 for any */
    const double period = robotState().getSampleTime(), expected = settings_.sample_time;
    const bool in_range =
        period > (1.0 - PERIOD_SHARE) * SHORTEST_PERIOD && period < (1.0 + PERIOD_SHARE) * LONGEST_PERIOD;
    const bool usable = in_range && (expected <= 0.0 || is_same_period(period, expected));
    reported_period_ = period;
    if (usable && sample_time_ <= 0.0) {
        adopt(period);
    } else if (usable && is_same_period(period, sample_time_)) {
        other_period_ = 0;
    } else {
        event(EVENT_PERIOD, &counters_.other_periods);
        if (++other_period_ < PATIENCE) {
            return;
        }
        if (controlling_) {
            let_go(LET_GO_PERIOD);
        } else if (usable) {
            adopt(period);
        } else {
            refuse(REFUSAL_SAMPLE_TIME);
        }
    }
}

/* Advance the robot's clock by a message, and count what it lost. */
void WipingClient::watch_clock(const Arrival &arrival)
{
    clock_.update(arrival.advance, arrival.message.stamp, sample_time_);
    if (clock_.bad_stamp()) {
        event(EVENT_BAD_TIMESTAMP, &counters_.bad_timestamps);
    }
    if (clock_.lost() > 0) {
        counters_.lost_cycles += static_cast<unsigned long long>(clock_.lost());
        events_ |= EVENT_LOST_CYCLES;
    }
    counters_.clock_standing += clock_.standing() ? 1 : 0;
}

/* Return whether the robot's clock was set: how much time has passed since the last position is then unknown. */
bool WipingClient::clock_was_set() const
{
    return clock_.bad_stamp() && connection_.arrival().message.stamp != 0;
}

/* Note quality and button. A button that disappears from the messages counts as pressed. */
void WipingClient::watch_button(const Message &message)
{
    const int quality = robotState().getConnectionQuality();
    if (quality < quality_) {
        event(EVENT_QUALITY_DROP, &counters_.quality_drops);
    }
    quality_ = quality;
    has_button_ = has_button_ || message.has_button;
    button_ = has_button_ && (!message.has_button || robotState().getBooleanIOValue(BUTTON));
    events_ |= button_ ? EVENT_HOLD : 0;
}

/* Note what a message says: first period and time, which all others need, then position, mode, quality and button. */
void WipingClient::observe()
{
    const Arrival &arrival = connection_.arrival();
    ++counters_.cycles;
    events_ |= arrival.refused ? EVENT_BAD_DATAGRAM : 0;
    events_ |= arrival.other_version ? EVENT_OTHER_VERSION : 0;
    watch_period();
    watch_clock(arrival);
    const double passed = clock_.periods() * sample_time_; /* [s] */
    wrench_.observe(passed, q_);
    since_wrench_ += passed;
    watch_samples();
    watch_robot();
    watch_button(arrival.message);
}

/* Take a believed position of a moment after the last one: into the velocity, and the searches for false positions. */
void WipingClient::take_fresh_position(const double *q)
{
    const double elapsed = clock_was_set() ? 0.0 : since_position_; /* [s]; 0: unknown */
    copy(q, q_, JOINTS);
    velocity_.update(q, elapsed);
    has_velocity_ = elapsed > 0.0;
    copies_.add(q, since_position_, sample_time_);
    if (copies_.joint() >= 0 && controlling_) {
        let_go(LET_GO_COPIES);
    }
    watch_standing(q);
    since_position_ = 0.0;
}

/* Take a believed position; fresh: the robot's clock has gone on. The arm moves even while that clock stands still. */
void WipingClient::take_position(const double *q, bool fresh)
{
    if (fresh) {
        take_fresh_position(q);
    }
    follower_.update(q, std::max(since_followed_, sample_time_));
    since_followed_ = 0.0;
}

/* Let go if a position stands still while the torque moves on. In a dry run no torque moves the arm. */
void WipingClient::watch_standing(const double *q)
{
    if (let_go_ != LET_GO_NONE) {
        return;
    }
    if (!controlling_ || faulted_ || settings_.dry_run) {
        standing_.reset();
        settled_.reset();
        return;
    }
    standing_.add(q, output_.torque, config_.effort_limit, config_.position_quantum > FINE, since_position_);
    if (settling_.moves_at_rest() || pressing_.moves_at_rest()) { /* the torque then moves by them alone */
        settled_.add(q, output_.torque, config_.effort_limit, false, since_position_);
    } else {
        settled_.reset();
    }
    if (standing_.joint() >= 0 || settled_.joint() >= 0) {
        let_go(LET_GO_STANDING);
    }
}

/* Return whether the message has the external torques, where the wrench is computed from them. */
bool WipingClient::has_torques() const
{
    return !wrench_.uses_external_torque() || (connection_.arrival().message.has_external_torque &&
                                               all_finite(robotState().getExternalTorque(), JOINTS));
}

/* Check whether the message is a sample; update the filters. */
void WipingClient::watch_samples()
{
    const double *const q = robotState().getMeasuredJointPosition();
    const bool fresh = clock_.periods() > 0 && !clock_.standing();
    const bool positions = connection_.arrival().message.has_position && all_finite(q, JOINTS);
    const int wild = positions ? find_wild_joint(q) : -1;
    const bool believed = positions && wild < 0; /* one wild value must not stay in the filters */
    if (wild >= 0) {
        wild_joint_ = wild;
        wild_position_ = q[wild];
    }
    has_velocity_ = false;
    since_position_ += clock_.periods() * sample_time_;
    since_followed_ += clock_.periods() * sample_time_;
    if (believed && sample_time_ > 0.0) {
        take_position(q, fresh);
    }
    const Defect defect = find_defect(positions, believed, has_torques());
    valid_ = (defect == DEFECT_NONE || defect == DEFECT_CLOCK_SET) && sample_time_ > 0.0;
    count_defect(defect);
}

/* Return the first defect of the message that is found. believed: all positions are within the limits. */
Defect WipingClient::find_defect(bool positions, bool believed, bool torques) const
{
    if (!positions) {
        return DEFECT_POSITION;
    }
    if (!torques) {
        return DEFECT_TORQUE;
    }
    if (!believed) {
        return DEFECT_LIMIT;
    }
    if (clock_.standing()) {
        return DEFECT_STANDING;
    }
    if (clock_.periods() == 0) {
        return DEFECT_TIME;
    }
    if (wrench_.silent()) {
        return DEFECT_SENSOR;
    }
    return clock_was_set() ? DEFECT_CLOCK_SET : DEFECT_NONE;
}

/* Count a message and its defect; let go if too many messages have one. */
void WipingClient::count_defect(Defect defect)
{
    switch (defect) {
    case DEFECT_POSITION:
    case DEFECT_TORQUE: event(EVENT_MISSING_FIELD, &counters_.missing_fields); break;
    case DEFECT_LIMIT: event(EVENT_IMPLAUSIBLE, &counters_.implausible_positions); break;
    case DEFECT_TIME:
    case DEFECT_STANDING: event(EVENT_NO_TIME, &counters_.no_time); break;
    case DEFECT_SENSOR: event(EVENT_SENSOR_SILENT, &counters_.sensor_silent); break;
    default: break;
    }
    counters_.usable += valid_ ? 1 : 0;
    defects_.add(defect, sample_time_);
    const int state = robotState().getSessionState();
    if (defects_.too_many() && (state == KUKA::FRI::COMMANDING_WAIT || state == KUKA::FRI::COMMANDING_ACTIVE)) {
        let_go(LET_GO_DEFECTS);
    }
}

/* Let go if the robot's safety state, operation mode or drives are not those of a motion. */
void WipingClient::watch_states()
{
    const bool safe = robotState().getSafetyState() == KUKA::FRI::NORMAL_OPERATION;
    const bool same = robotState().getOperationMode() == operation_mode_;
    without_drives_ = robotState().getDriveState() == KUKA::FRI::ACTIVE ? 0 : without_drives_ + 1;
    events_ |= !safe || without_drives_ > 0 || !same ? EVENT_STOPPED : 0;
    if (!safe) {
        let_go(LET_GO_SAFETY);
    } else if (!same) {
        let_go(LET_GO_OPERATION_MODE);
    } else if (without_drives_ >= PATIENCE) {
        let_go(LET_GO_DRIVES);
    }
}

/* Check safety state, drives, operation mode and speed while the controller runs. */
void WipingClient::watch_robot()
{
    const bool told = connection_.arrival().message.has_robot;
    without_states_ = told || !controlling_ ? 0 : without_states_ + 1;
    if (without_states_ >= PATIENCE) {
        let_go(LET_GO_ROBOT_STATES);
    }
    if (controlling_ && told) {
        watch_states();
    } else if (told) {
        operation_mode_ = robotState().getOperationMode();
        without_drives_ = 0;
    }
    watch_speed();
}

/* Let go after three fast samples: one wild position looks like two. */
void WipingClient::watch_speed()
{
    int fast = -1;
    for (int i = 0; i < JOINTS; ++i) {
        const bool beyond = std::fabs(velocity_.quotient()[i]) > settings_.speed_share * robot::velocity(i);
        fast = fast < 0 && beyond ? i : fast;
    }
    if (has_velocity_) {
        fast_samples_ = fast < 0 ? 0 : fast_samples_ + 1;
    }
    if (controlling_ && fast_samples_ > FAST_SAMPLES) {
        fast_joint_ = let_go_ == LET_GO_NONE ? fast : fast_joint_;
        let_go(LET_GO_SPEED);
    }
}
