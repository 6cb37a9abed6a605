// SPDX-License-Identifier: MIT
// Stub of rclcpp_lifecycle for tests: README.md. Messages are handed over at once, timers run when a test says so.
#pragma once

#include "rclcpp/logging.hpp"
#include "rclcpp/parameter.hpp"
#include "rclcpp/time.hpp"
#include "rclcpp/version.h"
#include "rclcpp_lifecycle/state.hpp"

#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace rclcpp {

class QoS {
public:
    QoS(std::size_t) {}
};

class TimerBase {
public:
    using SharedPtr = std::shared_ptr<TimerBase>;
    explicit TimerBase(std::function<void()> callback) : callback(std::move(callback)) {}
    std::function<void()> callback;
};

class SubscriptionBase {
public:
    virtual ~SubscriptionBase() = default;
    std::size_t get_publisher_count() const { return publishers; }
    std::size_t publishers = 1;
};

template <class Message> class Subscription : public SubscriptionBase {
public:
    using SharedPtr = std::shared_ptr<Subscription>;
    std::function<void(const Message &)> callback;
};

class ServiceBase {
public:
    virtual ~ServiceBase() = default;
};

template <class Type> class Service : public ServiceBase {
public:
    using SharedPtr = std::shared_ptr<Service>;
    std::function<void(std::shared_ptr<typename Type::Request>, std::shared_ptr<typename Type::Response>)> callback;
};

class PublisherBase {
public:
    virtual ~PublisherBase() = default;
};

namespace node_interfaces {

struct OnSetParametersCallbackHandle {
    using SharedPtr = std::shared_ptr<OnSetParametersCallbackHandle>;
    std::function<rcl_interfaces::msg::SetParametersResult(const std::vector<Parameter> &)> callback;
};

#if RCLCPP_VERSION_MAJOR >= 21
struct PostSetParametersCallbackHandle {
    using SharedPtr = std::shared_ptr<PostSetParametersCallbackHandle>;
    std::function<void(const std::vector<Parameter> &)> callback;
};
#endif

} // namespace node_interfaces
} // namespace rclcpp

namespace rclcpp_lifecycle {

// As the real one, it is silent until its own on_activate.
template <class Message> class LifecyclePublisher : public rclcpp::PublisherBase {
public:
    using SharedPtr = std::shared_ptr<LifecyclePublisher>;
    void on_activate() { active_ = true; }
    void on_deactivate() { active_ = false; }
    void publish(const Message &message)
    {
        if (active_) { sent.push_back(message); }
    }
    std::vector<Message> sent;

private:
    bool active_ = false;
};

class LifecycleNode {
public:
    using Result = rcl_interfaces::msg::SetParametersResult;
    using Handle = rclcpp::node_interfaces::OnSetParametersCallbackHandle;

    explicit LifecycleNode(std::string name) : name_(std::move(name)) {}

    const char *get_name() const { return name_.c_str(); }
    rclcpp::Logger get_logger() const { return {}; }
    rclcpp::Time now() const { return clock; }

    bool has_parameter(const std::string &name) const { return parameters_.count(name) != 0; }
    // A value from the manager's file takes the default's place; one of another type throws.
    template <class T> T declare_parameter(const std::string &name, const T &value)
    {
        const auto given = overrides.find(name);
        const rclcpp::ParameterValue chosen = given == overrides.end() ? rclcpp::ParameterValue(value) : given->second;
        parameters_[name] = rclcpp::ParameterValue(chosen.get<T>());
        return chosen.get<T>();
    }
    rclcpp::Parameter get_parameter(const std::string &name) const { return {name, parameters_.at(name)}; }

    Handle::SharedPtr add_on_set_parameters_callback(decltype(Handle::callback) callback)
    {
        auto handle = std::make_shared<Handle>();
        handle->callback = std::move(callback);
        on_set_.insert(on_set_.begin(), handle); // the newest is called first; weak: a handle that nobody keeps is gone
        return handle;
    }
#if RCLCPP_VERSION_MAJOR >= 21
    using PostHandle = rclcpp::node_interfaces::PostSetParametersCallbackHandle;
    PostHandle::SharedPtr add_post_set_parameters_callback(decltype(PostHandle::callback) callback)
    {
        auto handle = std::make_shared<PostHandle>();
        handle->callback = std::move(callback);
        post_set_.insert(post_set_.begin(), handle);
        return handle;
    }
#endif
    // As in the real one, post_set callbacks are called once every value is set.
    Result set_parameters_atomically(const std::vector<rclcpp::Parameter> &changes)
    {
        Result result;
        for (const auto &each : changes) {
            if (!has_parameter(each.get_name())) {
                result.reason = "not declared";
                return result;
            }
            if (parameters_[each.get_name()].type() != each.get_parameter_value().type()) {
                result.reason = "another type";
                return result;
            }
        }
        for (const auto &each : on_set_) {
            if (const auto handle = each.lock()) {
                result = handle->callback(changes);
                if (!result.successful) { return result; }
            }
        }
        for (const auto &each : changes) { parameters_[each.get_name()] = each.get_parameter_value(); }
        result.successful = true;
#if RCLCPP_VERSION_MAJOR >= 21
        for (const auto &each : post_set_) {
            if (const auto handle = each.lock()) { handle->callback(changes); }
        }
#endif
        return result;
    }

    template <class Message>
    typename LifecyclePublisher<Message>::SharedPtr create_publisher(const std::string &topic, const rclcpp::QoS &)
    {
        auto made = std::make_shared<LifecyclePublisher<Message>>();
        publishers[topic] = made;
        return made;
    }
    template <class Message, class Callback>
    typename rclcpp::Subscription<Message>::SharedPtr create_subscription(
        const std::string &topic, const rclcpp::QoS &, Callback callback)
    {
        auto made = std::make_shared<rclcpp::Subscription<Message>>();
        made->callback = callback;
        subscriptions[topic] = made;
        return made;
    }
    template <class Type, class Callback>
    typename rclcpp::Service<Type>::SharedPtr create_service(const std::string &name, Callback callback)
    {
        auto made = std::make_shared<rclcpp::Service<Type>>();
        made->callback = callback;
        services[name] = made;
        return made;
    }
    template <class Period> rclcpp::TimerBase::SharedPtr create_wall_timer(Period, std::function<void()> callback)
    {
        auto made = std::make_shared<rclcpp::TimerBase>(std::move(callback));
        timers.push_back(made);
        return made;
    }

    // What a test uses.
    rclcpp::Time clock;
    std::map<std::string, rclcpp::ParameterValue> overrides;
    std::map<std::string, std::weak_ptr<rclcpp::PublisherBase>> publishers;
    std::map<std::string, std::weak_ptr<rclcpp::SubscriptionBase>> subscriptions;
    std::map<std::string, std::weak_ptr<rclcpp::ServiceBase>> services;
    std::vector<std::weak_ptr<rclcpp::TimerBase>> timers;

private:
    std::string name_;
    std::map<std::string, rclcpp::ParameterValue> parameters_;
    std::vector<std::weak_ptr<Handle>> on_set_;
#if RCLCPP_VERSION_MAJOR >= 21
    std::vector<std::weak_ptr<PostHandle>> post_set_;
#endif
};

} // namespace rclcpp_lifecycle
