// SPDX-License-Identifier: MIT
// The controller between measured state and torque, without ROS: commands, counter, gravity, fault and reset.
#pragma once

#include "robot.hpp"
#include "settings.hpp"

#include <cstdint>

namespace stiffgen_ros2 {

/// Command from a topic; which numbers it has depends on its kind.
struct Command {
    enum Kind { JOINTS, POSE, WRENCH, STIFFNESS } kind;
    double age; ///< [s] age at the time below
    double time; ///< [s] loop's time when the command arrived
    std::uint64_t order; ///< of a stiffness, as in the settings
    double values[36]; ///< q0 (n), pose (4 x 4), wrench (6), or stiffness (6 x 6)
};

static_assert(robot::DOF <= 36, "a command has room for 36 joints");

/// What one update leaves for the other threads.
struct Snapshot {
    robot::Report report;
    double time; ///< [s] loop's time
    unsigned activation; ///< number of the activation, from 1
    unsigned faults; ///< faults since the activation
    unsigned refusals; ///< commands that the policy port or the controller refused since the activation
    int reason; ///< reason of the policy port for the newest of them, or none
    robot::Refusal refusal; ///< numbers of the newest of them, if it has any
    robot::Wrench reading; ///< of the force-torque sensor
    bool is_active;
};

/// Measured state of one update.
struct Measured {
    robot::Joints q, dq; ///< [rad or m], [rad/s or m/s]
    bool is_complete; ///< false: an interface could not be read, and the sample counts as missed
    robot::Wrench reading{}; ///< of the force-torque sensor, in its axes; NaN while it cannot be read
};

class Law {
public:
    /// Start at rest at q from a torque in force. Return an error of the controller's init.
    int start(const Settings &settings, bool policy, const robot::Joints &q, const robot::Joints &torque);

    /// Use other settings from the next step on.
    void change(const Settings &settings);

    /// Use a command from the next step on.
    void command(const Command &command);

    /// Command joint positions that another controller writes; NaN keeps the last ones.
    void follow(const double *q0);

    /// Do one step, `period` seconds after the last one. The torque is finite and within its limits.
    const robot::Report &step(const Measured &measured, double period);

    void reset();

    const Snapshot &snapshot() const { return snapshot_; }
    double time() const { return snapshot_.time; }

private:
    void propose(const Command &command);
    void note_refusal(const robot::Refusal &before);
    void command_at_once(const Command &command);
    Assigned take_stiffness(const double *stiffness, std::uint64_t translation_order, std::uint64_t rotation_order);
    void use_stiffness();

    Settings settings_{};
    robot::Impedance impedance_;
    robot::Sample sample_{};
    robot::Policy port_{};
    Snapshot snapshot_{};
    double stiffness_[36] = {}; // newest of parameters and commands, 6 x 6
    std::uint64_t translation_order_ = 0, rotation_order_ = 0; // of its blocks
    double wrench_end_ = 0.0;
    bool uses_port_ = false, has_proposal_ = false, has_stiffness_ = false;
};

} // namespace stiffgen_ros2
