// SPDX-License-Identifier: MIT
// The ros2_control controller: lifecycle and interfaces. README.md has its parameters and topics.
#pragma once

#include "exchange.hpp"
#include "law.hpp"
#include "parameters.hpp"
#include "report.hpp"
#include "settings.hpp"
#include "topics.hpp"

#include <controller_interface/chainable_controller_interface.hpp>
#include <diagnostic_updater/diagnostic_updater.hpp>
#include <rclcpp/version.h>

#include <atomic>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

namespace stiffgen_ros2 {

class StiffnessController : public controller_interface::ChainableControllerInterface {
public:
    using Return = controller_interface::return_type;
    using Callback = controller_interface::CallbackReturn;
    using Configuration = controller_interface::InterfaceConfiguration;
    using State = rclcpp_lifecycle::State;

    Callback on_init() override;
    Callback on_configure(const State &previous) override;
    Callback on_activate(const State &previous) override;
    Callback on_deactivate(const State &previous) override;
    Callback on_cleanup(const State &previous) override;
    Callback on_error(const State &previous) override;
    Callback on_shutdown(const State &previous) override;

    Configuration command_interface_configuration() const override;
    Configuration state_interface_configuration() const override;

protected:
#if RCLCPP_VERSION_MAJOR < 21 // Humble
    std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() override;
    Return update_reference_from_subscribers() override { return Return::OK; }
#else
    std::vector<hardware_interface::CommandInterface::SharedPtr> on_export_reference_interfaces_list() override;
    Return update_reference_from_subscribers(const rclcpp::Time &, const rclcpp::Duration &) override { return Return::OK; }
#endif
    bool on_set_chained_mode(bool) override { return true; }
    Return update_and_write_commands(const rclcpp::Time &time, const rclcpp::Duration &period) override;

private:
    Measured measure() const;
    void read_reference(robot::Joints &q0) const;
    void write_reference(const robot::Joints &q0);
    bool write(const robot::Report &report);
    Callback release();
    void forget();
    void start_diagnostics();
    std::shared_ptr<Report> report() const;
    void change_report(std::shared_ptr<Report> report);
    Callback refuse(const std::string &reason);

    Setup setup_;
    double sample_time_ = 0.0;
    Latest<Settings> settings_; // to the loop
    Latest<Snapshot> snapshots_; // from the loop
    Commands commands_; // to the loop
    std::atomic<double> time_{0.0}; // from the loop
    std::atomic<bool> reset_{false}; // to the loop
    Settings loop_settings_{};
    Law law_;
    int failed_writes_ = 0;
    std::shared_ptr<Topics> topics_;
    std::shared_ptr<Report> report_;
    mutable std::mutex report_change_; // the diagnostics' thread may read report_ while another one cleans up
    std::shared_ptr<Parameters> parameters_;
    std::unique_ptr<diagnostic_updater::Updater> diagnostics_; // stays: its timer does not ask whether it still lives
};

} // namespace stiffgen_ros2
