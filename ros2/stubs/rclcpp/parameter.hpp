// SPDX-License-Identifier: MIT
// Stub of rclcpp for tests: README.md. As in the real one, a value of another type throws.
#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <variant>
#include <vector>

namespace rcl_interfaces {
namespace msg {

struct SetParametersResult {
    bool successful = false;
    std::string reason;
};

} // namespace msg
} // namespace rcl_interfaces

namespace rclcpp {

class ParameterValue {
public:
    using Any = std::variant<std::monostate, bool, std::int64_t, double, std::string, std::vector<std::string>,
        std::vector<std::int64_t>, std::vector<double>>;

    ParameterValue() = default;
    explicit ParameterValue(bool value) : value_(value) {}
    explicit ParameterValue(int value) : value_(static_cast<std::int64_t>(value)) {}
    explicit ParameterValue(std::int64_t value) : value_(value) {}
    explicit ParameterValue(double value) : value_(value) {}
    explicit ParameterValue(const char *value) : value_(std::string(value)) {}
    explicit ParameterValue(const std::string &value) : value_(value) {}
    explicit ParameterValue(const std::vector<std::string> &value) : value_(value) {}
    explicit ParameterValue(const std::vector<std::int64_t> &value) : value_(value) {}
    explicit ParameterValue(const std::vector<double> &value) : value_(value) {}

    template <class T> const T &get() const
    {
        const T *found = std::get_if<T>(&value_);
        if (found == nullptr) { throw std::runtime_error("parameter has another type"); }
        return *found;
    }
    std::size_t type() const { return value_.index(); }
    bool operator==(const ParameterValue &other) const { return value_ == other.value_; }

private:
    Any value_;
};

class Parameter {
public:
    Parameter() = default;
    template <class T> Parameter(const std::string &name, T value) : name_(name), value_(value) {}
    Parameter(const std::string &name, const ParameterValue &value) : name_(name), value_(value) {}

    const std::string &get_name() const { return name_; }
    const ParameterValue &get_parameter_value() const { return value_; }
    bool operator==(const Parameter &other) const { return name_ == other.name_ && value_ == other.value_; }
    template <class T> const T &get_value() const { return value_.get<T>(); }
    bool as_bool() const { return value_.get<bool>(); }
    std::int64_t as_int() const { return value_.get<std::int64_t>(); }
    double as_double() const { return value_.get<double>(); }
    const std::string &as_string() const { return value_.get<std::string>(); }
    const std::vector<std::string> &as_string_array() const { return value_.get<std::vector<std::string>>(); }
    const std::vector<double> &as_double_array() const { return value_.get<std::vector<double>>(); }

private:
    std::string name_;
    ParameterValue value_;
};

} // namespace rclcpp
