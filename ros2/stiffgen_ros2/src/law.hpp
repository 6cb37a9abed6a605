// SPDX-License-Identifier: MIT
// The controller between measured state and torque, without ROS: commands, counter, gravity, fault, restart and reset.
#pragma once

#include "robot.hpp"
#include "settings.hpp"

namespace stiffgen_ros2 {

/// Command from a topic or a parameter; which numbers it has depends on its kind.
struct Command {
    enum Kind { JOINTS, POSE, WRENCH, STIFFNESS, SETTLE, PRESS } kind;
    double age; ///< [s] age at the time below
    double time; ///< [s] loop's time when the command arrived
    bool is_parameter; ///< a stiffness from the parameters
    Blocks blocks; ///< of a stiffness
    double values[40]; ///< q0 (n), pose (4 x 4), wrench (6), stiffness (3 x 3, 3 x 3), settle_force (2), force to press with (3)
};

static_assert(robot::DOF <= 40, "a command has room for 40 joints");

/// What one update leaves for the other threads.
struct Snapshot {
    robot::Report report;
    double translation_stiffness[9], rotation_stiffness[9]; ///< commanded
    double time; ///< [s] loop's time
    unsigned follow; ///< status of Follow; 0 while no pose is commanded
    unsigned settle; ///< status of Settle; 0 while it is off
    int stage; ///< of Press
    unsigned activation; ///< number of the activation, from 1
    unsigned faults; ///< faults since the activation
    unsigned late; ///< updates in a row that came by a sample time or more too late
    unsigned restarts; ///< restarts with another configuration since the activation
    unsigned refusals; ///< commands that the controller or the policy port refused since the activation
    robot::Report refused; ///< newest of them, of the controller
    int refused_part; ///< newest of them, of the policy port; 0: of the controller
    robot::Wrench reading; ///< of the force-torque sensor
    bool is_active;
};

/// Measured state of one update.
struct Measured {
    robot::Joints q, dq; ///< [rad or m], [rad/s or m/s]; dq counts if there is a velocity interface
    bool is_complete; ///< false: an interface could not be read, and the sample counts as missed
    robot::Wrench reading{}; ///< of the force-torque sensor, in its axes; NaN while it cannot be read
    robot::Wrench wrench{}; ///< of the environment at the tip, base axes, by that sensor; 0 without one
};

class Law {
public:
    /// Start at rest at q from a torque in force. Return an error of the controller's init.
    int start(const Settings &settings, bool policy, const robot::Joints &q, const robot::Joints &torque);

    /// Use other settings from the next step on; another configuration once no fault is latched.
    void change(const Settings &settings);

    /// Use a command from the next step on.
    void command(const Command &command);

    /// Command joint positions that another controller writes; NaN keeps the last ones.
    void refer(const double *q0);

    /// Do one step, `period` seconds after the last one. The torque is finite and within its limits.
    const robot::Report &step(const Measured &measured, double period);

    void reset();

    const Snapshot &snapshot() const { return snapshot_; }
    double time() const { return snapshot_.time; }

private:
    int restart();
    void forget_commands();
    robot::Proposal proposal_of(const Command &command) const;
    void propose(const Command &command);
    void go_to_joints(const double *q0);
    void go_to_pose(const double *pose);
    void settle(const double *force);
    void press(const double *f);
    void hold_here();
    void use_commands();
    void take_sample(const Measured &measured, double samples);
    void follow_pose(const robot::Wrench &wrench);
    void move_pose(const robot::Wrench &wrench, robot::FollowInput &moved);
    void offset_gravity();
    void note(const robot::Report &before);

    Settings settings_{};
    bool wants_restart_ = false; // they have another configuration

    // What makes torques, in the order of a step: port, makers of a pose, follower, controller with its input.
    robot::Policy policy_{};
    robot::Settle settle_{};
    robot::SettleInput settled_{};
    robot::Press press_{};
    robot::PressInput pressed_{};
    robot::Follow follow_{};
    robot::Impedance impedance_{robot::Impedance::default_config()};
    robot::Sample sample_{};
    Snapshot snapshot_{};
    bool uses_policy_ = false, settles_ = false, presses_ = false, follows_ = false; // started

    // Commands in force.
    robot::FollowInput target_{}; // pose and posture
    bool wants_pose_ = false; // else sample_.q0 is commanded itself
    double stiffness_[18] = {}; // newest of parameters and commands: translation, then rotation
    double wrench_[6] = {}; // [N, N m]
    double wrench_end_ = 0.0; // [s] loop's time from which it counts as 0
    double settle_force_[2] = {}; // [N, N m] 0: Settle is off
    bool has_proposal_ = false, has_stiffness_ = false; // the port accepted one; stiffness_ is from a proposal

    robot::Joints last_q_{}; // of the last complete sample
    double age_ = 0.0; // [samples] of last_q_
};

} // namespace stiffgen_ros2
