// SPDX-License-Identifier: MIT
#include "controller.hpp"

#include "interfaces.hpp"

#include <pluginlib/class_list_macros.hpp>

#include <algorithm>
#include <cmath>
#include <exception>
#include <limits>

namespace stiffgen_ros2 {

StiffnessController::Callback StiffnessController::refuse(const std::string &reason)
{
    RCLCPP_ERROR(get_node()->get_logger(), "%s", reason.c_str());
    return Callback::FAILURE;
}

// Declare the parameters; a number of the wrong type is an error here.
StiffnessController::Callback StiffnessController::on_init()
{
    try {
        declare_parameters(*get_node());
    } catch (const std::exception &error) {
        RCLCPP_ERROR(get_node()->get_logger(), "%s (write 400.0 instead of 400)", error.what());
        return Callback::ERROR;
    }
    return Callback::SUCCESS;
}

// Read and check all parameters, and create topics, services and diagnostics.
StiffnessController::Callback StiffnessController::on_configure(const State &)
{
    const auto node = get_node();
    const Lookup lookup = [&node](const std::string &name) { return node->get_parameter(name); };
    Settings settings{};
    std::string reason;
    try {
        reason = read_setup(lookup, setup_);
        if (reason.empty()) { reason = read_sample_time(lookup, get_update_rate(), sample_time_); }
        if (reason.empty()) { reason = read_settings(lookup, sample_time_, settings); }
    } catch (const std::exception &error) {
        reason = error.what();
    }
    if (!reason.empty()) { return refuse(reason); }
    topics_ = std::make_shared<Topics>(*node, setup_, commands_, time_);
    parameters_ = std::make_shared<Parameters>(*node, sample_time_, topics_, settings_);
    parameters_->start(settings);
    topics_->subscribe();
    change_report(std::make_shared<Report>(*node, setup_, snapshots_, reset_));
    report_->start();
    start_diagnostics();
    return Callback::SUCCESS;
}

// Return the interfaces that are written: efforts, and positions where they are asked for.
StiffnessController::Configuration StiffnessController::command_interface_configuration() const
{
    Configuration configuration{controller_interface::interface_configuration_type::INDIVIDUAL, {}};
    for (const auto &joint : setup_.joints) { configuration.names.push_back(joint + "/effort"); }
    for (const auto &joint : setup_.joints) {
        if (setup_.command_position) { configuration.names.push_back(joint + "/position"); }
    }
    return configuration;
}

// Return the interfaces that are read: positions, velocities and the wrench sensor's six axes.
StiffnessController::Configuration StiffnessController::state_interface_configuration() const
{
    Configuration configuration{controller_interface::interface_configuration_type::INDIVIDUAL, {}};
    for (const auto &joint : setup_.joints) {
        configuration.names.push_back(joint + "/position");
        if (setup_.velocity_interface) { configuration.names.push_back(joint + "/velocity"); }
    }
    for (const char *axis : {"/force.x", "/force.y", "/force.z", "/torque.x", "/torque.y", "/torque.z"}) {
        if (!setup_.ft_sensor.empty()) { configuration.names.push_back(setup_.ft_sensor + axis); }
    }
    return configuration;
}

// Read the state: per joint its position, and its velocity if it has the interface; then the sensor. Values may be NaN.
Measured StiffnessController::measure() const
{
    const std::size_t width = setup_.velocity_interface ? 2 : 1, joints = width * robot::DOF;
    Measured measured{};
    measured.is_complete = true;
    for (std::size_t k = 0; k < state_interfaces_.size(); ++k) {
        const auto value = value_of(state_interfaces_[k]);
        if (k < joints) {
            measured.is_complete = measured.is_complete && value;
            (k % width == 0 ? measured.q : measured.dq)[k / width] = value.value_or(0.0);
        } else {
            measured.reading[k - joints] = value.value_or(std::numeric_limits<double>::quiet_NaN());
        }
    }
#if STIFFGEN_ROS2_SENSOR
    double q[robot::DOF];
    std::copy(measured.q.begin(), measured.q.end(), q);
    if (!setup_.ft_sensor.empty()) { measured.wrench = robot::tip_wrench(q, measured.reading, setup_.calibration); }
#endif
    return measured;
}

// Start the law at the measured position, with the efforts in force; refuse while a state is not finite.
StiffnessController::Callback StiffnessController::on_activate(const State &)
{
    for (const auto &each : state_interfaces_) {
        if (!std::isfinite(value_of(each).value_or(std::numeric_limits<double>::quiet_NaN()))) { // drivers start so
            return refuse(each.get_name() + " is not a finite number yet; activate the controller once the driver measures it");
        }
    }
    const Measured measured = measure();
    robot::Joints torque;
    for (std::size_t i = 0; i < robot::DOF; ++i) { torque[i] = value_of(command_interfaces_[i]).value_or(0.0); }
    settings_.read(loop_settings_);
    const bool uses_policy = setup_.policy && !is_in_chained_mode(); // it would replace the references
    const int error = law_.start(loop_settings_, uses_policy, measured.q, torque);
    if (error != robot::GOOD) { return refuse(robot::Impedance::error_text(error)); }
    for (Command old; commands_.pop(old);) {}
    write_reference(measured.q);
    time_ = 0.0;
    reset_ = false;
    failed_writes_ = 0;
    topics_->accept(is_in_chained_mode());
    return Callback::SUCCESS;
}

// Do one cycle: take settings and commands, step the law, write efforts. No lock is waited for.
StiffnessController::Return StiffnessController::update_and_write_commands(const rclcpp::Time &, const rclcpp::Duration &period)
{
    if (settings_.read(loop_settings_)) { law_.change(loop_settings_); }
    for (Command command; commands_.pop(command);) { law_.command(command); }
    if (is_in_chained_mode()) {
        robot::Joints q0;
        read_reference(q0);
        law_.refer(q0.data());
    }
    if (reset_.exchange(false)) { law_.reset(); }
    const robot::Report &report = law_.step(measure(), period.seconds());
    time_ = law_.time();
    snapshots_.write(law_.snapshot());
    failed_writes_ = write(report) ? 0 : failed_writes_ + 1;
    return failed_writes_ < loop_settings_.config.missed_limit ? Return::OK : Return::ERROR;
}

// Write torques, and believed positions for drivers that want both. Return whether every interface took its value.
bool StiffnessController::write(const robot::Report &report)
{
    bool written = true;
    for (std::size_t i = 0; i < robot::DOF; ++i) {
        written = set_value(command_interfaces_[i], report.torque[i]) && written;
        if (setup_.command_position) { written = set_value(command_interfaces_[robot::DOF + i], report.position[i]) && written; }
    }
    return written;
}

// Write zero torque: a driver goes on with the last value of an interface. Without claimed interfaces nothing is to be done.
StiffnessController::Callback StiffnessController::release()
{
    bool released = true;
    for (std::size_t i = 0; i < std::min(command_interfaces_.size(), robot::DOF); ++i) {
        bool is_zero = false;
        for (int tries = 0; tries < 100 && !is_zero; ++tries) { is_zero = set_value(command_interfaces_[i], 0.0); }
        released = released && is_zero;
    }
    if (topics_) { topics_->ignore(); }
    Snapshot last = law_.snapshot();
    last.is_active = false;
    snapshots_.write(last);
    if (!released) {
        RCLCPP_ERROR(get_node()->get_logger(), "a torque could not be set to zero: the driver keeps the interface locked");
        return Callback::ERROR;
    }
    return Callback::SUCCESS;
}

// Publish the state on /diagnostics, as often as diagnostic_updater.period says.
void StiffnessController::start_diagnostics()
{
    if (diagnostics_) { return; }
    diagnostics_ = std::make_unique<diagnostic_updater::Updater>(get_node());
    diagnostics_->setHardwareID(robot::TIP_FRAME);
    diagnostics_->add("state", [this](diagnostic_updater::DiagnosticStatusWrapper &status) {
        const auto found = report();
        const auto state = found ? found->status() : diagnostic_msgs::msg::DiagnosticStatus();
        status.summary(state.level, found ? state.message : "unconfigured");
        status.values = state.values;
    });
}

std::shared_ptr<Report> StiffnessController::report() const
{
    const std::lock_guard<std::mutex> lock(report_change_);
    return report_;
}

void StiffnessController::change_report(std::shared_ptr<Report> report)
{
    const std::lock_guard<std::mutex> lock(report_change_);
    report_.swap(report);
}

void StiffnessController::forget()
{
    parameters_.reset();
    change_report(nullptr);
    topics_.reset();
}

StiffnessController::Callback StiffnessController::on_deactivate(const State &) { return release(); }

StiffnessController::Callback StiffnessController::on_cleanup(const State &)
{
    forget();
    return Callback::SUCCESS;
}

StiffnessController::Callback StiffnessController::on_error(const State &)
{
    const Callback done = release();
    forget();
    return done;
}

StiffnessController::Callback StiffnessController::on_shutdown(const State &)
{
    const Callback done = release();
    forget();
    return done;
}

#if RCLCPP_VERSION_MAJOR < 21
// Return the references that another controller may write: a position [rad] per joint.
std::vector<hardware_interface::CommandInterface> StiffnessController::on_export_reference_interfaces()
{
    reference_interfaces_.assign(robot::DOF, std::numeric_limits<double>::quiet_NaN());
    std::vector<hardware_interface::CommandInterface> exported;
    for (std::size_t i = 0; i < robot::DOF; ++i) {
        exported.emplace_back(get_node()->get_name(), setup_.joints[i] + "/position", &reference_interfaces_[i]);
    }
    return exported;
}

void StiffnessController::read_reference(robot::Joints &q0) const
{
    std::copy(reference_interfaces_.begin(), reference_interfaces_.end(), q0.begin());
}

void StiffnessController::write_reference(const robot::Joints &q0)
{
    std::copy(q0.begin(), q0.begin() + static_cast<std::ptrdiff_t>(reference_interfaces_.size()), reference_interfaces_.begin());
}
#else
// Return the same references, in the form of newer distributions.
std::vector<hardware_interface::CommandInterface::SharedPtr> StiffnessController::on_export_reference_interfaces_list()
{
    std::vector<hardware_interface::CommandInterface::SharedPtr> exported;
    for (const auto &joint : setup_.joints) {
        hardware_interface::InterfaceInfo info{};
        info.name = joint + "/position";
        info.data_type = "double";
        const hardware_interface::InterfaceDescription description(get_node()->get_name(), info);
        exported.push_back(std::make_shared<hardware_interface::CommandInterface>(description));
    }
    return exported;
}

void StiffnessController::read_reference(robot::Joints &q0) const
{
    q0.fill(std::numeric_limits<double>::quiet_NaN());
    for (std::size_t i = 0; i < ordered_exported_reference_interfaces_.size(); ++i) {
        q0[i] = value_of(*ordered_exported_reference_interfaces_[i]).value_or(q0[i]);
    }
}

void StiffnessController::write_reference(const robot::Joints &q0)
{
    for (std::size_t i = 0; i < ordered_exported_reference_interfaces_.size(); ++i) {
        static_cast<void>(set_value(*ordered_exported_reference_interfaces_[i], q0[i])); // locked: the last one stays
    }
}
#endif

} // namespace stiffgen_ros2

PLUGINLIB_EXPORT_CLASS(stiffgen_ros2::StiffnessController, controller_interface::ChainableControllerInterface)
