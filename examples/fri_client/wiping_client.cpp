#include "wiping_client.h"

#include <friException.h>

#include <algorithm>
#include <cmath>

using KUKA::FRI::FRIException;

namespace {

const char *const BUTTON = "MediaFlange.UserButton";

/* [s] in which the trajectory comes to a stand when the button is pressed, and goes on when it is released. */
const double PACE_TIME = 0.25;

/* Messages without a send period, or cycles of COMMANDING_WAIT without torque mode, after which the client gives up:
 * one message may be at fault, ten not. */
const int PATIENCE = 10;

/* A sensor that has been silent for so many seconds has failed. */
const double SENSOR_PATIENCE = 0.05;

/* Cycles since a reading that never was. */
const int LONG_AGO = 1 << 20;

/* [s] The robot's clock further ahead, or further back, was set: no cycles were lost, and the message is not old. */
const double LARGEST_GAP = 10.0, LARGEST_DELAY = 1.0;

/* Periods that torque can be commanded at, in seconds. */
const double SHORTEST_PERIOD = 0.001, LONGEST_PERIOD = 0.010;

const double NOT_A_NUMBER = std::nan("");

void copy(const double *from, double *to, int count)
{
    std::memcpy(to, from, static_cast<size_t>(count) * sizeof *to);
}

void fill(double *x, double value, int count)
{
    std::fill(x, x + count, value);
}

double clamp(double x, double least, double most)
{
    return std::min(std::max(x, least), most);
}

/* Frobenius norm of the antisymmetric part. */
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

Settings::Settings()
    : conventional(false), damping_ratio(0.7), joint_damping(0.1), nullspace_stiffness(1.0), effort_share(1.0),
      sample_time(0.0), approach_time(5.0), velocity_filter(0.004), wrench_damping(0.01), external_torque_sign(1.0),
      dry_run(false)
{
    /* The paper's. */
    const double stiffness[6] = {700.0, 700.0, 800.0, 30.0, 30.0, 30.0};
    copy(stiffness, task_stiffness, 6);
}

WipingClient::WipingClient(const Settings &settings, const Trajectory &trajectory, WrenchSensor *sensor,
                           Records &records)
    : settings_(settings), trajectory_(trajectory), sensor_(sensor), records_(records),
      velocity_(settings.velocity_filter), sample_time_(0.0), clock_known_(false), clock_start_(0), clock_last_(0),
      time_(0.0), lost_(0), stale_(false), periods_(1), stale_messages_(0), since_position_(0), valid_(false),
      controlling_(false), start_(0), fallen_back_(false), approach_clock_(0.0), progress_(0.0), pace_(1.0),
      done_(false), quality_(0), without_period_(0), without_torque_mode_(0), button_registered_(false), button_(false),
      sensor_age_(LONG_AGO), events_(0), last_callback_(0.0), finished_(false), refusal_(REFUSAL_NONE),
      controller_error_(0)
{
    std::memset(&state_, 0, sizeof state_);
    std::memset(&input_, 0, sizeof input_);
    std::memset(&output_, 0, sizeof output_);
    std::memset(&counters_, 0, sizeof counters_);
    std::memset(&record_, 0, sizeof record_);
    fill(q_, 0.0, JOINTS);
    fill(dq0_, 0.0, JOINTS);
    fill(sent_, 0.0, JOINTS);
    fill(sensor_wrench_, 0.0, 6);
    robot::default_config(&config_);
    config_.joint_damping = settings.joint_damping;
    /* Faults of single samples and of the communication pass: the governor brings the equilibrium back by itself. */
    config_.law = robot::LAW_PAPER;
    config_.automatic_reset_time = 0.1;
    for (int i = 0; i < JOINTS; ++i) {
        config_.posture_stiffness[i] = settings.nullspace_stiffness;
        config_.damping_ratio[i] = settings.damping_ratio;
        config_.effort_limit[i] *= settings.effort_share;
        config_.torque_rate_limit[i] *= settings.effort_share;
    }
    if (settings.conventional) {
        config_.stiffness_formula = robot::STIFFNESS_FORMULA_CONVENTIONAL;
    }
    input_.command = robot::COMMAND_POSITION;
    input_.wrench_valid = 1;
    for (int i = 0; i < 6; ++i) {
        input_.task_stiffness[7 * i] = settings.task_stiffness[i];
    }
    controller_error_ = robot::init(&config_, &state_);
    refusal_ = controller_error_ == 0 ? REFUSAL_NONE : REFUSAL_CONTROLLER;
}

/* ---- what every cycle does -------------------------------------------------------------------------------------- */

void WipingClient::refuse(Refusal reason)
{
    refusal_ = refusal_ == REFUSAL_NONE ? reason : refusal_;
}

/* Takes the robot's send period, and sets the controller up for it. */
void WipingClient::configure()
{
    const double period = robotState().getSampleTime();
    const double expected = settings_.sample_time;
    if (!(period > 0.0)) {
        if (++without_period_ >= PATIENCE) {
            refuse(REFUSAL_SAMPLE_TIME);
        }
        return;
    }
    sample_time_ = period;
    const bool usable = period > 0.999 * SHORTEST_PERIOD && period < 1.001 * LONGEST_PERIOD;
    if (!usable || (expected > 0.0 && std::fabs(period - expected) > 1e-6)) {
        refuse(REFUSAL_SAMPLE_TIME);
        return;
    }
    config_.sample_time = period;
    controller_error_ = robot::init(&config_, &state_);
    if (controller_error_ != 0) {
        refuse(REFUSAL_CONTROLLER);
    }
}

void WipingClient::onStateChange(KUKA::FRI::ESessionState oldState, KUKA::FRI::ESessionState newState)
{
    record_.kind = Record::STATE;
    record_.time = time_;
    record_.from = oldState;
    record_.to = newState;
    records_.push(record_);
    if (newState == KUKA::FRI::MONITORING_READY || newState == KUKA::FRI::COMMANDING_WAIT) {
        configure();
        without_torque_mode_ = 0;
        try {
            button_ = robotState().getBooleanIOValue(BUTTON);
            button_registered_ = true;
        } catch (const FRIException &) {
            /* Not registered; or left out of this one message, and then it stays as it was. */
        }
    }
    if (oldState == KUKA::FRI::COMMANDING_ACTIVE) {
        counters_.state_drops += done_ ? 0 : 1;
    }
    controlling_ = false;
    fill(sent_, 0.0, JOINTS);
    finished_ = newState == KUKA::FRI::IDLE;
}

/* Cycles lost and messages out of order, by the robot's clock: the messages' own counter is not in the interface. */
void WipingClient::clock()
{
    const double period = sample_time_ > 0.0 ? sample_time_ : robotState().getSampleTime();
    std::int64_t now = static_cast<std::int64_t>(robotState().getTimestampSec()) * 1000000000 +
                       static_cast<std::int64_t>(robotState().getTimestampNanoSec());
    lost_ = 0;
    periods_ = 1;
    stale_ = false;
    if (!clock_known_) {
        clock_known_ = true;
        clock_start_ = clock_last_ = now;
        return;
    }
    const std::int64_t next = clock_last_ + static_cast<std::int64_t>(std::llround(1e9 * period));
    bool good = now != 0;
    now = good ? now : next; /* it was left out */
    const double elapsed = 1e-9 * static_cast<double>(now - clock_last_);
    if (elapsed <= 0.0 && elapsed > -LARGEST_DELAY) {
        good = false;
        stale_ = true;
        periods_ = 0;
        ++stale_messages_;
    } else {
        if (elapsed < 0.0 || elapsed > LARGEST_GAP) {
            good = false;
            clock_start_ += now - next;
        } else if (period > 0.0) {
            /* Old messages since the last new one have been counted as missed samples already. */
            periods_ = std::max(1, static_cast<int>(std::lround(elapsed / period)));
            lost_ = std::max(0, periods_ - 1 - stale_messages_);
        }
        stale_messages_ = 0;
        clock_last_ = now;
    }
    time_ = 1e-9 * static_cast<double>(clock_last_ - clock_start_);
    if (!good) {
        ++counters_.bad_timestamps;
        events_ |= EVENT_BAD_TIMESTAMP;
    }
    if (lost_ > 0) {
        counters_.lost_cycles += static_cast<unsigned long long>(lost_);
        events_ |= EVENT_LOST_CYCLES;
    }
}

void WipingClient::missing_field()
{
    ++counters_.missing_fields;
    events_ |= EVENT_MISSING_FIELD;
}

/* Whether a measured position can be one: as far beyond its limits as the controller believes it. One wild value must
 * not stay in the filters. */
bool WipingClient::within_limits(const double *q) const
{
    for (int i = 0; i < JOINTS; ++i) {
        if (q[i] < robot::lower(i) - config_.position_tolerance ||
            q[i] > robot::upper(i) + config_.position_tolerance) {
            return false;
        }
    }
    return true;
}

void WipingClient::observe()
{
    ++counters_.cycles;
    if (sample_time_ == 0.0 && robotState().getSessionState() != KUKA::FRI::MONITORING_WAIT) {
        configure();
    }
    clock();
    const double *const q = robotState().getMeasuredJointPosition();
    const bool positions = all_finite(q, JOINTS), believed = positions && within_limits(q);
    since_position_ += periods_;
    if (believed && !stale_) {
        copy(q, q_, JOINTS);
        if (sample_time_ > 0.0) {
            velocity_.update(q, since_position_ * sample_time_);
        }
        follower_.update(q);
        since_position_ = 0;
    }
    const bool complete = positions && (sensor_ != NULL || all_finite(robotState().getExternalTorque(), JOINTS));
    if (!complete) {
        missing_field();
    } else if (!believed) {
        ++counters_.implausible_positions;
        events_ |= EVENT_IMPLAUSIBLE;
    }
    valid_ = complete && believed && !stale_ && sample_time_ > 0.0;
    const int quality = robotState().getConnectionQuality();
    if (quality < quality_) {
        ++counters_.quality_drops;
        events_ |= EVENT_QUALITY_DROP;
    }
    quality_ = quality;
    if (sensor_ != NULL) {
        sensor_age_ = sensor_->read(sensor_wrench_) ? 0 : std::min(sensor_age_ + 1 + lost_, LONG_AGO);
    }
    watch_button();
}

void WipingClient::watch_button()
{
    if (button_registered_) {
        try {
            button_ = robotState().getBooleanIOValue(BUTTON);
        } catch (const FRIException &) {
            missing_field(); /* the button counts as it was */
        }
    }
    events_ |= button_ ? EVENT_HOLD : 0;
}

void WipingClient::send(const double *position, const double *torque)
{
    double within[JOINTS];
    for (int i = 0; i < JOINTS; ++i) {
        within[i] = clamp(position[i], robot::lower(i), robot::upper(i));
    }
    if (!all_finite(within, JOINTS)) {
        missing_field(); /* of the interpolator */
        return;
    }
    try {
        robotCommand().setJointPosition(within);
        robotCommand().setTorque(torque);
    } catch (const FRIException &) {
        ++counters_.exceptions;
        events_ |= EVENT_EXCEPTION;
    }
    copy(within, record_.sent_position, JOINTS);
}

/* ---- callbacks -------------------------------------------------------------------------------------------------- */

void WipingClient::monitor()
{
    observe();
    events_ = 0;
}

void WipingClient::waitForCommand()
{
    const double zero[JOINTS] = {0.0};
    observe();
    if (robotState().getClientCommandMode() == KUKA::FRI::TORQUE) {
        without_torque_mode_ = 0;
        try {
            /* The values are not executed yet; that they are there is what the robot waits for. */
            send(robotState().getIpoJointPosition(), zero);
        } catch (const FRIException &) {
            missing_field();
        }
    } else if (++without_torque_mode_ >= PATIENCE) {
        refuse(REFUSAL_TORQUE_MODE);
    }
    events_ = 0;
}

void WipingClient::command()
{
    const double begin = monotonic_time();
    observe();
    ++counters_.commanding_cycles;
    counters_.lost_commanding += static_cast<unsigned long long>(lost_);
    if (refusal_ == REFUSAL_NONE) {
        control();
    }
    last_callback_ = monotonic_time() - begin;
    durations_.add(last_callback_);
}

/* ---- control ---------------------------------------------------------------------------------------------------- */

void WipingClient::begin_commanding(const double *q)
{
    double goal[JOINTS], rate[JOINTS];
    trajectory_.at(progress_, goal, rate);
    approach_.plan(q, goal, settings_.approach_time);
    approach_clock_ = 0.0;
    pace_ = 1.0;
    fallen_back_ = false;
    controlling_ = true;
    start_ = 1;
    robot::init(&config_, &state_);
    std::memset(&output_, 0, sizeof output_);
}

/* Moves on in the approach, then in the trajectory; not while the button is pressed or the controller has let go. */
void WipingClient::advance(double seconds)
{
    if ((output_.status & robot::STATUS_FAULT) == 0) {
        pace_ = clamp(pace_ + (button_ ? -seconds : seconds) / PACE_TIME, 0.0, 1.0);
        approach_clock_ += pace_ * seconds;
    }
    const double beyond = approach_clock_ - approach_.duration();
    if (beyond > 0.0) {
        approach_clock_ = approach_.duration();
        progress_ = std::min(progress_ + beyond, trajectory_.duration());
        /* Within rounding: the last sample is the end. */
        if (!done_ && progress_ > trajectory_.duration() - 1e-9) {
            done_ = true;
            events_ |= EVENT_DONE;
        }
    }
}

/* The wrench that the environment applies to the robot at the tip, in base axes. */
bool WipingClient::read_wrench(const double *q, double *wrench)
{
    if (sensor_ == NULL) {
        double J[6 * JOINTS], torque[JOINTS];
        robot::jacobian(q, J);
        for (int i = 0; i < JOINTS; ++i) {
            torque[i] = settings_.external_torque_sign * robotState().getExternalTorque()[i];
        }
        return wrench_from_torque(J, torque, settings_.wrench_damping, wrench);
    }
    double pose[16];
    robot::pose(q, pose);
    for (int k = 0; k < 2; ++k) {
        for (int i = 0; i < 3; ++i) {
            wrench[3 * k + i] = pose[4 * i] * sensor_wrench_[3 * k] + pose[4 * i + 1] * sensor_wrench_[3 * k + 1] +
                                pose[4 * i + 2] * sensor_wrench_[3 * k + 2];
        }
    }
    if (sensor_age_ * sample_time_ > SENSOR_PATIENCE) {
        ++counters_.sensor_silent;
        events_ |= EVENT_SENSOR_SILENT;
        return false;
    }
    return true;
}

/* One step of the controller, on input_ or on nothing. */
void WipingClient::step_controller(bool valid)
{
    input_.sample_valid = valid ? 1 : 0;
    ++input_.counter;
    robot::step(&config_, &state_, &input_, &output_);
    record_.sample_valid = input_.sample_valid;
    copy(input_.q, record_.q, JOINTS);
    copy(input_.dq, record_.dq, JOINTS);
    copy(input_.q0, record_.q0, JOINTS);
    copy(dq0_, record_.dq0, JOINTS);
    copy(input_.wrench, record_.wrench, 6);
    if (!valid) {
        /* Nothing of it was read. */
        fill(record_.q, NOT_A_NUMBER, JOINTS);
        fill(record_.dq, NOT_A_NUMBER, JOINTS);
        fill(record_.q0, NOT_A_NUMBER, JOINTS);
        fill(record_.dq0, NOT_A_NUMBER, JOINTS);
        fill(record_.wrench, NOT_A_NUMBER, 6);
    }
    copy(output_.torque, record_.torque, JOINTS);
    record_.status = output_.status;
    record_.mode = output_.mode;
    record_.antisymmetric = antisymmetric_norm(output_.joint_stiffness);
    record_.tank_energy = output_.tank_energy;
    record_.elastic_energy = output_.elastic_energy;
    const bool fallback = (output_.status & robot::STATUS_FAULT) != 0;
    counters_.fallbacks += fallback && !fallen_back_ ? 1 : 0;
    counters_.saturated += (output_.status & robot::STATUS_SATURATED) != 0 ? 1 : 0;
    counters_.rate_limited += (output_.status & robot::STATUS_RATE_LIMITED) != 0 ? 1 : 0;
    counters_.antisymmetric = std::max(counters_.antisymmetric, record_.antisymmetric);
    fallen_back_ = fallback;
}

/* The step's row in the log. */
void WipingClient::record_step(double time)
{
    record_.kind = Record::STEP;
    record_.time = time;
    record_.start = start_;
    copy(sent_, record_.sent_torque, JOINTS);
    copy(robotState().getMeasuredTorque(), record_.measured_torque, JOINTS);
    copy(robotState().getExternalTorque(), record_.external_torque, JOINTS);
    record_.quality = quality_;
    record_.tracking = robotState().getTrackingPerformance();
    record_.callback_time = last_callback_;
    record_.events = events_;
    records_.push(record_);
    events_ = 0;
    start_ = 0;
}

/*
 * The controller's torque keeps its limits by itself. This is the last look before the wire: finite, within the effort
 * limit, and no further from the torque sent before than the rate limit allows in one period.
 */
void WipingClient::guard_torque()
{
    bool cut = settings_.dry_run;
    for (int i = 0; i < JOINTS; ++i) {
        const double wanted = settings_.dry_run ? 0.0 : output_.torque[i];
        const double limit = config_.effort_limit[i], most = config_.torque_rate_limit[i] * sample_time_;
        double torque = std::isfinite(wanted) ? clamp(wanted, -limit, limit) : sent_[i];
        if (std::fabs(torque - sent_[i]) > most * (1.0 + 1e-9)) {
            torque = sent_[i] + clamp(torque - sent_[i], -most, most);
        }
        cut = cut || !(torque == wanted);
        sent_[i] = torque;
    }
    if (cut) {
        ++counters_.guarded;
        events_ |= EVENT_GUARD;
    }
}

void WipingClient::control()
{
    const bool torque_mode = robotState().getClientCommandMode() == KUKA::FRI::TORQUE;
    if (!torque_mode) {
        ++counters_.no_torque_mode;
        events_ |= EVENT_NO_TORQUE_MODE;
    }
    if (controlling_) {
        /* What the controller does from the watchdog's limit on does not depend on how long the silence was. */
        for (int k = 0; k < std::min(lost_, config_.missed_limit); ++k) {
            step_controller(false);
            record_step(time_ - (lost_ - k) * sample_time_);
        }
        advance(lost_ < config_.missed_limit ? (1 + lost_) * sample_time_ : sample_time_);
    } else if (valid_ && torque_mode) {
        begin_commanding(q_);
    } else {
        if (torque_mode && follower_.known()) {
            send(follower_.position(), sent_);
        }
        return;
    }
    const bool good = valid_ && torque_mode && read_wrench(q_, input_.wrench);
    if (good) {
        copy(q_, input_.q, JOINTS);
        copy(velocity_.velocity(), input_.dq, JOINTS);
        if (approach_clock_ < approach_.duration()) {
            approach_.at(approach_clock_, input_.q0, dq0_);
        } else {
            trajectory_.at(progress_, input_.q0, dq0_);
        }
        for (int i = 0; i < JOINTS; ++i) {
            dq0_[i] *= pace_;
        }
    }
    step_controller(good);
    if (torque_mode) {
        guard_torque();
        send(follower_.position(), sent_);
    }
    record_step(time_);
}
