// SPDX-License-Identifier: MIT
/* A ros2_control effort controller around the generated impedance controller: docs/ros2.md. */
#include "iiwa14.hpp"

#include <controller_interface/controller_interface.hpp>
#include <pluginlib/class_list_macros.hpp>

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
        impedance_ = iiwa14::Impedance(config);
        if (impedance_.error() != IIWA14_OK) {
            RCLCPP_ERROR(get_node()->get_logger(), "%s", iiwa14::Impedance::error_text(impedance_.error()));
            return Callback::ERROR;
        }
        sample_ = {};
        sample_.sample_valid = 1;
        sample_.command = IIWA14_COMMAND_POSITION;
        for (std::size_t i = 0; i < iiwa14::DOF; ++i) { sample_.q0[i] = state_interfaces_[2 * i].get_value(); } // hold this position
        for (std::size_t k = 0; k < 3; ++k) {
            sample_.translation_stiffness[4 * k] = 400.0; // N/m
            sample_.rotation_stiffness[4 * k] = 20.0; // N m/rad
        }
        return Callback::SUCCESS;
    }

    Return update(const rclcpp::Time &, const rclcpp::Duration &) override
    {
        for (std::size_t i = 0; i < iiwa14::DOF; ++i) {
            sample_.q[i] = state_interfaces_[2 * i].get_value(); // rad
            sample_.dq[i] = state_interfaces_[2 * i + 1].get_value(); // rad/s
        }
        static_cast<void>(impedance_.step(sample_, report_)); // report_.status shows errors
        ++sample_.counter;
        for (std::size_t i = 0; i < iiwa14::DOF; ++i) { command_interfaces_[i].set_value(report_.torque[i]); } // N m
        return Return::OK; // after a fault the torque ramps down at its rate limit: keep calling
    }

private:
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
