// SPDX-License-Identifier: MIT
// Parameters that change while the controller is configured: checked before they are set, used once they are set.
#pragma once

#include "exchange.hpp"
#include "settings.hpp"
#include "topics.hpp"

#include <rclcpp/version.h>
#include <rclcpp_lifecycle/lifecycle_node.hpp>

#include <memory>
#include <mutex>
#include <string>
#include <vector>

namespace stiffgen_ros2 {

// Shared: a callback that another thread still runs keeps it alive.
class Parameters : public std::enable_shared_from_this<Parameters> {
public:
    Parameters(rclcpp_lifecycle::LifecycleNode &node, double sample_time, std::shared_ptr<Topics> topics, Latest<Settings> &settings);

    /// Hand the settings of the configuration to topics and loop, and begin to watch the parameters.
    void start(const Settings &settings);

private:
    using Changes = std::vector<rclcpp::Parameter>;
    using Result = rcl_interfaces::msg::SetParametersResult;

    Result check(const Changes &changes);
    std::string refuse(const Changes &changes) const;
    void use(const Changes &changes);

    rclcpp_lifecycle::LifecycleNode &node_;
    double sample_time_;
    std::shared_ptr<Topics> topics_;
    Latest<Settings> &settings_;
    rclcpp::node_interfaces::OnSetParametersCallbackHandle::SharedPtr on_set_;
#if RCLCPP_VERSION_MAJOR < 21 // Humble calls nobody back once the values are set: a timer looks for them
    void look();

    std::mutex mutex_;
    Changes accepted_; // maybe not set yet
    rclcpp::TimerBase::SharedPtr timer_;
#else
    rclcpp::node_interfaces::PostSetParametersCallbackHandle::SharedPtr post_set_;
#endif
};

} // namespace stiffgen_ros2
