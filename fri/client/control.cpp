// SPDX-License-Identifier: MIT
/* The client's control: reference, pace, and the steps of the controller. */
#include "wiping_client.h"

#include <algorithm>
#include <cmath>

namespace {

/* [s] without a wrench after which the contact force counts as at its limit. */
const double WRENCH_PATIENCE = 0.05;

/* [s] of good samples after which a fault of the communication is reset. */
const double RESET_TIME = 0.2;

const double NOT_A_NUMBER = std::nan("");

/* Return the Frobenius norm of a matrix' antisymmetric part. */
double antisymmetric_norm(const double *matrix)
{
    double sum = 0.0;
    for (int i = 0; i < JOINTS; ++i) {
        for (int j = 0; j < i; ++j) {
            const double half = (matrix[i * JOINTS + j] - matrix[j * JOINTS + i]) / 2.0;
            sum += 2.0 * half * half;
        }
    }
    return std::sqrt(sum);
}

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

void WipingClient::begin_commanding()
{
    reference_.begin(q_);
    pace_.reset(may_begin() ? 1.0 : 0.0);
    faulted_ = false;
    controlling_ = true;
    start_ = 1;
    robot::init(&config_, &state_);
    std::memset(&output_, 0, sizeof output_);
    paper_.begin();
}

/* Return the tip's distance [m] from where the trajectory wants it. */
double WipingClient::tip_error() const
{
    double wanted[16], there[16], square = 0.0;
    robot::pose(input_.q0, wanted);
    robot::pose(q_, there);
    for (int i = 0; i < 3; ++i) {
        square += (wanted[4 * i + 3] - there[4 * i + 3]) * (wanted[4 * i + 3] - there[4 * i + 3]);
    }
    return std::sqrt(square);
}

/* Return the governor's lag [rad] behind the trajectory. */
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

/* Step the controller for lost messages, then advance the reference unless the controller has a fault. */
void WipingClient::missed_and_advance()
{
    const int lost = std::max(clock_.lost(), 0);
    /* So many missed samples are a fault; from then on the length of the silence makes no difference. */
    for (int k = 0; k < std::min(lost, config_.loss_limit); ++k) {
        step_controller(false);
        record_step(clock_.time() - (lost - k) * sample_time_);
    }
    double seconds = (lost < config_.loss_limit ? clock_.periods() : 1) * sample_time_;
    if (!settings_.simulated_time) {
        /* Last check, should both counter and time stamps of the robot be wrong. */
        seconds = std::min(seconds, allowance_);
        allowance_ -= seconds;
    }
    if (question_.state() == Question::NO) {
        let_go(LET_GO_DECLINED);
    }
    const bool waits = button_ || question_.state() == Question::ASKED || let_go_ != LET_GO_NONE;
    if (!faulted_) {
        pace_.update(tip_error(), lag(), record_.elastic_energy, contact_force(), waits, seconds);
        const bool returning = reference_.returning();
        reference_.advance(pace_.value() * seconds);
        if (returning && !reference_.returning()) {
            pace_.reset(0.0); /* the move there ends at rest */
        }
    }
    watch_pace();
}

/* Contact force [N] for the pace. A wrench that is refused or missing counts as at the limit: the controller reports
 * none in its place. */
double WipingClient::contact_force() const
{
    const double limit = settings_.pace.force;
    return wrench_refused_ || since_force_ > WRENCH_PATIENCE ? std::max(force_, limit) : force_;
}

/*
 * Tell the controller which torque acted on the joints beside its own: the environment's, by the robot's torque sensors,
 * and the guard's cuts. A joint that stands still although the sum must move it has a frozen position.
 */
void WipingClient::fill_external_torque()
{
    const double *const external = robotState().getExternalTorque();
    const bool told = connection_.arrival().message.has_external_torque && all_finite(external, JOINTS);
    for (int i = 0; i < JOINTS; ++i) {
        const double environment = told ? settings_.external_torque_sign * external[i] : 0.0;
        input_.external_torque[i] = environment + guard_.sent()[i] - output_.torque[i];
    }
    input_.external_valid = 1;
}

/* Fill the controller's input for this sample; false if there is none. */
bool WipingClient::fill_input()
{
    if (!wrench_.read(q_, robotState().getExternalTorque(), input_.wrench)) {
        return false;
    }
    force_ = std::sqrt(input_.wrench[0] * input_.wrench[0] + input_.wrench[1] * input_.wrench[1] +
                       input_.wrench[2] * input_.wrench[2]);
    since_force_ = 0.0;
    copy(q_, input_.q, JOINTS);
    copy(velocity_.velocity(), input_.dq, JOINTS);
    reference_.at(pace_.value(), input_.q0, dq0_);
    input_.wrench_valid = 1;
    fill_external_torque();
    return true;
}

/* Reset a fault of the communication after good samples; let go for any other fault. The arm then starts from where it
 * is: a direct return to the reference would be too fast. */
void WipingClient::watch_controller()
{
    record_.reset = 0;
    /* Messages lost in between are no good samples. */
    const bool good = faulted_ && valid_ && clock_.lost() < config_.loss_limit;
    good_time_ = good ? good_time_ + sample_time_ : 0.0;
    if (!faulted_ || let_go_ != LET_GO_NONE) {
        return;
    }
    if (output_.fault != robot::FAULT_COMMUNICATION) {
        controller_fault_ = output_.fault;
        let_go(LET_GO_CONTROLLER);
    } else if (good_time_ >= RESET_TIME) {
        int joint = 0;
        if (reference_.distance(q_, &joint) > settings_.approach_limit && !settings_.approach_anyway) {
            let_go(LET_GO_AWAY);
            return;
        }
        robot::reset(&state_);
        reference_.begin(q_);
        record_.reset = 1;
        good_time_ = 0.0;
    }
}

/* Record the controller's input; NaN for a step without a sample, which has not read it. */
void WipingClient::record_input()
{
    const bool valid = input_.sample_valid != 0;
    record_.sample_valid = input_.sample_valid;
    const struct {
        const double *from;
        double *to;
        int count;
    } rows[] = {{input_.q, record_.q, JOINTS},   {input_.dq, record_.dq, JOINTS}, {input_.q0, record_.q0, JOINTS},
                {dq0_, record_.dq0, JOINTS},     {input_.wrench, record_.wrench, 6},
                {input_.external_torque, record_.load, JOINTS}};
    for (const auto &row : rows) {
        if (valid) {
            copy(row.from, row.to, row.count);
        } else {
            fill(row.to, NOT_A_NUMBER, row.count);
        }
    }
    copy(wrench_.reading(), record_.reading, 6);
}

/* Count what the controller's status says, and note the events; valid: the step had a sample. */
void WipingClient::count_output(bool valid)
{
    if (valid) {
        wrench_refused_ = (output_.status & robot::STATUS_WRENCH_REFUSED) != 0;
        counters_.wrench_refused += wrench_refused_ ? 1 : 0;
        events_ |= wrench_refused_ ? EVENT_WRENCH_REFUSED : 0;
    }
    const bool fault = (output_.status & robot::STATUS_FAULT) != 0;
    counters_.controller_faults += fault && !faulted_ ? 1 : 0;
    events_ |= fault ? EVENT_CONTROLLER_FAULT : 0;
    counters_.saturated += (output_.status & robot::STATUS_SATURATED) != 0 ? 1 : 0;
    counters_.rate_limited += (output_.status & robot::STATUS_RATE_LIMITED) != 0 ? 1 : 0;
    counters_.antisymmetric = std::max(counters_.antisymmetric, record_.antisymmetric);
    faulted_ = fault;
}

/* Step the controller, with input_ or without a sample. */
void WipingClient::step_controller(bool valid)
{
    if (valid && settings_.paper) {
        paper_.step(config_, input_, faulted_ ? &output_ : NULL);
        copy(paper_.torque(), input_.torque_offset, JOINTS);
    }
    input_.sample_valid = valid ? 1 : 0;
    ++input_.counter;
    robot::step(&config_, &state_, &input_, &output_);
    record_input();
    copy(output_.torque, record_.torque, JOINTS);
    record_.status = output_.status;
    record_.mode = output_.mode;
    record_.antisymmetric =
        antisymmetric_norm(settings_.paper ? paper_.joint_stiffness() : output_.joint_stiffness);
    record_.tank_energy = output_.tank_energy;
    record_.elastic_energy = settings_.paper ? paper_.energy() : output_.elastic_energy;
    count_output(valid);
}

/* Push the step's row to the log. */
void WipingClient::record_step(double time)
{
    record_.kind = Record::STEP;
    record_.time = time;
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
        missed_and_advance();
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

void WipingClient::control()
{
    const bool torque_mode = robotState().getClientCommandMode() == KUKA::FRI::TORQUE;
    const bool was_done = reference_.done();
    if (!torque_mode) {
        event(EVENT_NO_TORQUE_MODE, &counters_.no_torque_mode);
    }
    if (!takes_control(torque_mode)) {
        if (torque_mode && follower_.known()) {
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
    record_step(clock_.time());
}
