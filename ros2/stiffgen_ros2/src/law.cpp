// SPDX-License-Identifier: MIT
#include "law.hpp"

#include <algorithm>
#include <cmath>

namespace stiffgen_ros2 {

static constexpr double TURN = 6.283185307179586; // [rad]
static constexpr double MOST_MISSED = 1e6; // samples that one update may come late: any pause, far within the counter

// Copy the two blocks of a stiffness (3 x 3 each), which stand behind each other in one list.
static void copy_stiffness(const double *blocks, double *translation, double *rotation)
{
    std::copy(blocks, blocks + 9, translation);
    std::copy(blocks + 9, blocks + 18, rotation);
}

// Start at q with `torque` [N m] in force, from the settings; return the controller's error, GOOD for none.
int Law::start(const Settings &settings, bool policy, const robot::Joints &q, const robot::Joints &torque)
{
    const unsigned activation = snapshot_.activation + 1; // the one number that outlives a start
    snapshot_ = {};
    snapshot_.activation = activation;
    snapshot_.is_active = true;
    settings_ = settings;
    sample_ = command_of(settings);
    sample_.clock = robot::BY_COUNTER;
    robot::Report &report = snapshot_.report; // what restart begins at
    for (std::size_t i = 0; i < robot::DOF; ++i) {
        const double limit = settings.config.effort_limit[i];
        report.torque[i] = std::isfinite(torque[i]) ? std::clamp(torque[i], -limit, limit) : 0.0;
        report.position[i] = sample_.q0[i] = target_.posture[i] = last_q_[i] = q[i];
    }
    age_ = 0.0;
    forget_commands();
    uses_policy_ = policy && robot::start(policy_, robot::forward_kinematics(q).data(), 0.0) == 0;
    return restart();
}

// Let the settings' stiffness be in force, without any command.
void Law::forget_commands()
{
    std::copy(settings_.translation_stiffness.begin(), settings_.translation_stiffness.end(), stiffness_);
    std::copy(settings_.rotation_stiffness.begin(), settings_.rotation_stiffness.end(), stiffness_ + 9);
    std::fill(std::begin(wrench_), std::end(wrench_), 0.0);
    wrench_end_ = 0.0;
    wants_pose_ = settles_ = presses_ = has_proposal_ = has_stiffness_ = false;
}

// Begin anew where the last report has the arm, with the settings and the torque in force.
int Law::restart()
{
    robot::Report &report = snapshot_.report;
    robot::Joints torque;
    std::copy(std::begin(report.torque), std::end(report.torque), torque.begin());
    std::copy(std::begin(report.position), std::end(report.position), report.reference); // the springs are at rest
    impedance_ = robot::Impedance(settings_.config, torque);
    follows_ = wants_restart_ = false;
    settles_ = settles_ && robot::start(settle_, settings_.config, settle_force_) == robot::GOOD;
    presses_ = presses_ && robot::start(press_, settings_.config) == robot::GOOD;
    return impedance_.error();
}

void Law::change(const Settings &settings)
{
    wants_restart_ = wants_restart_ || differs(settings_.config, settings.config);
    settings_ = settings;
    std::copy(settings.posture_stiffness.begin(), settings.posture_stiffness.end(), sample_.posture_stiffness);
}

// Take a command; with a policy port, commands become proposals, except joints, Settle and Press.
void Law::command(const Command &command)
{
    const bool can_be_proposed = command.kind == Command::POSE || command.kind == Command::WRENCH || command.kind == Command::STIFFNESS;
    if (uses_policy_ && can_be_proposed && !command.is_parameter) {
        propose(command);
        return;
    }
    switch (command.kind) {
    case Command::JOINTS: go_to_joints(command.values); break;
    case Command::POSE: go_to_pose(command.values); break;
    case Command::WRENCH:
        std::copy(command.values, command.values + 6, wrench_);
        wrench_end_ = command.time - command.age + settings_.wrench_timeout;
        break;
    case Command::STIFFNESS:
        if (command.blocks.translation) { std::copy(command.values, command.values + 9, stiffness_); }
        if (command.blocks.rotation) { std::copy(command.values + 9, command.values + 18, stiffness_ + 9); }
        has_stiffness_ = false; // goes with the next proposals
        break;
    case Command::SETTLE: settle(command.values); break;
    case Command::PRESS: press(command.values); break;
    }
}

// Go to joint positions. Settle and Press go on, at the tip's pose there.
void Law::go_to_joints(const double *q0)
{
    std::copy(q0, q0 + robot::DOF, sample_.q0);
    std::copy(q0, q0 + robot::DOF, target_.posture);
    wants_pose_ = false;
    if (settles_ || presses_) { hold_here(); }
}

// Go to a pose; behind joint positions Follow begins anew.
void Law::go_to_pose(const double *pose)
{
    std::copy(pose, pose + 16, target_.pose);
    follows_ = follows_ && wants_pose_;
    wants_pose_ = true;
}

// Settle with the largest force [N] and moment [N m] that its offset may add; two zeros end it.
void Law::settle(const double *force)
{
    std::copy(force, force + 2, settle_force_);
    const bool is_wanted = std::max(force[0], force[1]) > 0.0;
    settles_ = is_wanted && robot::start(settle_, settings_.config, settle_force_) == robot::GOOD;
    if (settles_) { hold_here(); }
}

// Press with a force f [N] (3) along itself; 0 ends it. The axis of the last force stays.
void Law::press(const double *f)
{
    const double force = std::hypot(f[0], f[1], f[2]);
    pressed_.force = force;
    if (force > 0.0) {
        for (std::size_t k = 0; k < 3; ++k) { pressed_.axis[k] = f[k] / force; }
        presses_ = presses_ || robot::start(press_, settings_.config) == robot::GOOD;
        hold_here();
    }
}

// Settle and Press move a pose. Where joint positions are commanded, it is the tip's pose there.
void Law::hold_here()
{
    if (wants_pose_) { return; }
    const auto pose = robot::forward_kinematics(sample_.q0);
    std::copy(pose.begin(), pose.end(), target_.pose);
    follows_ = false;
    wants_pose_ = true;
}

// Return the part of a proposal that a command becomes.
static int part_of(Command::Kind kind)
{
    if (kind == Command::POSE) { return robot::POSE; }
    return kind == Command::WRENCH ? robot::WRENCH : robot::STIFFNESS;
}

// Return a command's proposal. Until somebody commands a stiffness, the settings' goes with each other part.
robot::Proposal Law::proposal_of(const Command &command) const
{
    robot::Proposal proposal{};
    const int part = part_of(command.kind);
    const double stamp = command.time - command.age; // [s] loop's time
    proposal.valid[part] = 1;
    proposal.time[part] = stamp;
    if (part == robot::POSE) { std::copy(command.values, command.values + 16, proposal.pose); }
    if (part == robot::WRENCH) { std::copy(command.values, command.values + 6, proposal.wrench_command); }
    copy_stiffness(part == robot::STIFFNESS ? command.values : stiffness_, proposal.translation_stiffness, proposal.rotation_stiffness);
    if (part != robot::STIFFNESS && !has_stiffness_) {
        proposal.valid[robot::STIFFNESS] = 1;
        proposal.time[robot::STIFFNESS] = std::nextafter(stamp, stamp - 1.0); // just before: a command of this time is newer
    }
    return proposal;
}

// Hand a command to the policy port, which interpolates, holds and fades. Joint positions are the posture of its poses.
void Law::propose(const Command &command)
{
    const int part = part_of(command.kind);
    static_cast<void>(robot::propose(policy_, proposal_of(command), snapshot_.time));
    if (policy_.refused[part] != 0) {
        ++snapshot_.refusals;
        snapshot_.refused_part = policy_.refused[part];
        return;
    }
    has_proposal_ = true;
    if (part == robot::STIFFNESS) {
        std::copy(command.values, command.values + 18, stiffness_);
        has_stiffness_ = true;
    }
}

// Write pose, stiffness and wrench in force: the policy port's from the first proposal on, else the commanded ones.
void Law::use_commands()
{
    copy_stiffness(stiffness_, sample_.translation_stiffness, sample_.rotation_stiffness);
    if (uses_policy_ && has_proposal_) {
        robot::PolicyOutput output;
        static_cast<void>(robot::command(policy_, snapshot_.time, output));
        std::copy(std::begin(output.translation_stiffness), std::end(output.translation_stiffness), sample_.translation_stiffness);
        std::copy(std::begin(output.rotation_stiffness), std::end(output.rotation_stiffness), sample_.rotation_stiffness);
        std::copy(std::begin(output.pose), std::end(output.pose), target_.pose);
        std::copy(std::begin(output.wrench_command), std::end(output.wrench_command), wrench_);
        wants_pose_ = true;
    } else if (snapshot_.time > wrench_end_) {
        std::fill(std::begin(wrench_), std::end(wrench_), 0.0);
    }
    std::copy(std::begin(wrench_), std::end(wrench_), sample_.wrench_command);
}

void Law::refer(const double *q0)
{
    if (!finite(q0, robot::DOF)) { return; }
    std::copy(q0, q0 + robot::DOF, sample_.q0);
    wants_pose_ = false;
}

// Write the sample of an update, so many sample times after the last one. Without measured velocities they are the mean
// since the last complete sample; a joint without limits may have turned over.
void Law::take_sample(const Measured &measured, double samples)
{
    // Late updates are missing samples, not a fault of the sensor: the counter says so.
    sample_.counter += static_cast<std::uint32_t>(samples);
    snapshot_.late = samples > 1.0 ? snapshot_.late + 1 : 0;
    sample_.sample_valid = measured.is_complete ? 1 : 0;
    age_ += samples;
    const double elapsed = age_ * settings_.config.sample_time; // [s] since the last complete sample
    for (std::size_t i = 0; i < robot::DOF; ++i) {
        const double moved = measured.q[i] - last_q_[i];
        const double way = std::isinf(settings_.config.lower_limit[i]) ? std::remainder(moved, TURN) : moved;
        sample_.q[i] = measured.q[i];
        sample_.dq[i] = settings_.differences_positions ? way / elapsed : measured.dq[i];
    }
    if (measured.is_complete && finite(measured.q.data(), robot::DOF)) {
        last_q_ = measured.q;
        age_ = 0.0;
    }
}

// Let Follow make q0 from the pose. It begins where the springs are at rest: at a first pose, and after a fault or restart.
void Law::follow_pose(const robot::Wrench &wrench)
{
    sample_.shaped = wants_pose_ ? 1 : 0;
    snapshot_.follow = snapshot_.settle = 0;
    snapshot_.stage = robot::STAGE_OFF;
    if (!wants_pose_) { return; }
    const robot::Report &report = snapshot_.report;
    if (!follows_ || report.fault != robot::NO_FAULT) {
        follows_ = robot::start(follow_, settings_.config, report.reference) == robot::GOOD;
    }
    robot::FollowOutput output{};
    robot::FollowInput moved = target_; // a copy: the commanded pose stays
    move_pose(wrench, moved);
    static_cast<void>(robot::step(follow_, moved, output));
    std::copy(output.q0, output.q0 + robot::DOF, sample_.q0);
    snapshot_.follow = output.status;
}

// Let Settle and then Press move the commanded pose, and Press add its force. Settle holds its offset while Press presses.
void Law::move_pose(const robot::Wrench &wrench, robot::FollowInput &moved)
{
    const auto tell = [&](auto &input) { // what both makers are told
        const double *const translation = sample_.translation_stiffness, *const rotation = sample_.rotation_stiffness;
        std::copy(std::begin(moved.pose), std::end(moved.pose), input.pose);
        std::copy(translation, translation + 9, input.translation_stiffness);
        std::copy(rotation, rotation + 9, input.rotation_stiffness);
        std::copy(wrench.begin(), wrench.end(), input.wrench);
    };
    if (settles_) {
        robot::SettleOutput output{};
        tell(settled_);
        settled_.hold = presses_ && press_.stage != robot::STAGE_OFF ? 1 : 0;
        static_cast<void>(robot::step(settle_, settled_, snapshot_.report, output)); // without a reading: the last pose
        std::copy(std::begin(output.pose), std::end(output.pose), moved.pose);
        snapshot_.settle = output.status;
    }
    if (presses_) {
        robot::PressOutput output{};
        tell(pressed_);
        static_cast<void>(robot::step(press_, pressed_, snapshot_.report, output)); // without a reading: no force
        std::copy(std::begin(output.pose), std::end(output.pose), moved.pose);
        for (std::size_t k = 0; k < 6; ++k) { sample_.wrench_command[k] += output.wrench_command[k]; }
        snapshot_.stage = output.stage;
    }
}

// Add gravity's torque.
void Law::offset_gravity()
{
    const bool wanted = settings_.compensate_gravity;
    const robot::Joints torque = wanted ? robot::gravity::gradient(last_q_, settings_.gravity) : robot::Joints{};
    std::copy(torque.begin(), torque.end(), sample_.torque_offset);
}

// Count faults, and each refusal once: a command stays in force until another one comes.
void Law::note(const robot::Report &before)
{
    const robot::Report &now = snapshot_.report;
    const bool is_same_refusal = now.refusal == before.refusal && now.refusal_command == before.refusal_command;
    snapshot_.faults += before.fault == robot::NO_FAULT && now.fault != robot::NO_FAULT;
    if (now.refusal != robot::NO_REFUSAL && !is_same_refusal) {
        ++snapshot_.refusals;
        snapshot_.refused = now;
        snapshot_.refused_part = 0; // the controller's own refusal, not the policy port's
    }
    std::copy(std::begin(sample_.translation_stiffness), std::end(sample_.translation_stiffness), snapshot_.translation_stiffness);
    std::copy(std::begin(sample_.rotation_stiffness), std::end(sample_.rotation_stiffness), snapshot_.rotation_stiffness);
}

// Step the controller with a measurement; `period` [s] since the last step tells missed samples. The order counts: each
// function completes sample_ by what those before it have written, and all of them see the last step's report.
const robot::Report &Law::step(const Measured &measured, double period)
{
    const double sample_time = settings_.config.sample_time;
    const robot::Report before = snapshot_.report;
    snapshot_.time += std::isfinite(period) && period > 0.0 ? period : sample_time;
    take_sample(measured, std::isfinite(period) ? std::clamp(std::round(period / sample_time), 1.0, MOST_MISSED) : 1.0);
    if (wants_restart_ && before.fault == robot::NO_FAULT) { // before the commands: Settle, Press and Follow begin anew, too
        ++snapshot_.restarts;
        static_cast<void>(restart()); // the settings were checked
    }
    use_commands(); // pose, stiffness, wrench
    follow_pose(measured.wrench); // q0 of the pose; Press adds to the wrench
    offset_gravity(); // at last_q_
    static_cast<void>(impedance_.step(sample_, snapshot_.report)); // an error lowers the torque; the status has it
    note(before);
    snapshot_.reading = measured.reading; // for the topics: the springs need no measured wrench
    return snapshot_.report;
}

void Law::reset() { static_cast<void>(impedance_.reset()); }

} // namespace stiffgen_ros2
