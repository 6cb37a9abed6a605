// SPDX-License-Identifier: MIT
/* The client's control: reference, pace, and the steps of the controller. */
#include "wiping_client.h"

#include <algorithm>
#include <cmath>

namespace {

/* [s] without a plausible wrench after which the contact force counts as at its limit. */
const double WRENCH_PATIENCE = 0.05;

/* Periods without a message after which the controller has a fault; the trajectory then waits. */
const int LONGEST_GAP = 9;

/* [s] of good samples after which a fault of the communication is reset. */
const double RESET_TIME = 0.2;

const double NOT_A_NUMBER = std::nan("");

} // namespace

/* Return whether the arm may move to the trajectory; ask about a long way, or refuse it. */
bool WipingClient::may_begin()
{
    int joint = 0;
    const double distance = reference_.distance(q_, &joint);
    if (!valid_ || distance <= settings_.approach_limit || settings_.approach_anyway) {
        return true;
    }
    if (question_.state() == Question::NONE) {
        question_.set(joint, distance, reference_.progress() > 0.0);
        if (settings_.may_ask) {
            question_.ask();
        } else {
            refuse(REFUSAL_APPROACH);
        }
    }
    return question_.state() == Question::YES;
}

/* Start controller, filters and trajectory where the arm is; a trajectory far away waits for an answer. */
void WipingClient::begin_commanding()
{
    reference_.begin(q_);
    pace_.reset(may_begin() ? 1.0 : 0.0);
    faulted_ = false;
    controlling_ = true;
    start_ = 1;
    robot::init(&config_, &state_);
    settling_.begin(config_);
    pressing_.begin(config_);
    std::memset(&output_, 0, sizeof output_);
    paper_.begin();
}

/* Return the tip's distance [m] from where the trajectory wants it. */
double WipingClient::tip_error() const
{
    double wanted[16], there[16], square = 0.0;
    robot::pose(wanted_, wanted);
    robot::pose(q_, there);
    for (int i = 0; i < 3; ++i) {
        square += (wanted[4 * i + 3] - there[4 * i + 3]) * (wanted[4 * i + 3] - there[4 * i + 3]);
    }
    return std::sqrt(square);
}

/* Return the lag [rad] of the controller's reference behind the trajectory, that of the joint with the largest one. */
double WipingClient::lag() const
{
    double most = 0.0;
    for (int i = 0; i < JOINTS; ++i) {
        most = std::max(most, std::fabs(input_.q0[i] - output_.reference[i]));
    }
    return most;
}

/* Count the steps that a limit slows down, and let go if one of them holds the arm for too long. */
void WipingClient::watch_pace()
{
    if (pace_.reason() == Pace::FREE) {
        return;
    }
    event(EVENT_SLOWED, &counters_.slowed);
    if (pace_.out_of_patience() && let_go_ == LET_GO_NONE) {
        held_by_ = pace_.reason();
        let_go(LET_GO_HELD);
    }
}

/* Return the time [s] since the last message by which the trajectory may advance, and take it from the allowance. */
double WipingClient::take_time()
{
    /* A gap that is too long counts as one period: a jump of the reference would be worse than a late trajectory. */
    const double passed = (clock_.periods() > LONGEST_GAP ? 1 : clock_.periods()) * sample_time_;
    if (settings_.simulated_time) {
        return passed;
    }
    /* Last check, by this computer's clock, should both counter and time stamps of the robot be wrong. */
    const double seconds = std::min(passed, allowance_);
    allowance_ -= seconds;
    return seconds;
}

/* Advance the trajectory by the time since the last message, unless the controller has a fault. */
void WipingClient::advance()
{
    const double seconds = take_time();
    if (question_.state() == Question::NO) {
        let_go(LET_GO_DECLINED);
    }
    const bool waits = button_ || question_.state() == Question::ASKED || let_go_ != LET_GO_NONE;
    if (!faulted_) { /* in a fault the reference stays: the arm starts again from where it is */
        pace_.update(tip_error(), lag(), record_.elastic_energy, contact_force(), waits, seconds);
        const bool returning = reference_.returning();
        reference_.advance(pace_.value() * seconds);
        if (returning && !reference_.returning()) {
            pace_.reset(0.0); /* the move there ends at rest */
        }
    }
    watch_pace();
}

/* Contact force [N] for the pace. A wrench that is missing or implausible counts as at the limit. */
double WipingClient::contact_force() const
{
    const double force = size_of(tip_wrench_);
    return since_wrench_ > WRENCH_PATIENCE ? std::max(force, settings_.pace.force) : force;
}

/* Fill the controller's input for this sample; false if there is none. */
bool WipingClient::fill_input()
{
    if (!wrench_.read(q_, robotState().getExternalTorque(), tip_wrench_)) {
        return false;
    }
    since_wrench_ = is_plausible(tip_wrench_) ? 0.0 : since_wrench_;
    copy(q_, input_.q, JOINTS);
    copy(velocity_.velocity(), input_.dq, JOINTS);
    reference_.at(wanted_);
    copy(wanted_, input_.q0, JOINTS);
    /* Settle waits while the trajectory is slowed down: by a person, a question, a limit, or letting go. */
    const bool stands = pace_.value() < 1.0 || let_go_ != LET_GO_NONE;
    settling_.step(start_ != 0 ? NULL : &output_, tip_wrench_, stands, &input_); /* no output before the first step */
    press();
    return true;
}

/* Return whether a force is wanted: nothing that stops the trajectory, slows it down or ends it lets it go. */
bool WipingClient::presses() const
{
    const bool person = button_ || question_.state() == Question::ASKED;
    const bool ends = let_go_ != LET_GO_NONE || faulted_ || !is_plausible(tip_wrench_);
    return !person && !ends && pace_.reason() == Pace::FREE;
}

/* Let Press move the command of this sample, and note how its force ended. */
void WipingClient::press()
{
    const Pressing::End before = pressing_.end();
    const bool wanted = presses();
    if (wanted && !reference_.approaching() && wrench_.frozen()) {
        pressing_.doubt();
    }
    pressing_.step(start_ != 0 ? NULL : &output_, tip_wrench_, !reference_.approaching(), wanted, &input_);
    if (pressing_.end() == before) {
        return;
    }
    if (pressing_.end() == Pressing::LOST || pressing_.end() == Pressing::MISSED) {
        event(EVENT_CONTACT_LOST, &counters_.contact_lost);
    } else {
        event(EVENT_SENSOR_DOUBTED, &counters_.sensor_doubted);
    }
}

/* Reset a fault of the communication after good samples; let go for any other fault. The arm then starts from where it
 * is: a direct return to the reference would be too fast. */
void WipingClient::watch_controller()
{
    record_.reset = 0;
    /* Messages lost in between are no good samples. */
    const bool good = faulted_ && valid_ && clock_.lost() < config_.call_gap_limit;
    good_time_ = good ? good_time_ + sample_time_ : 0.0;
    if (!faulted_ || let_go_ != LET_GO_NONE) {
        return;
    }
    if (output_.fault != robot::FAULT_COMMUNICATION) {
        let_go(LET_GO_CONTROLLER);
    } else if (good_time_ >= RESET_TIME) {
        int joint = 0;
        if (reference_.distance(q_, &joint) > settings_.approach_limit && !settings_.approach_anyway) {
            let_go(LET_GO_AWAY);
            return;
        }
        robot::reset(&state_);
        settling_.begin(config_);
        pressing_.begin(config_);
        reference_.begin(q_);
        record_.reset = 1;
        good_time_ = 0.0;
    }
}

/* Record the controller's input; NaN for a step without a sample, which has not read it. */
void WipingClient::record_input()
{
    record_.sample_valid = input_.sample_valid;
    record_.counter = input_.counter;
    const struct {
        const double *from;
        double *to;
        int count;
    } rows[] = {{input_.q, record_.q, JOINTS},
                {input_.dq, record_.dq, JOINTS},
                {input_.q0, record_.q0, JOINTS},
                {tip_wrench_, record_.wrench, 6},
                {input_.wrench_command, record_.wrench_command, 6}};
    for (const auto &row : rows) {
        if (input_.sample_valid != 0) {
            copy(row.from, row.to, row.count);
        } else {
            fill(row.to, NOT_A_NUMBER, row.count);
        }
    }
    copy(wrench_.reading(), record_.reading, 6);
}

/* Count what the controller's status says, and note the events. */
void WipingClient::count_output()
{
    const bool fault = (output_.status & robot::STATUS_FAULT) != 0;
    counters_.controller_faults += fault && !faulted_ ? 1 : 0;
    events_ |= fault ? EVENT_CONTROLLER_FAULT : 0;
    counters_.saturated += (output_.status & robot::STATUS_SATURATED) != 0 ? 1 : 0;
    counters_.rate_limited += (output_.status & robot::STATUS_RATE_LIMITED) != 0 ? 1 : 0;
    faulted_ = fault;
}

/* Step the controller, with input_ or without a sample. The counter tells how many messages were lost. */
void WipingClient::step_controller(bool valid)
{
    if (valid && settings_.paper) {
        paper_.step(sample_time_, input_, tip_wrench_, faulted_);
        copy(paper_.torque(), input_.torque_offset, JOINTS);
    }
    input_.sample_valid = valid ? 1 : 0;
    input_.counter += static_cast<std::uint32_t>(clock_.periods());
    robot::step(&state_, &input_, &output_);
    record_input();
    copy(output_.torque, record_.torque, JOINTS);
    record_.status = output_.status;
    record_.mode = output_.mode;
    record_.tank_energy = output_.tank;
    record_.elastic_energy = settings_.paper ? paper_.energy() : output_.stored;
    count_output();
}

/* Push the step's row to the log. */
void WipingClient::record_step()
{
    record_.kind = Record::STEP;
    record_.time = clock_.time();
    record_.start = start_;
    copy(guard_.sent(), record_.sent_torque, JOINTS);
    copy(robotState().getMeasuredTorque(), record_.measured_torque, JOINTS);
    copy(robotState().getExternalTorque(), record_.external_torque, JOINTS);
    record_.quality = quality_;
    record_.tracking = robotState().getTrackingPerformance();
    record_.pace = pace_.value();
    record_.callback_time = last_callback_;
    record_.events = events_;
    records_.push(record_);
    events_ = 0;
    record_.reset = 0;
    start_ = 0;
}

/* Return whether the controller runs from this message on, or goes on; it holds the arm while a question waits. */
bool WipingClient::takes_control(bool torque_mode)
{
    if (controlling_) {
        advance();
        return true;
    }
    if (!valid_ || !torque_mode || let_go_ != LET_GO_NONE || !(may_begin() || settings_.may_ask)) {
        return false;
    }
    begin_commanding();
    return true;
}

/* Send what the guard lets through of the controller's torque. */
void WipingClient::send_torque()
{
    const double zero[JOINTS] = {0.0};
    const double *const torque = settings_.dry_run ? zero : output_.torque;
    const bool whole = guard_.next(torque, config_.effort_limit, config_.torque_rate_limit, sample_time_);
    if (!whole || settings_.dry_run) {
        event(EVENT_GUARD, &counters_.guarded);
    }
    send(follower_.position(), guard_.sent());
}

/* Do this message's part of the control: take control or follow, step the controller, send its torque. */
void WipingClient::control()
{
    const bool torque_mode = robotState().getClientCommandMode() == KUKA::FRI::TORQUE;
    const bool was_done = reference_.done();
    if (!torque_mode) {
        event(EVENT_NO_TORQUE_MODE, &counters_.no_torque_mode);
    }
    if (!takes_control(torque_mode)) {
        if (torque_mode && follower_.known()) { /* not yet, or no more: keep the session by the torque sent last */
            send(follower_.position(), guard_.sent());
        }
        note();
        return;
    }
    watch_controller();
    step_controller(valid_ && torque_mode && fill_input());
    events_ |= reference_.done() && !was_done ? EVENT_DONE : 0;
    if (torque_mode) {
        send_torque();
    }
    answers_before_zero_ = zero_ ? answers_before_zero_ : connection_.answers().count();
    zero_ = guard_.released();
    record_step();
}
