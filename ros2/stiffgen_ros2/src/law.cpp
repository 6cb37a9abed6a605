// SPDX-License-Identifier: MIT
#include "law.hpp"

#include <algorithm>
#include <cmath>

namespace stiffgen_ros2 {

int Law::start(const Settings &settings, bool policy, const robot::Joints &q, const robot::Joints &torque)
{
    robot::Joints in_force = torque;
    for (std::size_t i = 0; i < robot::DOF; ++i) {
        const double limit = settings.config.effort_limit[i];
        in_force[i] = std::isfinite(torque[i]) ? std::clamp(torque[i], -limit, limit) : 0.0;
    }
    impedance_ = robot::Impedance(settings.config, in_force);
    sample_ = {};
    const unsigned activation = snapshot_.activation + 1;
    snapshot_ = {};
    snapshot_.activation = activation;
    snapshot_.is_active = true;
    sample_.command = robot::BY_POSITION;
    std::copy(q.begin(), q.end(), sample_.q0);
    std::fill(std::begin(stiffness_), std::end(stiffness_), 0.0);
    copy_stiffness(settings, {true, true}, stiffness_);
    translation_order_ = settings.translation_order;
    rotation_order_ = settings.rotation_order;
    use_stiffness();
    change(settings);
    uses_port_ = policy;
    has_proposal_ = has_stiffness_ = false;
    wrench_end_ = 0.0;
    robot::start(port_, robot::forward_kinematics(q).data(), 0.0);
    return impedance_.error();
}

void Law::change(const Settings &settings)
{
    settings_ = settings;
    impedance_.config() = settings.config;
    double stiffness[36];
    copy_stiffness(settings, {true, true}, stiffness);
    const Assigned taken = take_stiffness(stiffness, settings.translation_order, settings.rotation_order);
    if (taken.translation || taken.rotation) {
        use_stiffness();
        has_stiffness_ = false; // goes with the next proposals
    }
}

// Take the blocks of a stiffness that are newer than those in force: settings and commands come on ways of their own.
Assigned Law::take_stiffness(const double *stiffness, std::uint64_t translation_order, std::uint64_t rotation_order)
{
    const Assigned newer = {translation_order > translation_order_, rotation_order > rotation_order_};
    for (std::size_t row = 0; row < 6; ++row) {
        if (row < 3 ? newer.translation : newer.rotation) { std::copy(stiffness + 6 * row, stiffness + 6 * row + 6, stiffness_ + 6 * row); }
    }
    if (newer.translation) { translation_order_ = translation_order; }
    if (newer.rotation) { rotation_order_ = rotation_order; }
    return newer;
}

void Law::use_stiffness()
{
    for (std::size_t row = 0; row < 3; ++row) {
        std::copy(stiffness_ + 6 * row, stiffness_ + 6 * row + 3, sample_.translation_stiffness + 3 * row);
        std::copy(stiffness_ + 6 * (row + 3) + 3, stiffness_ + 6 * (row + 3) + 6, sample_.rotation_stiffness + 3 * row);
    }
}

void Law::command_at_once(const Command &command)
{
    switch (command.kind) {
    case Command::JOINTS:
        std::copy(command.values, command.values + robot::DOF, sample_.q0);
        sample_.command = robot::BY_POSITION;
        break;
    case Command::POSE:
        std::copy(command.values, command.values + 16, sample_.equilibrium);
        sample_.command = robot::BY_EQUILIBRIUM;
        break;
    case Command::WRENCH:
        std::copy(command.values, command.values + 6, sample_.wrench_command);
        wrench_end_ = command.time - command.age + settings_.wrench_timeout;
        break;
    case Command::STIFFNESS:
        take_stiffness(command.values, command.order, command.order);
        use_stiffness();
        break;
    }
}

// Hand a command to the policy port, which interpolates, holds and fades. Joint positions are the wanted posture.
void Law::propose(const Command &command)
{
    robot::Proposal proposal{};
    const int part = command.kind == Command::POSE ? robot::POSE : command.kind == Command::WRENCH ? robot::WRENCH : robot::STIFFNESS;
    const double stamp = command.time - command.age;
    proposal.valid[part] = 1;
    proposal.time[part] = stamp;
    if (part == robot::POSE) { std::copy(command.values, command.values + 16, proposal.equilibrium); }
    if (part == robot::WRENCH) { std::copy(command.values, command.values + 6, proposal.wrench_command); }
    if (part == robot::STIFFNESS) {
        std::copy(command.values, command.values + 36, proposal.stiffness);
    } else if (!has_stiffness_) { // until somebody commands one, the stiffness goes with each proposal, before such a command
        proposal.valid[robot::STIFFNESS] = 1;
        proposal.time[robot::STIFFNESS] = std::nextafter(stamp, stamp - 1.0);
        std::copy(std::begin(stiffness_), std::end(stiffness_), proposal.stiffness);
    }
    robot::propose(settings_.config, port_, proposal, snapshot_.time);
    if (port_.refused[part] != 0) {
        ++snapshot_.refusals;
        snapshot_.reason = port_.refused[part];
        snapshot_.refusal = robot::refusal_of(port_, part);
        return;
    }
    has_proposal_ = true;
    if (part != robot::STIFFNESS) { return; }
    const Assigned taken = take_stiffness(command.values, command.order, command.order);
    has_stiffness_ = has_stiffness_ || taken.translation || taken.rotation;
}

void Law::command(const Command &command)
{
    if (!uses_port_) {
        command_at_once(command);
    } else if (command.kind == Command::JOINTS) {
        std::copy(command.values, command.values + robot::DOF, sample_.q0);
    } else {
        propose(command);
    }
}

void Law::follow(const double *q0)
{
    if (std::all_of(q0, q0 + robot::DOF, [](double each) { return std::isfinite(each); })) {
        std::copy(q0, q0 + robot::DOF, sample_.q0);
        sample_.command = robot::BY_POSITION;
    }
}

// Count a refusal by the controller once: a command stays in force until another one comes.
void Law::note_refusal(const robot::Refusal &before)
{
    const robot::Refusal now = robot::refusal_of(snapshot_.report);
    if (now.code != robot::NO_REFUSAL && (now.code != before.code || now.argument != before.argument)) {
        ++snapshot_.refusals;
        snapshot_.reason = 0;
        snapshot_.refusal = now;
    }
}

const robot::Report &Law::step(const Measured &measured, double period)
{
    const double sample_time = settings_.config.sample_time;
    snapshot_.time += std::isfinite(period) && period > 0.0 ? period : sample_time;
    // Late updates are missing samples, not a fault of the sensor: the counter says so.
    const double samples = std::isfinite(period) ? std::clamp(std::round(period / sample_time), 1.0, 1e6) : 1.0;
    sample_.counter += static_cast<std::uint32_t>(samples);
    sample_.sample_valid = measured.is_complete ? 1 : 0;
    std::copy(measured.q.begin(), measured.q.end(), sample_.q);
    std::copy(measured.dq.begin(), measured.dq.end(), sample_.dq);
    if (uses_port_ && has_proposal_) {
        robot::command(port_, snapshot_.time, sample_);
    } else if (snapshot_.time > wrench_end_) {
        std::fill(std::begin(sample_.wrench_command), std::end(sample_.wrench_command), 0.0);
    }
    if (!settings_.compensate_gravity) {
        std::fill(std::begin(sample_.torque_offset), std::end(sample_.torque_offset), 0.0);
    } else if (measured.is_complete) {
        const robot::Joints torque = robot::gravity::gradient(measured.q, settings_.gravity);
        for (std::size_t i = 0; i < robot::DOF; ++i) {
            if (std::isfinite(torque[i])) { sample_.torque_offset[i] = torque[i]; }
        }
    }
    const bool had_fault = snapshot_.report.fault != robot::NO_FAULT;
    const robot::Refusal before = robot::refusal_of(snapshot_.report);
    static_cast<void>(impedance_.step(sample_, snapshot_.report)); // an error lowers the torque; the status has it
    snapshot_.faults += !had_fault && snapshot_.report.fault != robot::NO_FAULT;
    note_refusal(before);
    snapshot_.reading = measured.reading; // for the topics: the springs need no measured wrench
    return snapshot_.report;
}

void Law::reset() { static_cast<void>(impedance_.reset()); }

} // namespace stiffgen_ros2
