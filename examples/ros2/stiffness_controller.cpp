// SPDX-License-Identifier: MIT
/* A ros2_control effort controller around the generated impedance controller: docs/ros2.md. */
#include "iiwa14.hpp"

#include <controller_interface/controller_interface.hpp>
#include <pluginlib/class_list_macros.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <type_traits>

// Return the value of a loaned interface, NaN without one: get_value until Humble, get_optional since Jazzy.
template <class Loaned> auto value_of(const Loaned &loaned, int) -> std::decay_t<decltype(loaned.get_optional().value())>
{
    return loaned.get_optional().value_or(std::numeric_limits<double>::quiet_NaN());
}
template <class Loaned> double value_of(const Loaned &loaned, long) { return loaned.get_value(); }

// Return whether the value was accepted; set_value returns nothing until Humble.
template <class Loaned> bool set(Loaned &loaned, double value)
{
    if constexpr (std::is_void_v<decltype(loaned.set_value(value))>) {
        loaned.set_value(value);
        return true;
    } else {
        return loaned.set_value(value);
    }
}

class StiffnessController : public controller_interface::ControllerInterface {
public:
    using Return = controller_interface::return_type;
    using Callback = controller_interface::CallbackReturn;
    using Configuration = controller_interface::InterfaceConfiguration;

    Callback on_init() override { return Callback::SUCCESS; }

    Configuration command_interface_configuration() const override { return named({"effort"}); }
    Configuration state_interface_configuration() const override { return named({"position", "velocity"}); }

    Callback on_activate(const rclcpp_lifecycle::State &) override
    {
        auto config = iiwa14::Impedance::default_config();
        config.sample_time = 1.0 / static_cast<double>(get_update_rate());
        // The torque in force: the driver goes on with it until the first update.
        std::array<double, iiwa14::DOF> torque{};
        for (std::size_t i = 0; i < iiwa14::DOF; ++i) {
            const double value = value_of(command_interfaces_[i], 0);
            torque[i] = std::isfinite(value) ? std::clamp(value, -config.effort_limit[i], config.effort_limit[i]) : 0.0;
        }
        impedance_ = iiwa14::Impedance(config, torque);
        if (impedance_.error() != IIWA14_OK) {
            RCLCPP_ERROR(get_node()->get_logger(), "%s", iiwa14::Impedance::error_text(impedance_.error()));
            return Callback::FAILURE;
        }
        for (const auto &state : state_interfaces_) {
            if (!std::isfinite(value_of(state, 0))) { // drivers start so
                RCLCPP_ERROR(get_node()->get_logger(), "%s is not a finite number; activate the controller once the driver measures it",
                    state.get_name().c_str());
                return Callback::FAILURE;
            }
        }
        sample_ = {};
        sample_.sample_valid = 1;
        sample_.command = IIWA14_COMMAND_POSITION;
        for (std::size_t i = 0; i < iiwa14::DOF; ++i) { sample_.q0[i] = value_of(state_interfaces_[2 * i], 0); } // hold this position
        for (std::size_t k = 0; k < 3; ++k) {
            sample_.translation_stiffness[4 * k] = 400.0; // N/m
            sample_.rotation_stiffness[4 * k] = 20.0; // N m/rad
        }
        return Callback::SUCCESS;
    }

    // The driver goes on with the last value of an interface: without these the arm would keep its torque.
    Callback on_deactivate(const rclcpp_lifecycle::State &) override { return release(); }
    Callback on_error(const rclcpp_lifecycle::State &) override { return release(); }
    Callback on_shutdown(const rclcpp_lifecycle::State &) override { return release(); }

    Return update(const rclcpp::Time &, const rclcpp::Duration &) override
    {
        for (std::size_t i = 0; i < iiwa14::DOF; ++i) {
            sample_.q[i] = value_of(state_interfaces_[2 * i], 0); // rad
            sample_.dq[i] = value_of(state_interfaces_[2 * i + 1], 0); // rad/s
        }
        static_cast<void>(impedance_.step(sample_, report_)); // report_.status shows errors
        ++sample_.counter;
        for (std::size_t i = 0; i < iiwa14::DOF; ++i) { set(command_interfaces_[i], report_.torque[i]); } // N m
        return Return::OK; // after a fault the torque ramps down at its rate limit: keep calling
    }

private:
    // Write zero torque; an interface that does not take it is an error. The list is empty without claimed interfaces.
    Callback release()
    {
        bool released = true;
        for (auto &command : command_interfaces_) { released = set(command, 0.0) && released; }
        return released ? Callback::SUCCESS : Callback::ERROR;
    }

    // Interfaces in the order of q: that of the URDF's chain, not alphabetical.
    static Configuration named(const std::vector<std::string> &kinds)
    {
        Configuration configuration{controller_interface::interface_configuration_type::INDIVIDUAL, {}};
        for (const char *joint : iiwa14::JOINTS) {
            for (const auto &kind : kinds) { configuration.names.push_back(std::string(joint) + "/" + kind); }
        }
        return configuration;
    }

    iiwa14::Impedance impedance_;
    iiwa14::Impedance::Sample sample_{};
    iiwa14::Impedance::Report report_{};
};

PLUGINLIB_EXPORT_CLASS(StiffnessController, controller_interface::ControllerInterface)
