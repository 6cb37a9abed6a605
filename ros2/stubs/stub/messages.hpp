// SPDX-License-Identifier: MIT
// Stub of the standard messages for tests: the fields that the package uses.
#pragma once

#include "rclcpp/time.hpp"

#include <memory>
#include <string>
#include <vector>

namespace std_msgs {
namespace msg {

struct Header {
    builtin_interfaces::msg::Time stamp;
    std::string frame_id;
};

struct Float64MultiArray {
    std::vector<double> data;
};

} // namespace msg
} // namespace std_msgs

namespace geometry_msgs {
namespace msg {

struct Point {
    double x = 0, y = 0, z = 0;
};

struct Vector3 {
    double x = 0, y = 0, z = 0;
};

struct Quaternion {
    double x = 0, y = 0, z = 0, w = 1;
};

struct Pose {
    Point position;
    Quaternion orientation;
};

struct Wrench {
    Vector3 force, torque;
};

struct PoseStamped {
    std_msgs::msg::Header header;
    Pose pose;
};

struct WrenchStamped {
    std_msgs::msg::Header header;
    Wrench wrench;
};

} // namespace msg
} // namespace geometry_msgs

namespace sensor_msgs {
namespace msg {

struct JointState {
    std_msgs::msg::Header header;
    std::vector<std::string> name;
    std::vector<double> position, velocity, effort;
};

} // namespace msg
} // namespace sensor_msgs

namespace diagnostic_msgs {
namespace msg {

struct KeyValue {
    std::string key, value;
};

struct DiagnosticStatus {
    static constexpr unsigned char OK = 0, WARN = 1, ERROR = 2, STALE = 3;
    unsigned char level = 0;
    std::string name, message, hardware_id;
    std::vector<KeyValue> values;
};

struct DiagnosticArray {
    std_msgs::msg::Header header;
    std::vector<DiagnosticStatus> status;
};

} // namespace msg
} // namespace diagnostic_msgs
