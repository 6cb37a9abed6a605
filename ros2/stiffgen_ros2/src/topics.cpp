// SPDX-License-Identifier: MIT
#include "topics.hpp"

#include <algorithm>
#include <cmath>

namespace stiffgen_ros2 {

namespace {

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

bool finite(const double *values, std::size_t count)
{
    return std::all_of(values, values + count, [](double each) { return std::isfinite(each); });
}

} // namespace

Topics::Topics(rclcpp_lifecycle::LifecycleNode &node, const Setup &setup, Commands &commands, const std::atomic<double> &time)
    : node_(node), setup_(setup), commands_(commands), time_(time)
{
}

void Topics::subscribe()
{
    subscribe("~/target_pose", pose_, &Topics::target_pose);
    subscribe("~/target_joint", joint_, &Topics::target_joint);
    subscribe("~/target_wrench", wrench_, &Topics::target_wrench);
    subscribe("~/stiffness", stiffness_, &Topics::stiffness);
}

void Topics::change(const Settings &settings)
{
    const std::lock_guard<std::mutex> lock(mutex_);
    settings_ = settings;
}

template <class Message> void Topics::subscribe(const char *topic, std::shared_ptr<rclcpp::Subscription<Message>> &subscription,
    std::string (Topics::*convert)(const Message &, Command &))
{
    subscription = node_.create_subscription<Message>(topic, rclcpp::QoS(10), [weak = weak_from_this(), topic, convert, &subscription](const Message &message) {
        const auto self = weak.lock();
        if (!self || !self->is_active_) { return; }
        const std::lock_guard<std::mutex> lock(self->mutex_);
        Command command{};
        command.time = self->time_.load();
        std::string reason = subscription->get_publisher_count() > 1
            ? "it has several publishers, whose commands would alternate; keep one"
            : ((*self).*convert)(message, command);
        if (reason.empty() && !self->commands_.push(command)) { reason = "the loop takes no commands"; }
        self->tell(topic, reason);
    });
}

// Log a topic's reason once, until another one comes or a message of this topic is accepted.
void Topics::tell(const char *topic, const std::string &reason)
{
    const std::string line = reason.empty() ? "" : std::string(topic) + " is refused: " + reason;
    std::string &told = told_[topic];
    if (line != told && !line.empty()) { RCLCPP_WARN(node_.get_logger(), "%s", line.c_str()); }
    told = line;
}

std::string Topics::check_header(const std_msgs::msg::Header &header, Command &command) const
{
    if (header.frame_id != setup_.base_frame) {
        return "its frame_id is '" + header.frame_id + "', and must be '" + setup_.base_frame + "', the robot's base";
    }
    // A stamp of zero means now; a stamp counts by its age, since the loop has a clock of its own.
    const bool has_stamp = header.stamp.sec != 0 || header.stamp.nanosec != 0;
    const double stamp = header.stamp.sec + 1e-9 * header.stamp.nanosec;
    command.age = has_stamp ? node_.now().seconds() - stamp : 0.0;
    return "";
}

std::string Topics::target_pose(const geometry_msgs::msg::PoseStamped &message, Command &command)
{
    command.kind = Command::POSE;
    if (is_chained_) { return CHAINED; }
    const auto &p = message.pose.position;
    const double position[3] = {p.x, p.y, p.z};
    if (!finite(position, 3)) { return "its position is not finite"; }
    if (!rotation(message.pose.orientation, command.values)) { return "its quaternion does not have the norm 1"; }
    for (int i = 0; i < 3; ++i) { command.values[4 * i + 3] = position[i]; }
    command.values[15] = 1.0;
    const std::string reason = check_header(message.header, command);
    return reason.empty() ? refuse_pose(settings_.config, command.values) : reason;
}

std::string Topics::target_joint(const sensor_msgs::msg::JointState &message, Command &command)
{
    command.kind = Command::JOINTS;
    if (is_chained_) { return CHAINED; }
    if (message.name.size() != message.position.size()) { return "it has not as many positions as names"; }
    for (std::size_t i = 0; i < robot::DOF; ++i) {
        const auto found = std::find(message.name.begin(), message.name.end(), setup_.joints[i]);
        if (found == message.name.end()) { return "joint '" + setup_.joints[i] + "' is missing"; }
        command.values[i] = message.position[static_cast<std::size_t>(found - message.name.begin())];
        if (!std::isfinite(command.values[i])) { return "the position of '" + setup_.joints[i] + "' is not finite"; }
    }
    return refuse_positions(settings_.config, command.values);
}

std::string Topics::target_wrench(const geometry_msgs::msg::WrenchStamped &message, Command &command)
{
    command.kind = Command::WRENCH;
    const auto &f = message.wrench.force, &m = message.wrench.torque;
    const double wrench[6] = {f.x, f.y, f.z, m.x, m.y, m.z};
    std::copy(wrench, wrench + 6, command.values);
    const double *most = settings_.config.heaviest_wrench;
    if (!finite(wrench, 6) || std::hypot(f.x, f.y, f.z) > most[0] || std::hypot(m.x, m.y, m.z) > most[1]) {
        return "it is not finite, or larger than heaviest_wrench";
    }
    return check_header(message.header, command);
}

std::string Topics::stiffness(const std_msgs::msg::Float64MultiArray &message, Command &command)
{
    command.kind = Command::STIFFNESS;
    if (message.data.size() != 36) { return "it has " + std::to_string(message.data.size()) + " numbers instead of 36"; }
    std::copy(message.data.begin(), message.data.end(), command.values);
    return refuse_stiffness(settings_.config, command.values);
}

} // namespace stiffgen_ros2
