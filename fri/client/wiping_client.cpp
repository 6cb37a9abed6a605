// SPDX-License-Identifier: MIT
#include "wiping_client.h"

#include <friException.h>

#include <algorithm>
#include <cmath>

using KUKA::FRI::FRIException;

namespace {

/* Share of the effort limit that the torque ranges over before a position stands. Less at rest, where Settle or Press
 * alone changes the torque: it may stop just above the friction of a joint that then goes on unseen. */
const double STANDING_RANGE = 0.03, SETTLED_RANGE = 0.015;

/* Periods that the trajectory may be ahead of this machine's time, since late messages arrive together. */
const double ALLOWANCE = 8.0;

/* [s] since a wrench that never came. */
const double LONG_AGO = 1e9;

/* Heaviest force [N] without a force limit, and moment [N m]; an energy limit may set less. */
const double LARGEST_FORCE = 150.0, LARGEST_MOMENT = 20.0;

/* [rad] resolution at which the controller does not take positions that stand still for frozen ones. */
const double COARSE = 1e-5;

double clamp(double x, double least, double most)
{
    return std::min(std::max(x, least), most);
}

/*
 * Return the force or moment F at which springs with three stiffnesses k store an energy E [J] (0: any), at most
 * `most`: E = F^2 / (2 k) is largest along the softest one.
 */
double heaviest(const double *stiffness, double energy, double most)
{
    double softest = HUGE_VAL;
    for (int i = 0; i < 3; ++i) {
        softest = stiffness[i] > 0.0 ? std::min(softest, stiffness[i]) : softest;
    }
    return energy > 0.0 ? std::min(std::sqrt(2.0 * energy * softest), most) : most;
}

} // namespace

/* Configure the controller; a session that cannot be controlled is refused later, by refusal(). */
WipingClient::WipingClient(const Settings &settings, const Trajectory &trajectory, WrenchSensor *sensor,
                           const Connection &connection, Records &records, Question &question)
    : settings_(settings), connection_(connection), records_(records), question_(question),
      settling_(settings.settle_force), pressing_(settings.press_force, settings.pace.error),
      velocity_(settings.velocity_span),
      standing_(STANDING_RANGE), settled_(SETTLED_RANGE),
      wrench_(sensor, settings.calibration, settings.wrench_damping, settings.external_torque_sign),
      reference_(trajectory, settings.approach_time), pace_(settings.pace), sample_time_(0.0), reported_period_(0.0),
      other_period_(0), since_position_(0.0), since_followed_(0.0), valid_(false), wild_joint_(0), wild_position_(0.0),
      has_velocity_(false), since_wrench_(LONG_AGO), button_(false), has_button_(false), quality_(0), operation_mode_(0),
      without_torque_mode_(0), without_drives_(0), without_states_(0), controlling_(false), start_(0), faulted_(false),
      good_time_(0.0), events_(0), last_command_(0.0), last_callback_(0.0), allowance_(0.0), held_by_(Pace::FREE),
      fast_samples_(0), fast_joint_(0), let_go_(LET_GO_NONE), zero_(false), answers_before_zero_(0), ended_(false),
      refusal_(REFUSAL_NONE), controller_error_(0)
{
    std::memset(&state_, 0, sizeof state_);
    std::memset(&input_, 0, sizeof input_);
    std::memset(&output_, 0, sizeof output_);
    std::memset(&counters_, 0, sizeof counters_);
    std::memset(&record_, 0, sizeof record_);
    fill(q_, 0.0, JOINTS);
    fill(wanted_, 0.0, JOINTS);
    fill(tip_wrench_, 0.0, 6);
    configure();
    controller_error_ = robot::init(&config_, &state_);
    refusal_ = controller_error_ == 0 ? REFUSAL_NONE : REFUSAL_CONTROLLER;
    if (2.0 * settings.press_force > config_.heaviest_wrench[0]) {
        refuse(REFUSAL_PRESS);
    }
}

/* Configure the controller, and set what every sample commands. */
void WipingClient::configure()
{
    robot::default_config(&config_);
    config_.sample_time = 0.005; /* [s] until the robot has told its send period */
    config_.delay_samples = settings_.delay_samples;
    const PaceLimits &pace = settings_.pace;
    const double largest_force = pace.force > 0.0 ? pace.force : LARGEST_FORCE;
    config_.heaviest_wrench[0] = heaviest(settings_.task_stiffness, pace.energy, largest_force);
    config_.heaviest_wrench[1] = heaviest(settings_.task_stiffness + 3, pace.energy, LARGEST_MOMENT);
    config_.tip_velocity_limit[0] = 2.0; /* [m/s] the file has been checked for the joints' limits */
    config_.tip_velocity_limit[1] = 6.0; /* [rad/s] */
    /* In a dry run the controller's torque does not act: positions that stand still are not frozen. */
    const double finest = settings_.dry_run ? COARSE : 0.0;
    config_.position_quantum = std::max(settings_.position_quantum, finest);
    for (int i = 0; i < JOINTS; ++i) {
        config_.motor_inertia[i] = settings_.motor_inertia;
        config_.coulomb_friction[i] = settings_.friction[i];
        config_.effort_limit[i] *= settings_.effort_share;
        config_.torque_rate_limit[i] = config_.effort_limit[i] / settings_.torque_rise;
        input_.posture_stiffness[i] = settings_.paper ? 0.0 : settings_.posture_stiffness;
    }
    config_.damping_ratio = settings_.damping_ratio;
    paper_.configure(settings_.conventional, settings_.task_stiffness, settings_.posture_stiffness,
                     settings_.damping_ratio, config_);
    for (int i = 0; i < 3 && !settings_.paper; ++i) {
        input_.translation_stiffness[4 * i] = settings_.task_stiffness[i];
        input_.rotation_stiffness[4 * i] = settings_.task_stiffness[3 + i];
    }
    input_.clock = robot::CLOCK_COUNTER;
    input_.shaped = 1; /* a trajectory, and the move to it, have ramps */
}

void WipingClient::refuse(Refusal reason)
{
    refusal_ = refusal_ == REFUSAL_NONE ? reason : refusal_;
}

/* Begin to let go, for the first reason that comes: the torque goes to zero, and the session ends. */
void WipingClient::let_go(LetGo reason)
{
    if (let_go_ == LET_GO_NONE) {
        let_go_ = reason;
        guard_.release(reason == LET_GO_STANDING);
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

/* Log the change; control ends with each one, and all that judges samples in a row starts anew. */
void WipingClient::onStateChange(KUKA::FRI::ESessionState oldState, KUKA::FRI::ESessionState newState)
{
    record_.kind = Record::STATE;
    record_.time = clock_.time();
    record_.from = oldState;
    record_.to = newState;
    records_.push(record_);
    without_torque_mode_ = 0;
    if (oldState == KUKA::FRI::COMMANDING_ACTIVE) { /* a question is about the position of then */
        counters_.state_drops += reference_.done() ? 0 : 1;
        question_.forget();
    }
    controlling_ = false;
    defects_.reset();
    if (let_go_ == LET_GO_NONE) {
        copies_.reset(); /* else the last line still names the joint */
    }
    guard_.reset();
    ended_ = newState == KUKA::FRI::IDLE;
}

/* Command position and torque; the position is kept within the limits, beyond which the robot would stop. */
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

/* Answer a message of the monitoring states. */
void WipingClient::monitor()
{
    observe();
    if (!reference_.done()) {
        may_begin(); /* report a long way before anything moves */
    }
    note();
}

/* Answer while the robot waits for commands: the interpolator's position and no torque. */
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

/* Answer a message while commanding, and measure how long that takes. */
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
