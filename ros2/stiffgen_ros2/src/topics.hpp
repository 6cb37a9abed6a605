// SPDX-License-Identifier: MIT
// Subscriptions of the controller: each message is checked, and refused with a sentence, before the loop sees it.
#pragma once

#include "law.hpp"

#include <geometry_msgs/msg/pose_stamped.hpp>
#include <geometry_msgs/msg/wrench_stamped.hpp>
#include <rclcpp/rclcpp.hpp>
#include <rclcpp_lifecycle/lifecycle_node.hpp>
#include <realtime_tools/lock_free_queue.hpp>
#include <sensor_msgs/msg/joint_state.hpp>
#include <std_msgs/msg/float64_multi_array.hpp>

#include <atomic>
#include <map>
#include <memory>
#include <mutex>
#include <string>

namespace stiffgen_ros2 {

using Commands = realtime_tools::LockFreeSPSCQueue<Command, 64>;

// Shared: a callback that another thread still runs keeps it alive.
class Topics : public std::enable_shared_from_this<Topics> {
public:
    Topics(rclcpp_lifecycle::LifecycleNode &node, const Setup &setup, Commands &commands, const std::atomic<double> &time);

    /// Begin to listen.
    void subscribe();

    /// Use other settings in the checks.
    void change(const Settings &settings);

    /// Command blocks of the settings' stiffness, in the order of the messages. Return false if the loop takes no commands.
    bool command_stiffness(const Settings &settings, const Blocks &blocks);

    /// Accept messages. In chained mode another controller writes the joint positions, and targets are refused.
    void accept(bool chained)
    {
        is_chained_ = chained;
        is_active_ = true;
    }

    /// Drop messages silently.
    void ignore() { is_active_ = false; }

private:
    template <class Message> void subscribe(const char *topic, std::shared_ptr<rclcpp::Subscription<Message>> &subscription,
        std::string (Topics::*convert)(const Message &, Command &));
    std::string target_pose(const geometry_msgs::msg::PoseStamped &message, Command &command);
    std::string target_joint(const sensor_msgs::msg::JointState &message, Command &command);
    std::string target_wrench(const geometry_msgs::msg::WrenchStamped &message, Command &command);
    std::string settle(const std_msgs::msg::Float64MultiArray &message, Command &command);
    std::string press(const geometry_msgs::msg::WrenchStamped &message, Command &command);
    std::string stiffness(const std_msgs::msg::Float64MultiArray &message, Command &command);
    std::string check_frame(const std_msgs::msg::Header &header) const;
    std::string check_stamp(const builtin_interfaces::msg::Time &stamp, const char *limit, double most, Command &command) const;
    void tell(const char *topic, const std::string &reason);

    rclcpp_lifecycle::LifecycleNode &node_;
    Setup setup_;
    Commands &commands_;
    const std::atomic<double> &time_;
    std::mutex mutex_; // of the threads that write commands; the loop never takes it
    Settings settings_{};
    std::atomic<bool> is_active_{false}, is_chained_{false};
    std::map<std::string, std::string> told_; // by topic
    std::shared_ptr<rclcpp::Subscription<geometry_msgs::msg::PoseStamped>> pose_;
    std::shared_ptr<rclcpp::Subscription<sensor_msgs::msg::JointState>> joint_;
    std::shared_ptr<rclcpp::Subscription<geometry_msgs::msg::WrenchStamped>> wrench_, press_;
    std::shared_ptr<rclcpp::Subscription<std_msgs::msg::Float64MultiArray>> stiffness_, settle_;
};

} // namespace stiffgen_ros2
