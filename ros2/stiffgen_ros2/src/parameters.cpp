// SPDX-License-Identifier: MIT
#include "parameters.hpp"

#include <algorithm>
#include <chrono>
#include <exception>
#include <utility>

namespace stiffgen_ros2 {

namespace {

bool has(const std::vector<rclcpp::Parameter> &changes, const char *name)
{
    return std::any_of(changes.begin(), changes.end(), [name](const auto &each) { return each.get_name() == name; });
}

bool has_ours(const std::vector<rclcpp::Parameter> &changes)
{
    return std::any_of(changes.begin(), changes.end(), [](const auto &each) { return is_ours(each.get_name()); });
}

Blocks assigned(const std::vector<rclcpp::Parameter> &changes)
{
    return {has(changes, "translation_stiffness"), has(changes, "rotation_stiffness")};
}

} // namespace

Parameters::Parameters(
    rclcpp_lifecycle::LifecycleNode &node, double sample_time, std::shared_ptr<Topics> topics, Latest<Settings> &settings)
    : node_(node), sample_time_(sample_time), topics_(std::move(topics)), settings_(settings)
{
}

// Put the settings in force, and check and use later changes of parameters.
void Parameters::start(const Settings &settings)
{
    topics_->change(settings);
    settings_.write(settings);
    const auto weak = weak_from_this();
    on_set_ = node_.add_on_set_parameters_callback([weak](const Changes &changes) {
        const auto self = weak.lock();
        Result unchecked;
        unchecked.successful = true;
        return self ? self->check(changes) : unchecked;
    });
#if RCLCPP_VERSION_MAJOR < 21
    timer_ = node_.create_wall_timer(std::chrono::milliseconds(20), [weak] {
        if (const auto self = weak.lock()) { self->look(); }
    });
#else
    post_set_ = node_.add_post_set_parameters_callback([weak](const Changes &changes) {
        if (const auto self = weak.lock()) { self->use(changes); }
    });
#endif
}

// Check a change as a whole. Nothing acts yet: another callback may still refuse the change.
Parameters::Result Parameters::check(const Changes &changes)
{
    Result result;
    try {
        result.reason = has_ours(changes) ? refuse(changes) : "";
    } catch (const std::exception &error) {
        result.reason = error.what();
    }
    result.successful = result.reason.empty();
#if RCLCPP_VERSION_MAJOR < 21
    if (result.successful) {
        const std::lock_guard<std::mutex> lock(mutex_);
        for (const auto &each : changes) {
            if (is_ours(each.get_name())) { accepted_.push_back(each); }
        }
    }
#endif
    return result;
}

// Return why changes are refused, "" if they are not.
std::string Parameters::refuse(const Changes &changes) const
{
    for (const auto &each : changes) {
        if (is_fixed(each.get_name())) { return "'" + each.get_name() + "' changes only while the controller is unconfigured"; }
    }
    const Lookup lookup = [this, &changes](const std::string &name) {
        const auto found = std::find_if(changes.rbegin(), changes.rend(), [&name](const auto &each) { return each.get_name() == name; });
        return found != changes.rend() ? *found : node_.get_parameter(name); // of two values the last one will be set
    };
    Settings settings{};
    return read_settings(lookup, sample_time_, settings);
}

// Hand parameters that have been set to topics and loop.
void Parameters::use(const Changes &changes)
{
    if (!has_ours(changes)) { return; }
    Settings settings{};
    std::string reason;
    try {
        reason = read_settings([this](const std::string &name) { return node_.get_parameter(name); }, sample_time_, settings);
    } catch (const std::exception &error) {
        reason = error.what();
    }
    if (!reason.empty()) {
        RCLCPP_ERROR(node_.get_logger(), "the parameters do not act: %s", reason.c_str());
        return;
    }
    topics_->change(settings);
    settings_.write(settings);
    const Blocks blocks = assigned(changes);
    if ((blocks.translation || blocks.rotation) && !topics_->command_stiffness(settings, blocks)) {
        RCLCPP_ERROR(node_.get_logger(), "the stiffness does not act: the loop takes no commands");
    }
}

#if RCLCPP_VERSION_MAJOR < 21
// Use accepted changes once the node has them: older distributions tell of changes before they are made.
void Parameters::look()
{
    Changes changes;
    {
        const std::lock_guard<std::mutex> lock(mutex_);
        changes.swap(accepted_);
    }
    const auto is_other = [this](const auto &each) { return !(node_.get_parameter(each.get_name()) == each); };
    changes.erase(std::remove_if(changes.begin(), changes.end(), is_other), changes.end());
    use(changes);
}
#endif

} // namespace stiffgen_ros2
