// SPDX-License-Identifier: MIT
#include "topics.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace stiffgen_ros2 {

namespace {

constexpr double LARGEST_LEAD = 0.1; // [s] of another computer's clock
constexpr const char *CHAINED = "another controller writes the references (chained mode); deactivate it first";

// Rotation (rows of 4 x 4) of a quaternion whose norm is 1 up to rounding. Return false for any other.
bool rotation(const geometry_msgs::msg::Quaternion &q, double *pose)
{
    const double norm = std::sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w);
    if (!(std::abs(norm - 1.0) < 1e-2)) { return false; }
    const double x = q.x / norm, y = q.y / norm, z = q.z / norm, w = q.w / norm;
    const double rows[3][3] = {
        {1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)},
        {2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)},
        {2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)},
    };
    for (int i = 0; i < 3; ++i) { std::copy(rows[i], rows[i] + 3, pose + 4 * i); }
    return true;
}

} // namespace

Topics::Topics(rclcpp_lifecycle::LifecycleNode &node, const Setup &setup, Commands &commands, const std::atomic<double> &time)
    : node_(node), setup_(setup), commands_(commands), time_(time)
{
}

// Subscribe to all command topics.
void Topics::subscribe()
{
    subscribe("~/target_pose", pose_, &Topics::target_pose);
    subscribe("~/target_joint", joint_, &Topics::target_joint);
    subscribe("~/target_wrench", wrench_, &Topics::target_wrench);
    subscribe("~/stiffness", stiffness_, &Topics::stiffness);
    subscribe("~/settle", settle_, &Topics::settle);
    subscribe("~/press", press_, &Topics::press);
}

void Topics::change(const Settings &settings)
{
    const std::lock_guard<std::mutex> lock(mutex_);
    settings_ = settings;
}

// Command the settings' stiffness, the given blocks of it; false if the loop takes no commands.
bool Topics::command_stiffness(const Settings &settings, const Blocks &blocks)
{
    const std::lock_guard<std::mutex> lock(mutex_);
    Command command{};
    command.kind = Command::STIFFNESS;
    command.time = time_.load();
    command.is_parameter = true;
    command.blocks = blocks;
    std::copy(settings.translation_stiffness.begin(), settings.translation_stiffness.end(), command.values);
    std::copy(settings.rotation_stiffness.begin(), settings.rotation_stiffness.end(), command.values + 9);
    return !is_active_ || commands_.push(command); // an activation begins with the settings
}

// Subscribe to one topic: convert a message into a command, queue it, and tell the sender why if it is refused.
template <class Message> void Topics::subscribe(const char *topic, std::shared_ptr<rclcpp::Subscription<Message>> &subscription,
    std::string (Topics::*convert)(const Message &, Command &))
{
    const auto receive = [weak = weak_from_this(), topic, convert, &subscription](const Message &message) {
        const auto self = weak.lock();
        if (!self || !self->is_active_) { return; }
        const std::lock_guard<std::mutex> lock(self->mutex_);
        Command command{};
        command.time = self->time_.load();
        const bool is_alone = subscription->get_publisher_count() <= 1;
        std::string reason = "it has several publishers, whose commands would alternate; keep one";
        if (is_alone) { reason = ((*self).*convert)(message, command); }
        if (reason.empty() && !self->commands_.push(command)) { reason = "the loop takes no commands"; }
        self->tell(topic, reason);
    };
    subscription = node_.create_subscription<Message>(topic, rclcpp::QoS(10), receive);
}

// Log a topic's reason once, until another one comes or a message of this topic is accepted.
void Topics::tell(const char *topic, const std::string &reason)
{
    const std::string line = reason.empty() ? "" : std::string(topic) + " is refused: " + reason;
    std::string &told = told_[topic];
    if (line != told && !line.empty()) { RCLCPP_WARN(node_.get_logger(), "%s", line.c_str()); }
    told = line;
}

std::string Topics::check_frame(const std_msgs::msg::Header &header) const
{
    if (header.frame_id == setup_.base_frame) { return ""; }
    return "its frame_id is '" + header.frame_id + "', and must be '" + setup_.base_frame + "', the robot's base";
}

// A stamp of zero means now. Any other one counts by its age, since the loop has a clock of its own; a lead counts as age 0.
std::string Topics::check_stamp(const builtin_interfaces::msg::Time &stamp, const char *limit, double most, Command &command) const
{
    const bool has_stamp = stamp.sec != 0 || stamp.nanosec != 0;
    const double age = has_stamp ? node_.now().seconds() - (stamp.sec + 1e-9 * stamp.nanosec) : 0.0;
    command.age = std::max(age, 0.0);
    char text[200] = "";
    if (age < -LARGEST_LEAD) {
        std::snprintf(text, sizeof text,
            "its stamp lies %g s ahead of this node's clock; give both nodes the same clock (use_sim_time), or stamp with 0", -age);
    } else if (age >= most) {
        std::snprintf(text, sizeof text, "its stamp is %.6g s old, and %s is %g s; stamp a command when it is sent", age, limit, most);
    }
    return text;
}

// Convert a pose; return why it is refused, "" if it is not.
std::string Topics::target_pose(const geometry_msgs::msg::PoseStamped &message, Command &command)
{
    command.kind = Command::POSE;
    if (is_chained_) { return CHAINED; }
    const auto &p = message.pose.position;
    const double position[3] = {p.x, p.y, p.z};
    if (!finite(position, 3)) { return "its position is not finite"; }
    if (!rotation(message.pose.orientation, command.values)) { return "its quaternion does not have the norm 1"; }
    if (std::hypot(p.x, p.y, p.z) > robot::reach()) { return "its position is beyond the arm's reach; give metres"; }
    for (int i = 0; i < 3; ++i) { command.values[4 * i + 3] = position[i]; }
    command.values[15] = 1.0;
    const std::string reason = check_frame(message.header);
    return reason.empty() ? check_stamp(message.header.stamp, "target_timeout", settings_.target_timeout, command) : reason;
}

// Convert joint positions, in any order of names; return why they are refused, "" if they are not.
std::string Topics::target_joint(const sensor_msgs::msg::JointState &message, Command &command)
{
    command.kind = Command::JOINTS;
    if (is_chained_) { return CHAINED; }
    if (message.name.size() != message.position.size()) { return "it has not as many positions as names"; }
    for (std::size_t i = 0; i < robot::DOF; ++i) {
        const auto found = std::find(message.name.begin(), message.name.end(), setup_.joints[i]);
        if (found == message.name.end()) { return "joint '" + setup_.joints[i] + "' is missing"; }
        if (std::find(found + 1, message.name.end(), *found) != message.name.end()) { return "joint '" + *found + "' is given twice"; }
        command.values[i] = message.position[static_cast<std::size_t>(found - message.name.begin())];
        if (!std::isfinite(command.values[i])) { return "the position of '" + setup_.joints[i] + "' is not finite"; }
    }
    robot::Sample wanted = command_of(settings_);
    std::copy(command.values, command.values + robot::DOF, wanted.q0);
    const std::string reason = check_stamp(message.header.stamp, "target_timeout", settings_.target_timeout, command);
    return reason.empty() ? refuse(settings_.config, wanted) : reason;
}

// Convert a wrench in base axes; return why it is refused, "" if it is not.
std::string Topics::target_wrench(const geometry_msgs::msg::WrenchStamped &message, Command &command)
{
    command.kind = Command::WRENCH;
    const auto &f = message.wrench.force, &m = message.wrench.torque;
    const double wrench[6] = {f.x, f.y, f.z, m.x, m.y, m.z};
    std::copy(wrench, wrench + 6, command.values);
    std::string reason = check_frame(message.header);
    if (reason.empty()) { reason = check_stamp(message.header.stamp, "wrench_timeout", settings_.wrench_timeout, command); }
    robot::Sample wanted = command_of(settings_);
    std::copy(wrench, wrench + 6, wanted.wrench_command);
    return reason.empty() ? refuse(settings_.config, wanted) : reason;
}

// Convert a stiffness, 36 numbers row by row; return why it is refused, "" if it is not.
std::string Topics::stiffness(const std_msgs::msg::Float64MultiArray &message, Command &command)
{
    command.kind = Command::STIFFNESS;
    command.blocks = {true, true};
    if (message.data.size() != 36) { return "it has " + std::to_string(message.data.size()) + " numbers instead of 36"; }
    for (std::size_t row = 0; row < 6; ++row) { // a row has entries of translation, then of rotation
        const double *const translation = message.data.data() + 6 * row, *const rotation = translation + 3;
        const bool is_of_translation = row < 3;
        const double *const own = is_of_translation ? translation : rotation, *const other = is_of_translation ? rotation : translation;
        if (std::any_of(other, other + 3, [](double each) { return each != 0.0; })) {
            return "the springs do not couple translation and rotation: the blocks beside the diagonal must be 0";
        }
        std::copy(own, own + 3, command.values + 3 * row);
    }
    robot::Sample wanted = command_of(settings_);
    std::copy(command.values, command.values + 9, wanted.translation_stiffness);
    std::copy(command.values + 9, command.values + 18, wanted.rotation_stiffness);
    return refuse(settings_.config, wanted);
}

// Largest force and moment that the offset may add; 0, 0 ends it.
std::string Topics::settle(const std_msgs::msg::Float64MultiArray &message, Command &command)
{
    command.kind = Command::SETTLE;
    if (is_chained_) { return CHAINED; }
    if (message.data.size() != 2) { return "it has " + std::to_string(message.data.size()) + " numbers instead of settle_force's two"; }
    std::copy(message.data.begin(), message.data.end(), command.values);
    robot::Settle scratch{};
    const int error = robot::start(scratch, settings_.config, command.values);
    return error == robot::GOOD ? "" : robot::settle_text(error);
}

// Force that the tip is to exert; 0 ends it. The sensor's wrench closes the loop.
std::string Topics::press(const geometry_msgs::msg::WrenchStamped &message, Command &command)
{
    command.kind = Command::PRESS;
    if (is_chained_) { return CHAINED; }
    if (setup_.ft_sensor.empty()) { return "it needs a force sensor: set ft_sensor; friction makes motor torques none (1.4 to 12.7 N off on a UR5)"; }
    const auto &f = message.wrench.force, &m = message.wrench.torque;
    const double force[3] = {f.x, f.y, f.z}, most = 0.5 * settings_.config.heaviest_wrench[0];
    if (!finite(force, 3)) { return "its force is not finite"; }
    if (m.x != 0.0 || m.y != 0.0 || m.z != 0.0) { return "it takes a force alone: its torque must be 0"; }
    char text[80];
    std::snprintf(text, sizeof text, "its force is above half of heaviest_wrench, %g N", most);
    if (std::hypot(f.x, f.y, f.z) > most) { return text; }
    std::copy(force, force + 3, command.values);
    const std::string reason = check_frame(message.header);
    return reason.empty() ? check_stamp(message.header.stamp, "target_timeout", settings_.target_timeout, command) : reason;
}

} // namespace stiffgen_ros2
