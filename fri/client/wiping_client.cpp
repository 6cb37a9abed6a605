// SPDX-License-Identifier: MIT
#include "wiping_client.h"

#include <friException.h>

#include <algorithm>
#include <cmath>

using KUKA::FRI::FRIException;

namespace {

/* [s] without a wrench after which the contact force counts as at its limit. */
const double WRENCH_PATIENCE = 0.05;

/* [s] of good samples after which a fault of the communication is reset. */
const double RESET_TIME = 0.2;

/* Periods that the trajectory may be ahead of this machine's time, since late messages arrive together. */
const double ALLOWANCE = 8.0;

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

double clamp(double x, double least, double most)
{
    return std::min(std::max(x, least), most);
}

} // namespace

Settings::Settings()
    : paper(false), conventional(false), damping_ratio(0.7), joint_damping(0.1), posture_stiffness(10.0),
      motor_inertia(0.1), effort_share(0.25),
      torque_rise(0.25), speed_share(0.9), sample_time(0.0), approach_time(5.0), approach_limit(0.8),
      approach_anyway(false), may_ask(false), velocity_filter(0.004), wrench_damping(0.01), external_torque_sign(1.0),
      pace(), dry_run(false), simulated_time(false)
{
    /* Stiffness of the paper. */
    const double stiffness[6] = {700.0, 700.0, 800.0, 30.0, 30.0, 30.0};
    copy(stiffness, task_stiffness, 6);
    /* The bowl wiping has 0.1 m, 3.7 J and 85 N. */
    pace.error = 0.2;
    pace.lag = 0.3;
    pace.energy = 6.0;
    pace.force = 150.0;
    pace.patience = 3.0;
}

WipingClient::WipingClient(const Settings &settings, const Trajectory &trajectory, WrenchSensor *sensor,
                           const Connection &connection, Records &records, Question &question)
    : settings_(settings), connection_(connection), records_(records), question_(question),
      velocity_(settings.velocity_filter),
      wrench_(sensor, settings.calibration, settings.wrench_damping, settings.external_torque_sign),
      reference_(trajectory, settings.approach_time), pace_(settings.pace), sample_time_(0.0), reported_period_(0.0),
      other_period_(0), since_position_(0.0), since_followed_(0.0), valid_(false), wild_joint_(0), wild_position_(0.0),
      has_velocity_(false), force_(0.0), since_force_(1e9), wrench_refused_(false), button_(false), has_button_(false),
      quality_(0), operation_mode_(0), without_torque_mode_(0), without_drives_(0), without_states_(0),
      controlling_(false), start_(0), faulted_(false), good_time_(0.0), controller_fault_(robot::FAULT_NONE),
      events_(0), last_command_(0.0), last_callback_(0.0), allowance_(0.0), held_by_(Pace::FREE), fast_samples_(0),
      fast_joint_(0), let_go_(LET_GO_NONE), zero_(false), answers_before_zero_(0), ended_(false),
      refusal_(REFUSAL_NONE), controller_error_(0)
{
    std::memset(&state_, 0, sizeof state_);
    std::memset(&input_, 0, sizeof input_);
    std::memset(&output_, 0, sizeof output_);
    std::memset(&counters_, 0, sizeof counters_);
    std::memset(&record_, 0, sizeof record_);
    fill(q_, 0.0, JOINTS);
    robot::default_config(&config_);
    config_.joint_damping = settings.joint_damping;
    /* The governor limits jumps; it lets the springs follow the trajectory itself. */
    config_.ramp_time = 0.05;
    config_.tip_velocity_limit = 2.0; /* [m/s] */
    config_.tip_rotation_limit = 6.0; /* [rad/s] */
    /* A message that is lost is also a call that is left out: the robot keeps the last torque until the next answer, so
     * that the controller's fall of the torque does not reach it. */
    config_.loss_limit = config_.missed_limit;
    config_.velocity_source = robot::VELOCITY_SOURCE_DIFFERENCED; /* FRI has no velocity */
    /* The basic fields that docs/controller.md tells users to state. Neither a delay of the torque nor a resolution of
     * the positions is known of a real robot: none is assumed, and settings.velocity_filter smooths the velocity. */
    config_.delay_samples = 0;
    config_.position_quantum = 0.0;
    config_.velocity_noise = 0.0;
    config_.heaviest_wrench[0] = settings.pace.force > 0.0 ? settings.pace.force : 150.0; /* [N] */
    config_.heaviest_wrench[1] = 20.0;                                                    /* [N m] */
    /* Energies are stated, too, not left to heaviest_wrench: the tank would hold 165 J (sample time 1 ms) to 223 J
     * (10 ms) and the engagement 259 J, which bound the work that the arm can do on its surroundings. 10 J and 20 J are
     * enough for the wiping of the tests. */
    /* [J] small, whatever the robot could do: the pace of the trajectory looks at the energy, too */
    config_.energy_limit = settings.pace.energy > 0.0 ? settings.pace.energy : 5.0;
    config_.engagement_limit = 20.0;
    config_.tank_initial = 10.0;
    config_.stiffness_time = 0.05;
    config_.stiffness_cap = robot::STIFFNESS_CAP_ACCEPT; /* slow send periods soften light joints; the status says so */
    for (int i = 0; i < JOINTS; ++i) {
        config_.posture_stiffness[i] = settings.paper ? 0.0 : settings.posture_stiffness;
        config_.motor_inertia[i] = settings.motor_inertia;
        config_.reference_velocity_limit[i] = robot::velocity(i); /* the file has been checked for it */
        config_.damping_ratio[i] = settings.damping_ratio;
        config_.effort_limit[i] *= settings.effort_share;
        config_.torque_rate_limit[i] = config_.effort_limit[i] / settings.torque_rise;
    }
    paper_.configure(settings.conventional, settings.task_stiffness, settings.posture_stiffness,
                     settings.damping_ratio, config_);
    for (int i = 0; i < 3 && !settings.paper; ++i) {
        input_.translation_stiffness[4 * i] = settings.task_stiffness[i];
        input_.rotation_stiffness[4 * i] = settings.task_stiffness[3 + i];
    }
    input_.command = robot::COMMAND_POSITION;
    controller_error_ = robot::init(&config_, &state_);
    refusal_ = controller_error_ == 0 ? REFUSAL_NONE : REFUSAL_CONTROLLER;
}

void WipingClient::refuse(Refusal reason)
{
    refusal_ = refusal_ == REFUSAL_NONE ? reason : refusal_;
}

void WipingClient::let_go(LetGo reason)
{
    if (let_go_ == LET_GO_NONE) {
        let_go_ = reason;
        guard_.release();
        events_ |= EVENT_LET_GO;
    }
}

void WipingClient::event(Event bit, unsigned long long *counter)
{
    ++*counter;
    events_ |= bit;
}

/* Log events that came without a step of the controller. */
void WipingClient::note()
{
    if (events_ == 0 && record_.events == 0) {
        return;
    }
    record_.kind = Record::NOTE;
    record_.time = clock_.time();
    record_.events = events_;
    records_.push(record_);
    events_ = 0;
}

void WipingClient::onStateChange(KUKA::FRI::ESessionState oldState, KUKA::FRI::ESessionState newState)
{
    record_.kind = Record::STATE;
    record_.time = clock_.time();
    record_.from = oldState;
    record_.to = newState;
    records_.push(record_);
    without_torque_mode_ = 0;
    if (oldState == KUKA::FRI::COMMANDING_ACTIVE) {
        counters_.state_drops += reference_.done() ? 0 : 1;
        question_.forget();
    }
    controlling_ = false;
    defects_.reset();
    copies_.reset();
    guard_.reset();
    ended_ = newState == KUKA::FRI::IDLE;
}

void WipingClient::send(const double *position, const double *torque)
{
    double within[JOINTS];
    for (int i = 0; i < JOINTS; ++i) {
        within[i] = clamp(position[i], robot::lower(i), robot::upper(i));
    }
    if (!all_finite(within, JOINTS)) {
        event(EVENT_MISSING_FIELD, &counters_.missing_fields); /* of the interpolator */
        return;
    }
    try {
        robotCommand().setJointPosition(within);
        robotCommand().setTorque(torque);
    } catch (const FRIException &) {
        event(EVENT_EXCEPTION, &counters_.exceptions);
    }
    copy(within, record_.sent_position, JOINTS);
}

/* ---- callbacks -------------------------------------------------------------------------------------------------- */

void WipingClient::monitor()
{
    observe();
    if (!reference_.done()) {
        may_begin(); /* report a long way before anything moves */
    }
    note();
}

void WipingClient::waitForCommand()
{
    const double zero[JOINTS] = {0.0};
    observe();
    may_begin();
    if (robotState().getClientCommandMode() == KUKA::FRI::TORQUE) {
        without_torque_mode_ = 0;
        if (connection_.arrival().message.has_ipo) {
            /* The robot executes no values yet; it waits until they are there. */
            send(robotState().getIpoJointPosition(), zero);
        } else {
            event(EVENT_MISSING_FIELD, &counters_.missing_fields);
        }
    } else if (++without_torque_mode_ >= PATIENCE) {
        refuse(REFUSAL_TORQUE_MODE);
    }
    note();
}

void WipingClient::command()
{
    const double begin = monotonic_time();
    observe();
    ++counters_.commanding_cycles;
    counters_.lost_commanding += static_cast<unsigned long long>(std::max(clock_.lost(), 0));
    guard_.pass(settings_.simulated_time ? clock_.periods() * sample_time_ : begin - last_command_, sample_time_);
    allowance_ = std::min(allowance_ + begin - last_command_, ALLOWANCE * sample_time_);
    last_command_ = begin;
    if (refusal_ == REFUSAL_NONE) {
        control();
    }
    last_callback_ = monotonic_time() - begin;
    durations_.add(last_callback_);
}

/* ---- control ---------------------------------------------------------------------------------------------------- */

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
    double wanted[16], there[16], error = 0.0, lag = 0.0;
    robot::pose(input_.q0, wanted);
    robot::pose(q_, there);
    for (int i = 0; i < 3; ++i) {
        error += (wanted[4 * i + 3] - there[4 * i + 3]) * (wanted[4 * i + 3] - there[4 * i + 3]);
    }
    for (int i = 0; i < JOINTS; ++i) {
        lag = std::max(lag, std::fabs(input_.q0[i] - output_.reference[i]));
    }
    if (question_.state() == Question::NO) {
        let_go(LET_GO_DECLINED);
    }
    const bool waits = button_ || question_.state() == Question::ASKED || let_go_ != LET_GO_NONE;
    if (!faulted_) {
        pace_.update(std::sqrt(error), lag, record_.elastic_energy, contact_force(), waits, seconds);
        const bool returning = reference_.returning();
        reference_.advance(pace_.value() * seconds);
        if (returning && !reference_.returning()) {
            pace_.reset(0.0); /* the move there ends at rest */
        }
    }
    if (pace_.reason() != Pace::FREE) {
        event(EVENT_SLOWED, &counters_.slowed);
        if (pace_.out_of_patience() && let_go_ == LET_GO_NONE) {
            held_by_ = pace_.reason();
            let_go(LET_GO_HELD);
        }
    }
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
    record_.sample_valid = input_.sample_valid;
    copy(input_.q, record_.q, JOINTS);
    copy(input_.dq, record_.dq, JOINTS);
    copy(input_.q0, record_.q0, JOINTS);
    copy(dq0_, record_.dq0, JOINTS);
    copy(input_.wrench, record_.wrench, 6);
    copy(input_.external_torque, record_.load, JOINTS);
    if (!valid) {
        /* The controller has not read input_. */
        fill(record_.q, NOT_A_NUMBER, JOINTS);
        fill(record_.dq, NOT_A_NUMBER, JOINTS);
        fill(record_.q0, NOT_A_NUMBER, JOINTS);
        fill(record_.dq0, NOT_A_NUMBER, JOINTS);
        fill(record_.wrench, NOT_A_NUMBER, 6);
        fill(record_.load, NOT_A_NUMBER, JOINTS);
    }
    copy(wrench_.reading(), record_.reading, 6);
    copy(output_.torque, record_.torque, JOINTS);
    record_.status = output_.status;
    record_.mode = output_.mode;
    record_.antisymmetric =
        antisymmetric_norm(settings_.paper ? paper_.joint_stiffness() : output_.joint_stiffness);
    record_.tank_energy = output_.tank_energy;
    record_.elastic_energy = settings_.paper ? paper_.energy() : output_.elastic_energy;
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

void WipingClient::control()
{
    const bool torque_mode = robotState().getClientCommandMode() == KUKA::FRI::TORQUE;
    const bool was_done = reference_.done();
    if (!torque_mode) {
        event(EVENT_NO_TORQUE_MODE, &counters_.no_torque_mode);
    }
    if (controlling_) {
        missed_and_advance();
    } else if (valid_ && torque_mode && let_go_ == LET_GO_NONE && (may_begin() || settings_.may_ask)) {
        begin_commanding(); /* and holds the arm while a question waits */
    } else {
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
        const double zero[JOINTS] = {0.0};
        if (!guard_.next(settings_.dry_run ? zero : output_.torque, config_.effort_limit, config_.torque_rate_limit,
                         sample_time_) ||
            settings_.dry_run) {
            event(EVENT_GUARD, &counters_.guarded);
        }
        send(follower_.position(), guard_.sent());
    }
    answers_before_zero_ = zero_ ? answers_before_zero_ : connection_.answers().count();
    zero_ = guard_.released();
    record_step(clock_.time());
}
