// SPDX-License-Identifier: MIT
// Stub of diagnostic_updater for tests: README.md. As the real one, it declares its period and names a task after its node.
#pragma once

#include "diagnostic_msgs/msg/diagnostic_array.hpp"
#include "rclcpp_lifecycle/lifecycle_node.hpp"

#include <chrono>
#include <functional>
#include <memory>
#include <string>
#include <utility>

namespace diagnostic_updater {

struct DiagnosticStatusWrapper : diagnostic_msgs::msg::DiagnosticStatus {
    void summary(unsigned char level_now, const std::string &message_now)
    {
        level = level_now;
        message = message_now;
    }
};

class Updater {
public:
    template <class Node> explicit Updater(Node node) : name_(node->get_name())
    {
        const double period = node->declare_parameter("diagnostic_updater.period", 1.0);
        publisher_ = node->template create_publisher<diagnostic_msgs::msg::DiagnosticArray>("/diagnostics", rclcpp::QoS(1));
        publisher_->on_activate(); // the real one is no lifecycle publisher
        timer_ = node->create_wall_timer(std::chrono::duration<double>(period), [this] { update(); });
    }
    void setHardwareID(const std::string &id) { id_ = id; }
    void add(const std::string &task, std::function<void(DiagnosticStatusWrapper &)> run)
    {
        task_ = task;
        run_ = std::move(run);
    }

private:
    void update()
    {
        DiagnosticStatusWrapper status;
        status.name = name_ + ": " + task_;
        status.hardware_id = id_;
        run_(status);
        diagnostic_msgs::msg::DiagnosticArray array;
        array.status.push_back(status);
        publisher_->publish(array);
    }

    std::string name_, id_, task_;
    std::function<void(DiagnosticStatusWrapper &)> run_;
    rclcpp_lifecycle::LifecyclePublisher<diagnostic_msgs::msg::DiagnosticArray>::SharedPtr publisher_;
    rclcpp::TimerBase::SharedPtr timer_;
};

} // namespace diagnostic_updater
