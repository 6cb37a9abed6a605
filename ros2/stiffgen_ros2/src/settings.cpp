// SPDX-License-Identifier: MIT
#include "settings.hpp"

#include "defaults.hpp"
#include "fields.hpp"

#if STIFFGEN_ROS2_PARAMETERS
#include <stiffgen_ros2/stiffgen_ros2_parameters.hpp>
#endif

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <iterator>
#include <limits>

namespace stiffgen_ros2 {

namespace {

// Parameters beside the fields of the configuration. Fixed: they change only while the controller is not configured.
constexpr const char *FIXED[] = {
    "joints", "prefix", "base_frame", "command_position", "velocity_interface", "policy", "state_rate", "sample_time",
    "ft_sensor", "ft_calibration"};
constexpr const char *OTHERS[] = {"translation_stiffness", "rotation_stiffness", "posture_stiffness", "compensate_gravity", "gravity",
    "wrench_timeout", "target_timeout"};

template <class T> void declare(rclcpp_lifecycle::LifecycleNode &node, const std::string &name, const T &value)
{
    if (!node.has_parameter(name)) { node.declare_parameter<T>(name, value); }
}

template <class Names> bool contains(const Names &names, const std::string &name)
{
    return std::any_of(std::begin(names), std::end(names), [&name](const auto &each) { return name == each; });
}

template <class Table> bool has_row(const Table &table, const std::string &name)
{
    return std::any_of(std::begin(table), std::end(table), [&name](const auto &row) { return name == row.name; });
}

std::string counted(const std::string &name, std::size_t got, const std::string &wanted)
{
    return "parameter '" + name + "' has " + std::to_string(got) + " numbers; give " + wanted;
}

// Three numbers are the diagonal, nine the rows. Return why they are refused.
std::string read_matrix(const Lookup &lookup, const std::string &name, double *matrix)
{
    const std::vector<double> given = lookup(name).as_double_array();
    if (given.size() != 3 && given.size() != 9) { return counted(name, given.size(), "3 (the diagonal) or 9 (the rows)"); }
    std::fill(matrix, matrix + 9, 0.0);
    if (given.size() == 9) {
        std::copy(given.begin(), given.end(), matrix);
    } else {
        for (std::size_t k = 0; k < 3; ++k) { matrix[4 * k] = given[k]; }
    }
    return "";
}

// One number is for all. Return why they are refused.
std::string read_numbers(const Lookup &lookup, const std::string &name, std::size_t count, double *numbers)
{
    const std::vector<double> given = lookup(name).as_double_array();
    if (given.size() != count && given.size() != 1) { return counted(name, given.size(), std::to_string(count) + ", or 1 for all"); }
    for (std::size_t i = 0; i < count; ++i) { numbers[i] = given[given.size() == 1 ? 0 : i]; }
    return "";
}

// Read one of the words of a choice. Return why it is refused.
std::string read_choice(const Lookup &lookup, const Choice &field, robot::Config &config)
{
    const std::string word = lookup(field.name).as_string();
    std::string choices;
    for (std::size_t i = 0; i < std::size(field.words) && field.words[i] != nullptr; ++i) {
        choices += (choices.empty() ? "'" : " or '") + std::string(field.words[i]) + "'";
        if (word == field.words[i]) {
            *field.at(config) = field.values[i];
            return "";
        }
    }
    return std::string("parameter '") + field.name + "' is '" + word + "'; give " + choices;
}

// Read the configuration's fields from the parameters; return the first fault, "" for none.
std::string read_fields(const Lookup &lookup, robot::Config &config)
{
    std::string reason;
    for (const Numbers &field : NUMBERS) {
        if (field.count == 0) {
            *field.at(config) = lookup(field.name).as_double();
        } else if (reason.empty()) {
            reason = read_numbers(lookup, field.name, field.count, field.at(config));
        }
    }
    for (const Integer &field : INTEGERS) {
        using Limits = std::numeric_limits<int>; // outside of the field's range, which the controller names
        *field.at(config) = static_cast<int>(std::clamp<std::int64_t>(lookup(field.name).as_int(), Limits::min(), Limits::max()));
    }
    for (const Choice &field : CHOICES) {
        if (reason.empty()) { reason = read_choice(lookup, field, config); }
    }
    return reason;
}

// Let the controller judge the settings. It sizes the tank, too, which takes 0.1 ms: a restart in the loop then need not.
std::string check(Settings &settings)
{
    robot::Impedance probe(settings.config);
    if (probe.error() != robot::GOOD) { return robot::Impedance::error_text(probe.error()); }
    robot::Report report{};
    static_cast<void>(probe.step(robot::Sample{}, report));
    settings.config.tank_initial = report.tank_initial;
    const robot::Sample command = command_of(settings);
    robot::Follow follow;
    const int error = robot::start(follow, settings.config, command.q0);
    if (error != robot::GOOD) { return robot::follow_text(error); }
    const std::string reason = refuse(settings.config, command);
    if (!reason.empty()) { return reason; }
    for (const double each : settings.gravity) {
        if (!std::isfinite(each) || std::abs(each) > 100.0) { return "gravity: give three numbers of at most 100 m/s^2"; }
    }
    if (!(settings.wrench_timeout > 0.0)) { return "wrench_timeout must be above 0 s"; }
    if (!(settings.target_timeout > 0.0)) { return "target_timeout must be above 0 s"; }
    return "";
}

// Read the sensor's name and calibration. Return why they are refused.
std::string read_sensor(const Lookup &lookup, Setup &setup)
{
    const std::string file = lookup("ft_calibration").as_string();
    setup.ft_sensor = lookup("ft_sensor").as_string();
    setup.calibration = {};
    if (setup.ft_sensor.empty()) { return file.empty() ? "" : "ft_calibration is given, but no ft_sensor: name the sensor, too"; }
#if STIFFGEN_ROS2_SENSOR
    if (file.empty()) { return ""; }
    std::ifstream stream(file);
    const std::string text{std::istreambuf_iterator<char>(stream), {}};
    if (!robot::read_calibration(text, setup.calibration)) {
        return "ft_calibration: '" + file + "' is not a file of 'stiffgen calibrate' (bias and payload)";
    }
    if (!robot::is_of_sensor(text)) {
        return "ft_calibration: '" + file + "' is of another sensor; calibrate again with this robot";
    }
    return "";
#else
    return "ft_sensor: the robot's functions know no sensor; generate them with --sensor LINK (README.md has the command)";
#endif
}

} // namespace

// Declare all parameters with their defaults, those of the configuration from the controller's own.
void declare_parameters(rclcpp_lifecycle::LifecycleNode &node)
{
#if STIFFGEN_ROS2_PARAMETERS
    const stiffgen_ros2_parameters::ParamListener described(&node); // declares with descriptions; the checks are ours
#endif
    robot::Config config = default_config();
    for (const Numbers &field : NUMBERS) {
        const double *first = field.at(config);
        if (field.count == 0) {
            declare(node, field.name, *first);
        } else {
            declare(node, field.name, std::vector<double>(first, first + field.count));
        }
    }
    for (const Integer &field : INTEGERS) { declare<std::int64_t>(node, field.name, *field.at(config)); }
    for (const Choice &field : CHOICES) {
        const int *const value = std::find(std::begin(field.values), std::end(field.values), *field.at(config));
        declare<std::string>(node, field.name, field.words[value - std::begin(field.values)]);
    }
    declare(node, "joints", std::vector<std::string>());
    declare<std::string>(node, "prefix", "");
    declare<std::string>(node, "base_frame", "");
    declare<std::string>(node, "ft_sensor", "");
    declare<std::string>(node, "ft_calibration", "");
    declare(node, "command_position", false);
    declare(node, "velocity_interface", true);
    declare(node, "policy", false);
    declare(node, "state_rate", 20.0);
    declare(node, "sample_time", 0.0);
    declare(node, "translation_stiffness", std::vector<double>{400.0, 400.0, 400.0});
    declare(node, "rotation_stiffness", std::vector<double>{20.0, 20.0, 20.0});
    declare(node, "posture_stiffness", std::vector<double>{1.0});
    declare(node, "compensate_gravity", false);
    declare(node, "gravity", std::vector<double>{0.0, 0.0, -9.81});
    declare(node, "wrench_timeout", 0.5);
    declare(node, "target_timeout", 1.0);
}

// Read what only configuration decides: joints, frame, interfaces, sensor; return the fault, "" for none.
std::string read_setup(const Lookup &lookup, Setup &setup)
{
    const std::string prefix = lookup("prefix").as_string();
    setup.joints = lookup("joints").as_string_array();
    if (setup.joints.empty()) {
        for (const char *joint : robot::JOINTS) { setup.joints.push_back(prefix + joint); }
    }
    if (setup.joints.size() != robot::DOF) {
        return "parameter 'joints' has " + std::to_string(setup.joints.size()) + " names; the robot has " +
               std::to_string(robot::DOF) + " joints, from base to tip";
    }
    for (auto joint = setup.joints.begin(); joint != setup.joints.end(); ++joint) {
        const auto number = std::to_string(joint - setup.joints.begin() + 1);
        if (joint->empty()) { return "parameter 'joints': name " + number + " is empty; give a name per joint, from base to tip"; }
        if (std::find(setup.joints.begin(), joint, *joint) != joint) {
            return "parameter 'joints' has '" + *joint + "' twice; give each joint once, from base to tip";
        }
    }
    setup.base_frame = lookup("base_frame").as_string();
    if (setup.base_frame.empty()) { setup.base_frame = prefix + robot::BASE_FRAME; }
    setup.command_position = lookup("command_position").as_bool();
    setup.velocity_interface = lookup("velocity_interface").as_bool();
    setup.policy = lookup("policy").as_bool();
    setup.state_rate = lookup("state_rate").as_double();
    if (!(setup.state_rate >= 1.0 && setup.state_rate <= 100.0)) { return "state_rate must lie between 1 and 100 Hz"; }
    return read_sensor(lookup, setup);
}

// Read the sample time [s], which must agree with the update rate [Hz] within 10 %.
std::string read_sample_time(const Lookup &lookup, unsigned update_rate, double &sample_time)
{
    const double given = lookup("sample_time").as_double(), rate = static_cast<double>(update_rate);
    if (update_rate == 0 && given == 0.0) { // Humble, where the controller has no rate of its own
        return "the update rate is unknown: set sample_time [s], the time between two updates of the controller";
    }
    if (update_rate > 0 && given != 0.0 && !(std::abs(given * rate - 1.0) < 0.1)) {
        char text[200];
        std::snprintf(text, sizeof text, "sample_time is %g s, but update_rate is %g Hz: set sample_time to %g, or to 0.0", given,
            rate, 1.0 / rate);
        return text;
    }
    sample_time = given != 0.0 ? given : 1.0 / rate;
    return "";
}

// Read what may change while active; return the fault, "" for none.
std::string read_settings(const Lookup &lookup, double sample_time, Settings &settings)
{
    settings.config = default_config();
    settings.config.sample_time = sample_time;
    std::string reason = read_fields(lookup, settings.config);
    if (reason.empty()) { reason = read_matrix(lookup, "translation_stiffness", settings.translation_stiffness.data()); }
    if (reason.empty()) { reason = read_matrix(lookup, "rotation_stiffness", settings.rotation_stiffness.data()); }
    if (reason.empty()) { reason = read_numbers(lookup, "posture_stiffness", robot::DOF, settings.posture_stiffness.data()); }
    if (!reason.empty()) { return reason; }
    const std::vector<double> gravity = lookup("gravity").as_double_array();
    if (gravity.size() != 3) { return counted("gravity", gravity.size(), "3, in axes of the base"); }
    std::copy(gravity.begin(), gravity.end(), settings.gravity.begin());
    settings.compensate_gravity = lookup("compensate_gravity").as_bool();
    settings.differences_positions = !lookup("velocity_interface").as_bool();
    if (settings.differences_positions) { // the mean velocity since the last sample is half a sample old: counts as one
        settings.config.delay_samples += settings.config.delay_samples >= 0 ? 1 : 0; // a negative one is refused by the check
        settings.config.velocity_noise = std::max(settings.config.velocity_noise, settings.config.position_quantum / sample_time);
    }
    settings.wrench_timeout = lookup("wrench_timeout").as_double();
    settings.target_timeout = lookup("target_timeout").as_double();
    return check(settings);
}

bool is_fixed(const std::string &parameter) { return contains(FIXED, parameter); }

bool is_ours(const std::string &parameter)
{
    return is_fixed(parameter) || contains(OTHERS, parameter) || has_row(NUMBERS, parameter) ||
           has_row(INTEGERS, parameter) || has_row(CHOICES, parameter);
}

// Return whether two configurations differ in a field that has a parameter.
bool differs(robot::Config a, robot::Config b)
{
    bool same = true;
    for (const Numbers &field : NUMBERS) {
        same = same && std::equal(field.at(a), field.at(a) + std::max<std::size_t>(field.count, 1), field.at(b));
    }
    for (const Integer &field : INTEGERS) { same = same && *field.at(a) == *field.at(b); }
    for (const Choice &field : CHOICES) { same = same && *field.at(a) == *field.at(b); }
    return !same;
}

// Return a command with the settings' springs, at rest in the middle of the limits.
robot::Sample command_of(const Settings &settings)
{
    robot::Sample command{};
    for (std::size_t i = 0; i < robot::DOF; ++i) {
        const double lower = settings.config.lower_limit[i], upper = settings.config.upper_limit[i];
        command.q0[i] = std::isfinite(lower) && std::isfinite(upper) ? 0.5 * (lower + upper) : std::clamp(0.0, lower, upper);
        command.posture_stiffness[i] = settings.posture_stiffness[i];
    }
    std::copy(settings.translation_stiffness.begin(), settings.translation_stiffness.end(), command.translation_stiffness);
    std::copy(settings.rotation_stiffness.begin(), settings.rotation_stiffness.end(), command.rotation_stiffness);
    return command;
}

bool finite(const double *values, std::size_t count)
{
    return std::all_of(values, values + count, [](double each) { return std::isfinite(each); });
}

// Return why the controller would refuse a command, by giving it to one that rests there; "" if it takes it.
std::string refuse(const robot::Config &config, const robot::Sample &command)
{
    robot::Impedance probe(config); // an arm that rests at q0
    robot::Sample sample = command;
    robot::Report report{};
    sample.clock = robot::BY_COUNTER;
    sample.sample_valid = 1;
    for (std::size_t i = 0; i < robot::DOF; ++i) { sample.q[i] = std::clamp(command.q0[i], config.lower_limit[i], config.upper_limit[i]); }
    static_cast<void>(probe.step(sample, report));
    return report.refusal == robot::NO_REFUSAL ? "" : robot::refusal_text(report);
}

} // namespace stiffgen_ros2
