// SPDX-License-Identifier: MIT
// Scenarios: configuration, activation, and the torque that is left behind.
#include "rig.hpp"

static void holds_without_an_allocation()
{
    Rig rig;
    rig.start();
    const auto before = rig.tip();
    rig.run(2000);
    check(rig.is_ok, "every update is OK");
    check(distance(before, rig.tip()) < 1e-4, "the tip stays");
    check(rig.allocated == 0, "update allocates nothing");
    check(stub::world().logged_in_update == 0, "update logs nothing");
}

static void yields_and_returns()
{
    Rig rig;
    rig.start();
    const auto before = rig.tip();
    rig.arm.push[2] = 20.0;
    rig.run(2000);
    const double moved = distance(before, rig.tip());
    rig.arm.push[2] = 0.0;
    rig.run(4000);
    check(moved > 0.02 && moved < 0.1, "20 N at 400 N/m move the tip by some 0.05 m");
    check(distance(before, rig.tip()) < 3e-3, "the tip returns");
}

static void differences_positions_without_velocities()
{
    Rig late;
    late.set("velocity_interface", false);
    late.set("delay_samples", 5);
    check(late.configure() == Callback::FAILURE && stub::world().said("error", "delay_samples"), "it declares one more sample of delay");
    Rig rig;
    for (const char *joint : robot::JOINTS) { rig.states.erase(std::string(joint) + "/velocity"); }
    rig.set("velocity_interface", false);
    rig.set("position_quantum", 1e-5);
    rig.start();
    const double target = rig.arm.q[1] - 0.2;
    sensor_msgs::msg::JointState message;
    for (std::size_t i = 0; i < N; ++i) {
        message.name.push_back(robot::JOINTS[i]);
        message.position.push_back(rig.arm.q[i] + (i == 1 ? -0.2 : 0.0));
    }
    rig.publish("~/target_joint", message);
    for (int cycle = 0; cycle < 3000; ++cycle) {
        rig.read();
        for (double &each : rig.q) { each = 1e-5 * std::round(1e5 * each); }
        if (cycle % 100 == 50) { rig.q[3] = NOT_A_NUMBER; }
        rig.update();
        rig.arm.step(rig.applied, 1e-3);
    }
    check(std::abs(rig.arm.q[1] - target) < 0.01 && std::abs(rig.arm.dq[1]) < 0.01, "the arm gets there, and rests");
    check(!rig.has_fault() && rig.allocated == 0, "a single missing sample is no fault");
}

static void leaves_no_torque()
{
    for (const int end : {0, 1, 2}) {
        Rig rig;
        rig.start();
        rig.arm.push[2] = 20.0;
        rig.run(500);
        check(largest(rig.torque) > 1.0, "a torque is in force");
        const auto done = end == 0 ? rig.controller->on_deactivate(rig.state)
            : end == 1 ? rig.controller->on_error(rig.state)
                       : rig.controller->on_shutdown(rig.state);
        check(done == Callback::SUCCESS, "the end succeeds");
        check(largest(rig.torque) == 0.0, end == 0 ? "zero on deactivation" : end == 1 ? "zero on error" : "zero on shutdown");
    }
    Rig never;
    check(never.configure() == Callback::SUCCESS, "configure");
    check(never.controller->on_shutdown(never.state) == Callback::SUCCESS, "shutdown without claimed interfaces");
}

static void refuses_nan_at_activation()
{
    for (const bool velocity : {false, true}) {
        Rig rig;
        check(rig.configure() == Callback::SUCCESS, "configure");
        (velocity ? rig.dq : rig.q)[3] = NOT_A_NUMBER;
        check(rig.activate() == Callback::FAILURE, "NaN refused");
        check(stub::world().said("error", std::string(robot::JOINTS[3]) + (velocity ? "/velocity" : "/position")), "the interface is named");
        rig.read();
        check(rig.activate() == Callback::SUCCESS, "accepted once finite");
    }
}

static void starts_from_the_torque_in_force()
{
    Rig rig;
    rig.torque.fill(0.5);
    rig.torque[1] = 5.0;
    rig.torque[2] = NOT_A_NUMBER;
    rig.torque[N - 1] = 1e9;
    check(rig.configure() == Callback::SUCCESS && rig.activate() == Callback::SUCCESS, "activate");
    rig.update();
    const auto config = robot::Impedance::default_config();
    check(std::abs(rig.torque[1] - 5.0) <= 1e-3 * config.torque_rate_limit[1] + 1e-9, "no step of the torque");
    check(rig.torque[1] > 1.0, "the torque in force goes on");
    check(std::abs(rig.torque[2]) <= 1e-3 * config.torque_rate_limit[2] + 1e-9, "NaN counts as 0");
    const double limit = config.effort_limit[N - 1];
    check(rig.torque[N - 1] <= limit && rig.torque[N - 1] > 0.9 * limit, "clamped to the effort limit");
}

static void starts_again()
{
    Rig rig;
    rig.start();
    rig.arm.push[2] = 20.0;
    rig.run(300);
    check(rig.controller->on_deactivate(rig.state) == Callback::SUCCESS, "deactivate");
    rig.arm.push[2] = 0.0;
    rig.arm.dq.fill(0.0);
    rig.read();
    const auto here = rig.tip();
    check(rig.activate() == Callback::SUCCESS, "activate again");
    rig.run(1000);
    check(distance(here, rig.tip()) < 1e-3, "it holds the new position");
    check(rig.controller->on_deactivate(rig.state) == Callback::SUCCESS, "deactivate again");
    using Pose = geometry_msgs::msg::PoseStamped;
    const auto late = std::dynamic_pointer_cast<rclcpp::Subscription<Pose>>(rig.node->subscriptions.at("~/target_pose").lock())->callback;
    check(rig.controller->on_cleanup(rig.state) == Callback::SUCCESS, "clean up");
    late(rig.pose_message()); // a thread of the executor that was on its way
    check(rig.node->publishers.at("~/state").expired() && rig.node->subscriptions.at("~/target_pose").expired(), "nothing is left");
    rig.spin();
    check(rig.last<diagnostic_msgs::msg::DiagnosticArray>("/diagnostics").status[0].message == "unconfigured", "diagnostics go on");
    check(rig.controller->on_configure(rig.state) == Callback::SUCCESS, "configure again");
}

static void names_what_must_be_stated()
{
    for (const char *name : {"delay_samples", "motor_inertia", "heaviest_wrench"}) {
        Rig rig;
        rig.node->overrides.erase(name);
        check(rig.configure() == Callback::FAILURE, "refused on configuration");
        check(stub::world().said("error", std::string(name) + " [") && stub::world().said("error", "]: state it, since"), name);
    }
    Rig unknown;
    check(unknown.configure(0) == Callback::FAILURE, "no rate, no sample time");
    check(stub::world().said("error", "sample_time"), "sample_time is asked for");
    Rig given;
    given.set("sample_time", 0.001);
    check(given.configure(0) == Callback::SUCCESS, "sample_time in its place");
    Rig other;
    other.set("sample_time", 0.001);
    check(other.configure(500) == Callback::FAILURE, "a sample time that is not the rate's");
    check(stub::world().said("error", "sample_time is 0.001 s, but update_rate is 500 Hz"), "both are named");
}

static void reads_its_parameters()
{
    Rig typed;
    typed.set("wrench_timeout", std::string("soon"));
    check(typed.configure() == Callback::ERROR, "a parameter of another type");
    Rig few;
    few.set("joints", std::vector<std::string>{"one"});
    check(few.configure() == Callback::FAILURE && stub::world().said("error", "'joints' has 1 names"), "too few joints");
    Rig counted;
    counted.set("velocity_limit", std::vector<double>(N + 1, 0.7));
    check(counted.configure() == Callback::FAILURE && stub::world().said("error", "'velocity_limit' has"), "too many limits");
    Rig word;
    word.set("coriolis", "maybe");
    check(word.configure() == Callback::FAILURE && stub::world().said("error", "give 'off' or 'on'"), "an unknown word");
    Rig range;
    range.set("damping_ratio", -1.0);
    check(range.configure() == Callback::FAILURE && stub::world().said("error", "damping_ratio: must lie between"), "a field out of its range is named");
}

static void names_what_is_wrong_with_a_sensor()
{
    Rig alone;
    alone.set("ft_calibration", "sensor.json");
    check(alone.configure() == Callback::FAILURE && stub::world().said("error", "no ft_sensor"), "a calibration without a sensor");
    Rig other;
    other.set("ft_sensor", "wrist");
    other.set("ft_calibration", "no such file");
    check(other.configure() == Callback::FAILURE, "a file that is not there");
    check(stub::world().said("error", STIFFGEN_ROS2_SENSOR ? "'no such file' is not a file of" : "--sensor LINK"), "the remedy is named");
}

static void takes_a_prefix()
{
    Rig rig("left_");
    rig.set("prefix", "left_");
    rig.start();
    rig.run(200);
    check(rig.is_ok && !rig.has_fault(), "joints with a prefix");
    check(rig.last<geometry_msgs::msg::PoseStamped>("~/pose").header.frame_id == std::string("left_") + robot::BASE_FRAME, "frame");
}

static void set_reference(Rig &rig, double value)
{
#if RCLCPP_VERSION_MAJOR < 21
    rig.references[0].set_value(value);
#else
    check(rig.references[0]->set_value(value), "write");
#endif
}

static void start_chained(Rig &rig)
{
    check(rig.configure() == Callback::SUCCESS, "configure");
    check(rig.controller->set_chained_mode(true), "chained");
    check(rig.activate() == Callback::SUCCESS, "activate");
}

static void exports_references_and_follows_them()
{
    Rig rig;
    start_chained(rig);
    check(rig.references.size() == N, "a reference for each joint");
    const double target = rig.arm.q[0] + 0.2;
    rig.run(100);
    check(std::abs(rig.arm.q[0] - target + 0.2) < 1e-3, "it begins where the arm is");
#if RCLCPP_VERSION_MAJOR < 21
    check(rig.references[0].get_name() == "arm/" + std::string(robot::JOINTS[0]) + "/position", "name");
#else
    check(rig.references[0]->get_name() == "arm/" + std::string(robot::JOINTS[0]) + "/position", "name");
#endif
    set_reference(rig, target);
    rig.run(3000);
    check(std::abs(rig.arm.q[0] - target) < 0.02, "it follows the reference");
    set_reference(rig, target * 180.0 / 3.14159265358979);
    for (int k = 0; k < 3; ++k) {
        rig.run(200);
        rig.spin();
    }
    check(stub::world().times("commands refused: 1; the last one: q0 of ") == 1, "degrees are refused, told once");
    check(stub::world().logged_in_update == 0 && rig.allocated == 0, "and not in the loop");
    const auto refusal = rig.status().values.back();
    check(refusal.key == "last refusal" && refusal.value.find("in radians") != std::string::npos, "the state tells it");
    check(std::abs(rig.arm.q[0] - target) < 0.02 && !rig.has_fault(), "the arm stays");
}

static void references_lead_in_chained_mode()
{
    Rig rig;
    rig.set("policy", true);
    start_chained(rig);
    const double target = rig.arm.q[0] + 0.2;
    sensor_msgs::msg::JointState joints;
    for (std::size_t i = 0; i < N; ++i) {
        joints.name.push_back(robot::JOINTS[i]);
        joints.position.push_back(rig.arm.q[i]);
    }
    geometry_msgs::msg::WrenchStamped wrench;
    wrench.header.frame_id = robot::BASE_FRAME;
    std_msgs::msg::Float64MultiArray stiffness;
    stiffness.data.assign(36, 0.0);
    for (std::size_t k = 0; k < 6; ++k) { stiffness.data[7 * k] = k < 3 ? 400.0 : 20.0; }
    set_reference(rig, target);
    for (int k = 0; k < 60; ++k) {
        rig.publish("~/target_joint", joints);
        rig.publish("~/target_pose", rig.pose_message());
        rig.publish("~/target_wrench", wrench);
        rig.publish("~/stiffness", stiffness);
        rig.run(50);
    }
    check(std::abs(rig.arm.q[0] - target) < 0.02, "the arm follows the references alone");
    for (const char *topic : {"~/target_joint", "~/target_pose"}) {
        check(stub::world().times(topic + std::string(" is refused: another controller writes the references")) == 1, "told once");
    }
    check(stub::world().times("is refused") == 2, "a wrench and a stiffness are accepted");
}

const std::vector<Scenario> LIFECYCLE = {
    {"holds_without_an_allocation", holds_without_an_allocation},
    {"yields_and_returns", yields_and_returns},
    {"differences_positions_without_velocities", differences_positions_without_velocities},
    {"leaves_no_torque", leaves_no_torque},
    {"refuses_nan_at_activation", refuses_nan_at_activation},
    {"starts_from_the_torque_in_force", starts_from_the_torque_in_force},
    {"starts_again", starts_again},
    {"names_what_must_be_stated", names_what_must_be_stated},
    {"reads_its_parameters", reads_its_parameters},
    {"names_what_is_wrong_with_a_sensor", names_what_is_wrong_with_a_sensor},
    {"takes_a_prefix", takes_a_prefix},
    {"exports_references_and_follows_them", exports_references_and_follows_them},
    {"references_lead_in_chained_mode", references_lead_in_chained_mode},
};
