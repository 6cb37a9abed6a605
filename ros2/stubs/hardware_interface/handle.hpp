// SPDX-License-Identifier: MIT
// Stub of hardware_interface for tests: README.md. A value that a test locks cannot be read or written on Jazzy and later.
#pragma once

#include "rclcpp/version.h"

#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <utility>

namespace hardware_interface {

struct InterfaceInfo {
    std::string name, min, max, initial_value, data_type = "double";
    int size = 0;
};

#if RCLCPP_VERSION_MAJOR < 21
class Handle {
public:
    Handle(const std::string &prefix, const std::string &name, double *value = nullptr) : prefix_(prefix), name_(name), value_(value) {}
    // For tests: a value of the driver.
    Handle(double &value, const std::string &prefix, const std::string &name) : Handle(prefix, name, &value) {}
    const std::string get_name() const { return prefix_ + "/" + name_; }
    const std::string &get_interface_name() const { return name_; }
    const std::string &get_prefix_name() const { return prefix_; }
    double get_value() const { return *value_; }
    void set_value(double value) { *value_ = value; }

private:
    std::string prefix_, name_;
    double *value_;
};
#else
struct InterfaceDescription {
    InterfaceDescription(const std::string &prefix, const InterfaceInfo &info) : prefix_name(prefix), interface_info(info) {}
    std::string prefix_name;
    InterfaceInfo interface_info;
};

class Handle {
public:
    [[deprecated("Use InterfaceDescription")]] Handle(const std::string &prefix, const std::string &name, double *value)
        : prefix_(prefix), name_(name), full_(prefix + "/" + name), value_(value)
    {
    }
    explicit Handle(const InterfaceDescription &description)
        : prefix_(description.prefix_name), name_(description.interface_info.name), full_(prefix_ + "/" + name_), value_(&own_)
    {
    }
    // For tests: a value of the driver.
    Handle(double &value, const std::string &prefix, const std::string &name)
        : prefix_(prefix), name_(name), full_(prefix + "/" + name), value_(&value)
    {
    }
    Handle(const Handle &) = delete;
    const std::string &get_name() const { return full_; }
    const std::string &get_interface_name() const { return name_; }
    const std::string &get_prefix_name() const { return prefix_; }
    template <class T = double> [[nodiscard]] std::optional<T> get_optional() const
    {
        return locked ? std::optional<T>() : std::optional<T>(*value_);
    }
    template <class T> [[nodiscard]] bool set_value(const T &value)
    {
        if (locked) { return false; }
        *value_ = value;
        return true;
    }
    bool locked = false;

private:
    double own_ = std::numeric_limits<double>::quiet_NaN();
    std::string prefix_, name_, full_;
    double *value_;
};
#endif

class StateInterface : public Handle {
public:
    using SharedPtr = std::shared_ptr<StateInterface>;
    using ConstSharedPtr = std::shared_ptr<const StateInterface>;
    using Handle::Handle;
};

class CommandInterface : public Handle {
public:
    using SharedPtr = std::shared_ptr<CommandInterface>;
    using Handle::Handle;
    CommandInterface(const CommandInterface &) = delete;
    CommandInterface(CommandInterface &&) = default;
};

} // namespace hardware_interface
