// SPDX-License-Identifier: MIT
// State topics and the log, written by a timer outside the loop.
#pragma once

#include "exchange.hpp"
#include "law.hpp"

#include <diagnostic_msgs/msg/diagnostic_status.hpp>
#include <geometry_msgs/msg/pose_stamped.hpp>
#include <geometry_msgs/msg/wrench_stamped.hpp>
#include <rclcpp/rclcpp.hpp>
#include <rclcpp_lifecycle/lifecycle_node.hpp>
#include <std_srvs/srv/trigger.hpp>

#include <atomic>
#include <memory>
#include <string>

namespace stiffgen_ros2 {

// Shared: a callback that another thread still runs keeps it alive.
class Report : public std::enable_shared_from_this<Report> {
public:
    Report(rclcpp_lifecycle::LifecycleNode &node, const Setup &setup, Latest<Snapshot> &snapshots, std::atomic<bool> &reset);

    /// Begin to publish, and offer the service.
    void start();

    /// Return fault, status, energies and refusals in words.
    diagnostic_msgs::msg::DiagnosticStatus status() const;

private:
    template <class Message> using Publisher = typename rclcpp_lifecycle::LifecyclePublisher<Message>::SharedPtr;

    void publish();
    void publish_measured(geometry_msgs::msg::WrenchStamped message);
    void tell_changes();

    rclcpp_lifecycle::LifecycleNode &node_;
    Setup setup_;
    Latest<Snapshot> &snapshots_;
    std::atomic<bool> &wants_reset_;
    Snapshot last_{};
    unsigned activation_ = 0, told_faults_ = 0, told_refusals_ = 0, told_restarts_ = 0;
    bool told_late_ = false;
    Publisher<geometry_msgs::msg::PoseStamped> pose_, equilibrium_;
    Publisher<geometry_msgs::msg::WrenchStamped> wrench_, measured_wrench_;
    Publisher<diagnostic_msgs::msg::DiagnosticStatus> state_;
    std::shared_ptr<rclcpp::Service<std_srvs::srv::Trigger>> reset_;
    rclcpp::TimerBase::SharedPtr timer_;
};

} // namespace stiffgen_ros2
