// SPDX-License-Identifier: MIT
// A controller between a manager and a driver, both played by the test: the lifecycle, the loop, and a simulated arm.
#pragma once

#include "interfaces.hpp"
#include "simulation.hpp"

#include <controller_interface/chainable_controller_interface.hpp>
#include <diagnostic_msgs/msg/diagnostic_array.hpp>
#include <geometry_msgs/msg/pose_stamped.hpp>
#include <geometry_msgs/msg/wrench_stamped.hpp>
#include <pluginlib/class_list_macros.hpp>
#include <sensor_msgs/msg/joint_state.hpp>
#include <std_msgs/msg/float64_multi_array.hpp>
#include <std_srvs/srv/trigger.hpp>

#include <cmath>
#include <cstdio>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <vector>

extern int failed;
extern long allocations; // since the program began

inline void check(bool good, const char *what)
{
    if (!good) { std::printf("FAILED %s\n", what); }
    failed += !good;
}

namespace robot = stiffgen_ros2::robot;
using Callback = controller_interface::CallbackReturn;
using Result = rcl_interfaces::msg::SetParametersResult;
using State = hardware_interface::StateInterface;
using Command = hardware_interface::CommandInterface;

constexpr std::size_t N = robot::DOF;
constexpr double NOT_A_NUMBER = std::numeric_limits<double>::quiet_NaN();

struct Rig {
    enum Driver { PLAIN, KUKA } driver = PLAIN;

    stiffgen_ros2::Simulation arm;
    robot::Joints q, dq, torque, position, applied{};
    robot::Wrench reading{}; // of the sensor "wrist"
    std::map<std::string, std::shared_ptr<State>> states;
    std::map<std::string, std::shared_ptr<Command>> commands;
    std::shared_ptr<rclcpp_lifecycle::LifecycleNode> node = std::make_shared<rclcpp_lifecycle::LifecycleNode>("arm");
    std::unique_ptr<controller_interface::ChainableControllerInterface> controller =
        stub::factory<controller_interface::ChainableControllerInterface>()();
    controller_interface::ChainableControllerInterface::Exported references;
    std::string prefix;
    rclcpp_lifecycle::State state;
    long allocated = 0;
    bool is_ok = true;

    explicit Rig(std::string prefix_of_joints = "") : prefix(std::move(prefix_of_joints))
    {
        stub::world() = {};
        torque.fill(NOT_A_NUMBER); // as drivers begin
        position.fill(NOT_A_NUMBER);
        for (std::size_t i = 0; i < N; ++i) {
            double lower = std::max(robot::LOWER[i], -1.0), upper = std::min(robot::UPPER[i], 1.0);
            if (upper - lower < 1.2) { lower = robot::LOWER[i], upper = robot::UPPER[i]; } // an elbow that bends to one side
            arm.q[i] = lower + (i % 2 == 0 ? 0.5 : 0.75) * (upper - lower);
            const std::string joint = prefix + robot::JOINTS[i];
            states[joint + "/position"] = std::make_shared<State>(q[i], joint, "position");
            states[joint + "/velocity"] = std::make_shared<State>(dq[i], joint, "velocity");
            commands[joint + "/effort"] = std::make_shared<Command>(torque[i], joint, "effort");
            commands[joint + "/position"] = std::make_shared<Command>(position[i], joint, "position");
        }
        set("delay_samples", 0); // what the controller wants to be stated
        set("motor_inertia", std::vector<double>(arm.rotors.begin(), arm.rotors.end()));
        set("heaviest_wrench", std::vector<double>{100.0, 20.0});
        const char *const axes[] = {"force.x", "force.y", "force.z", "torque.x", "torque.y", "torque.z"};
        for (std::size_t k = 0; k < 6; ++k) {
            states[std::string("wrist/") + axes[k]] = std::make_shared<State>(reading[k], "wrist", axes[k]);
        }
        read();
    }

    template <class T> void set(const std::string &name, const T &value) { node->overrides[name] = rclcpp::ParameterValue(value); }

    Callback configure(unsigned rate = 1000)
    {
        controller->stub_init(node, rate);
        if (controller->on_init() != Callback::SUCCESS) { return Callback::ERROR; }
        const Callback done = controller->on_configure(state);
        if (done == Callback::SUCCESS) { references = controller->export_reference_interfaces(); }
        return done;
    }

    Callback activate()
    {
        std::vector<hardware_interface::LoanedCommandInterface> claimed;
        std::vector<hardware_interface::LoanedStateInterface> read_only;
        for (const auto &name : controller->command_interface_configuration().names) { claimed.emplace_back(commands.at(name)); }
        for (const auto &name : controller->state_interface_configuration().names) { read_only.emplace_back(states.at(name)); }
        controller->stub_assign(std::move(claimed), std::move(read_only));
        const Callback done = controller->on_activate(state);
        controller->stub_is_active = done == Callback::SUCCESS;
        return done;
    }

    void start(unsigned rate = 1000)
    {
        check(configure(rate) == Callback::SUCCESS, "configure");
        check(activate() == Callback::SUCCESS, "activate");
    }

    void read()
    {
        q = arm.q;
        dq = arm.dq;
    }

    // What the driver applies: the command; KUKA's nothing while a command is not a number.
    void write()
    {
        bool numbers = true;
        for (std::size_t i = 0; i < N; ++i) { numbers = numbers && std::isfinite(torque[i]) && std::isfinite(position[i]); }
        for (std::size_t i = 0; i < N; ++i) {
            const bool counts = driver == KUKA ? numbers : std::isfinite(torque[i]);
            applied[i] = counts ? torque[i] : 0.0;
        }
    }

    void update(double period = 1e-3)
    {
        node->clock = rclcpp::Time(node->clock.nanoseconds() + std::llround(1e9 * period));
        const long before = allocations;
        stub::world().in_update = true;
        const auto done = controller->update(node->clock, rclcpp::Duration::from_seconds(period));
        stub::world().in_update = false;
        allocated += allocations - before;
        is_ok = is_ok && done == controller_interface::return_type::OK;
        write();
    }

    void run(int cycles, double period = 1e-3)
    {
        for (int cycle = 0; cycle < cycles; ++cycle) {
            read();
            update(period);
            arm.step(applied, period);
        }
    }

    void spin()
    {
        for (const auto &each : node->timers) {
            if (const auto timer = each.lock()) { timer->callback(); }
        }
    }

    // Set parameters, and let the timer run that Humble's controller waits for.
    Result set_now(const std::vector<rclcpp::Parameter> &changes)
    {
        const Result result = node->set_parameters_atomically(changes);
        spin();
        return result;
    }
    template <class T> Result set_now(const std::string &name, const T &value) { return set_now({rclcpp::Parameter(name, value)}); }
    Result set_now(const std::string &name, const std::vector<double> &value) { return set_now({rclcpp::Parameter(name, value)}); }

    template <class Message> void publish(const std::string &topic, const Message &message, std::size_t publishers = 1)
    {
        const auto found = std::dynamic_pointer_cast<rclcpp::Subscription<Message>>(node->subscriptions.at(topic).lock());
        found->publishers = publishers;
        found->callback(message);
    }

    template <class Message> Message last(const std::string &topic)
    {
        const auto found = std::dynamic_pointer_cast<rclcpp_lifecycle::LifecyclePublisher<Message>>(node->publishers.at(topic).lock());
        check(!found->sent.empty(), "a message was published");
        return found->sent.empty() ? Message() : found->sent.back();
    }

    diagnostic_msgs::msg::DiagnosticStatus status()
    {
        spin();
        return last<diagnostic_msgs::msg::DiagnosticStatus>("~/state");
    }

    // Value of ~/state by its key.
    std::string told(const std::string &key)
    {
        for (const auto &each : status().values) {
            if (each.key == key) { return each.value; }
        }
        check(false, "the state has no such key");
        return "";
    }

    bool has_fault() { return status().level == diagnostic_msgs::msg::DiagnosticStatus::ERROR; }

    std_srvs::srv::Trigger::Response call_reset()
    {
        using Trigger = std_srvs::srv::Trigger;
        const auto response = std::make_shared<Trigger::Response>();
        std::dynamic_pointer_cast<rclcpp::Service<Trigger>>(node->services.at("~/reset").lock())
            ->callback(std::make_shared<Trigger::Request>(), response);
        return *response;
    }

    std::array<double, 3> tip() const
    {
        const auto pose = robot::forward_kinematics(arm.q);
        return {pose[3], pose[7], pose[11]};
    }

    // A message with the pose of the tip, and the frame that the controller wants.
    geometry_msgs::msg::PoseStamped pose_message() const
    {
        geometry_msgs::msg::PoseStamped message;
        message.header.frame_id = prefix + robot::BASE_FRAME;
        const auto pose = robot::forward_kinematics(arm.q);
        message.pose.position.x = pose[3];
        message.pose.position.y = pose[7];
        message.pose.position.z = pose[11];
        // (w, x, y, z) up to its sign: the largest column of 4 q q^T, which the rotation gives entry by entry
        const double xx = pose[0], yy = pose[5], zz = pose[10], xy = pose[1] + pose[4], xz = pose[2] + pose[8], yz = pose[6] + pose[9];
        const double x = pose[9] - pose[6], y = pose[2] - pose[8], z = pose[4] - pose[1];
        const double columns[4][4] = {{1 + xx + yy + zz, x, y, z}, {x, 1 + xx - yy - zz, xy, xz}, {y, xy, 1 - xx + yy - zz, yz},
            {z, xz, yz, 1 - xx - yy + zz}};
        int best = 0;
        for (int k = 1; k < 4; ++k) { best = columns[k][k] > columns[best][best] ? k : best; }
        const double norm = 2.0 * std::sqrt(columns[best][best]);
        message.pose.orientation.w = columns[best][0] / norm;
        message.pose.orientation.x = columns[best][1] / norm;
        message.pose.orientation.y = columns[best][2] / norm;
        message.pose.orientation.z = columns[best][3] / norm;
        return message;
    }
};

inline double distance(const std::array<double, 3> &a, const std::array<double, 3> &b)
{
    return std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}

inline double largest(const robot::Joints &values)
{
    double most = 0.0;
    for (const double each : values) { most = std::isfinite(each) ? std::max(most, std::abs(each)) : 1e300; }
    return most;
}

struct Scenario {
    const char *name;
    void (*run)();
};
extern const std::vector<Scenario> LIFECYCLE, COMMANDS, CHANGES, FAULTS, SENSOR;
