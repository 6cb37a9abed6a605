// SPDX-License-Identifier: MIT
// Stub of hardware_interface for tests: README.md. Which members exist, and their attributes, follow the distribution.
#pragma once

#include "hardware_interface/handle.hpp"

namespace hardware_interface {

template <class Interface> class Loaned {
public:
    explicit Loaned(std::shared_ptr<Interface> interface) : interface_(std::move(interface)) {}
    Loaned(const Loaned &) = delete;
    Loaned(Loaned &&) = default;

    const std::string get_name() const { return interface_->get_name(); }
    const std::string &get_interface_name() const { return interface_->get_interface_name(); }
    const std::string &get_prefix_name() const { return interface_->get_prefix_name(); }

#if RCLCPP_VERSION_MAJOR < 21
    double get_value() const { return interface_->get_value(); }
#else
    template <class T = double> [[nodiscard]] std::optional<T> get_optional(unsigned int max_tries = 10) const
    {
        for (unsigned int tries = 0; tries < max_tries; ++tries) {
            if (const auto value = interface_->template get_optional<T>()) { return value; }
        }
        return std::nullopt;
    }
#if RCLCPP_VERSION_MAJOR < 29
    [[deprecated("Use get_optional")]] double get_value() const
    {
        return get_optional().value_or(std::numeric_limits<double>::quiet_NaN());
    }
#endif
#endif

protected:
    std::shared_ptr<Interface> interface_;
};

class LoanedStateInterface : public Loaned<StateInterface> {
public:
    using Loaned::Loaned;
};

class LoanedCommandInterface : public Loaned<CommandInterface> {
public:
    using Loaned::Loaned;
#if RCLCPP_VERSION_MAJOR < 21
    void set_value(double value) { interface_->set_value(value); }
#else
    template <class T> [[nodiscard]] bool set_value(const T &value, unsigned int max_tries = 10)
    {
        for (unsigned int tries = 0; tries < max_tries; ++tries) {
            if (interface_->set_value(value)) { return true; }
        }
        return false;
    }
#endif
};

} // namespace hardware_interface
