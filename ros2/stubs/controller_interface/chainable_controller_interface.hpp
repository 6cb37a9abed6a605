// SPDX-License-Identifier: MIT
// Stub of controller_interface for tests: README.md.
#pragma once

#include "controller_interface/controller_interface_base.hpp"

namespace controller_interface {

class ChainableControllerInterface : public ControllerInterfaceBase {
public:
    return_type update(const rclcpp::Time &time, const rclcpp::Duration &period) final
    {
#if RCLCPP_VERSION_MAJOR < 21
        const auto given = chained_ ? return_type::OK : update_reference_from_subscribers();
#else
        const auto given = chained_ ? return_type::OK : update_reference_from_subscribers(time, period);
#endif
        return given == return_type::OK ? update_and_write_commands(time, period) : given;
    }
    bool is_in_chained_mode() const { return chained_; }
    bool set_chained_mode(bool chained)
    {
        if (stub_is_active || !on_set_chained_mode(chained)) { return false; }
        chained_ = chained;
        return true;
    }

#if RCLCPP_VERSION_MAJOR < 21
    using Exported = std::vector<hardware_interface::CommandInterface>;
    Exported export_reference_interfaces() { return on_export_reference_interfaces(); }

protected:
    virtual std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() = 0;
    virtual return_type update_reference_from_subscribers() = 0;
#else
    using Exported = std::vector<hardware_interface::CommandInterface::SharedPtr>;
    Exported export_reference_interfaces()
    {
        ordered_exported_reference_interfaces_ = on_export_reference_interfaces_list();
        return ordered_exported_reference_interfaces_;
    }

protected:
    virtual std::vector<hardware_interface::CommandInterface::SharedPtr> on_export_reference_interfaces_list() { return {}; }
    virtual return_type update_reference_from_subscribers(const rclcpp::Time &time, const rclcpp::Duration &period) = 0;
    std::vector<hardware_interface::CommandInterface::SharedPtr> ordered_exported_reference_interfaces_;
#endif
    virtual bool on_set_chained_mode(bool) { return true; }
    virtual return_type update_and_write_commands(const rclcpp::Time &time, const rclcpp::Duration &period) = 0;
    std::vector<double> reference_interfaces_;

private:
    bool chained_ = false;
};

} // namespace controller_interface
