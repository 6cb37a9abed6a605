// SPDX-License-Identifier: MIT
#include "report.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>

namespace stiffgen_ros2 {

namespace {

constexpr unsigned MANY = 100; // updates

std::string number(double value)
{
    char text[32];
    std::snprintf(text, sizeof text, "%.6g", value);
    return text;
}

// Return the names of the bits that are set.
template <class Names> std::string status_words(unsigned status, const Names &names)
{
    std::string words;
    for (const auto &each : names) {
        if ((status & each.bit) != 0) { words += (words.empty() ? "" : " ") + std::string(each.name); }
    }
    return words;
}

std::string refusal_text(const Snapshot &last)
{
    return last.refused_part != 0 ? robot::refused_text(last.refused_part) : robot::refusal_text(last.refused);
}

// Quaternion of a rotation (rows of a 4 x 4 pose), from its largest component.
geometry_msgs::msg::Quaternion quaternion(const double *R)
{
    const double xx = R[0], yy = R[5], zz = R[10];
    // four times the squares of x, y, z, w
    const double squares[4] = {1.0 + xx - yy - zz, 1.0 - xx + yy - zz, 1.0 - xx - yy + zz, 1.0 + xx + yy + zz};
    int largest = 0;
    for (int k = 1; k < 4; ++k) { largest = squares[k] > squares[largest] ? k : largest; }
    // r: twice the largest component; the others are sums of entries over 2 r
    const double r = std::sqrt(std::fmax(squares[largest], 0.0)), s = r > 0.0 ? 0.5 / r : 0.0;
    const double xy = s * (R[1] + R[4]), xz = s * (R[2] + R[8]), yz = s * (R[6] + R[9]);
    const double wx = s * (R[9] - R[6]), wy = s * (R[2] - R[8]), wz = s * (R[4] - R[1]), own = 0.5 * r;
    const double found[4][4] = {{own, xy, xz, wx}, {xy, own, yz, wy}, {xz, yz, own, wz}, {wx, wy, wz, own}};
    geometry_msgs::msg::Quaternion q;
    q.x = found[largest][0];
    q.y = found[largest][1];
    q.z = found[largest][2];
    q.w = found[largest][3];
    return q;
}

void fill(const double *pose, geometry_msgs::msg::Pose &message)
{
    message.position.x = pose[3];
    message.position.y = pose[7];
    message.position.z = pose[11];
    message.orientation = quaternion(pose);
}

// The reaction to a wrench that is applied to the robot.
void fill_opposite(const double *applied, geometry_msgs::msg::Wrench &message)
{
    message.force.x = -applied[0];
    message.force.y = -applied[1];
    message.force.z = -applied[2];
    message.torque.x = -applied[3];
    message.torque.y = -applied[4];
    message.torque.z = -applied[5];
}

} // namespace

Report::Report(rclcpp_lifecycle::LifecycleNode &node, const Setup &setup, Latest<Snapshot> &snapshots, std::atomic<bool> &reset)
    : node_(node), setup_(setup), snapshots_(snapshots), wants_reset_(reset)
{
}

// Create publishers, the reset service, and the timer that publishes at state_rate [Hz].
void Report::start()
{
    using Trigger = std_srvs::srv::Trigger;
    const auto weak = weak_from_this();
    pose_ = node_.create_publisher<geometry_msgs::msg::PoseStamped>("~/pose", rclcpp::QoS(1));
    equilibrium_ = node_.create_publisher<geometry_msgs::msg::PoseStamped>("~/equilibrium", rclcpp::QoS(1));
    wrench_ = node_.create_publisher<geometry_msgs::msg::WrenchStamped>("~/wrench", rclcpp::QoS(1));
    state_ = node_.create_publisher<diagnostic_msgs::msg::DiagnosticStatus>("~/state", rclcpp::QoS(1));
    pose_->on_activate(); // the node's own transition does not reach the publishers of a controller
    equilibrium_->on_activate();
    wrench_->on_activate();
    if (!setup_.ft_sensor.empty()) {
        measured_wrench_ = node_.create_publisher<geometry_msgs::msg::WrenchStamped>("~/measured_wrench", rclcpp::QoS(1));
        measured_wrench_->on_activate();
    }
    state_->on_activate();
    reset_ = node_.create_service<Trigger>(
        "~/reset", [weak](const std::shared_ptr<Trigger::Request>, std::shared_ptr<Trigger::Response> response) {
            const auto self = weak.lock();
            response->success = self != nullptr;
            if (!self) { return; }
            const robot::Report &report = self->last_.report;
            self->wants_reset_ = true;
            response->message = report.fault == robot::NO_FAULT ? "no fault was latched" : "reset of: " + robot::fault_text(report);
        });
    timer_ = node_.create_wall_timer(std::chrono::duration<double>(1.0 / setup_.state_rate), [weak] {
        if (const auto self = weak.lock()) { self->publish(); }
    });
}

// Log a new fault, and a new refusal, once.
void Report::tell_changes()
{
    if (last_.activation != activation_) { // the counts began again, maybe between two calls
        activation_ = last_.activation;
        told_faults_ = told_refusals_ = told_restarts_ = 0;
    }
    if (last_.faults > told_faults_) {
        RCLCPP_ERROR(node_.get_logger(), "fault: %s; find the cause, then call ~/reset", robot::fault_text(last_.report).c_str());
    }
    if (last_.refusals > told_refusals_) {
        RCLCPP_WARN(node_.get_logger(), "commands refused: %u; the last one: %s", last_.refusals - told_refusals_,
            refusal_text(last_).c_str());
    }
    if (last_.restarts > told_restarts_) {
        RCLCPP_INFO(node_.get_logger(), "restarted with another configuration, from the torque in force; energy supplied counts anew");
    }
    const bool late = last_.late >= MANY;
    if (late && !told_late_) {
        RCLCPP_WARN(node_.get_logger(), "%u updates in a row came too late: the manager does not keep its update_rate", last_.late);
    }
    told_late_ = late;
    told_faults_ = last_.faults;
    told_refusals_ = last_.refusals;
    told_restarts_ = last_.restarts;
}

// Return the state in words and numbers: fault, error of the tip, energies, refusals.
diagnostic_msgs::msg::DiagnosticStatus Report::status() const
{
    diagnostic_msgs::msg::DiagnosticStatus status;
    const robot::Report &report = last_.report;
    const bool has_fault = report.fault != robot::NO_FAULT;
    const robot::Array<4, 4> pose = robot::forward_kinematics(report.position), rest = robot::forward_kinematics(report.reference);
    // [m] from the tip to where the springs are at rest
    const double error = std::hypot(pose[3] - rest[3], pose[7] - rest[7], pose[11] - rest[11]);
    status.name = node_.get_name();
    status.hardware_id = robot::TIP_FRAME;
    status.level = has_fault ? diagnostic_msgs::msg::DiagnosticStatus::ERROR : diagnostic_msgs::msg::DiagnosticStatus::OK;
    status.message = has_fault ? robot::fault_text(report) : last_.is_active ? "active" : "inactive";
    const std::pair<const char *, std::string> values[] = {
        {"status", status_words(report.status, robot::STATUS_NAMES)},
        {"target pose", status_words(last_.follow, robot::FOLLOW_NAMES)},
        {"error [m]", number(error)},
        {"energy supplied [J]", number(report.energy_supplied)},
        {"energy stored [J]", number(report.stored)},
        {"tank [J]", number(report.tank)},
        {"reserve [J]", number(report.reserve)},
        {"stiffness share", number(report.stiffness_share)},
        {"settle", status_words(last_.settle, robot::SETTLE_NAMES)},
        {"press", robot::STAGE_NAMES[last_.stage]},
        {"restarts", std::to_string(last_.restarts)},
        {"faults", std::to_string(last_.faults)},
        {"commands refused", std::to_string(last_.refusals)},
        {"last refusal", last_.refusals > 0 ? refusal_text(last_) : ""},
    };
    for (const auto &each : values) {
        diagnostic_msgs::msg::KeyValue value;
        value.key = each.first;
        value.value = each.second;
        status.values.push_back(value);
    }
    return status;
}

// Publish what the sensor measures at the tip, as the tip exerts it; while there is no reading, nothing.
void Report::publish_measured(geometry_msgs::msg::WrenchStamped message)
{
#if STIFFGEN_ROS2_SENSOR
    const robot::Wrench applied = robot::tip_wrench(last_.report.position, last_.reading, setup_.calibration);
    if (measured_wrench_ && std::all_of(applied.begin(), applied.end(), [](double each) { return std::isfinite(each); })) {
        fill_opposite(applied.data(), message.wrench);
        measured_wrench_->publish(message);
    }
#else
    static_cast<void>(message);
#endif
}

// Publish the newest snapshot, if there is one: poses, wrenches, state.
void Report::publish()
{
    if (!snapshots_.read(last_)) { return; }
    tell_changes();
    geometry_msgs::msg::PoseStamped pose;
    pose.header.stamp = node_.now();
    pose.header.frame_id = setup_.base_frame;
    fill(robot::forward_kinematics(last_.report.position).data(), pose.pose);
    pose_->publish(pose);
    const robot::Array<4, 4> rest = robot::forward_kinematics(last_.report.reference);
    fill(rest.data(), pose.pose);
    equilibrium_->publish(pose);

    // The springs' wrench on the environment: the negative of what the environment applies at rest.
    geometry_msgs::msg::WrenchStamped wrench;
    wrench.header = pose.header;
    robot::Wrench applied = robot::spring::wrench(last_.report.position, rest, last_.translation_stiffness, last_.rotation_stiffness);
    for (double &each : applied) { each *= last_.report.scale; }
    fill_opposite(applied.data(), wrench.wrench);
    wrench_->publish(wrench);
    publish_measured(wrench);

    state_->publish(status());
}

} // namespace stiffgen_ros2
