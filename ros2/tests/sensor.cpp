// SPDX-License-Identifier: MIT
// Scenarios of a robot that was generated with a force-torque sensor. test_sensor.py writes the files of calibrations.
#include "rig.hpp"

#if STIFFGEN_ROS2_SENSOR

static const robot::Wrench BIAS = {1.0, -2.0, 3.0, 0.1, 0.2, -0.3};
static const std::array<double, 4> PAYLOAD = {1.5, 0.01, -0.02, 0.06};

static void refuses_the_calibration_of_another_sensor()
{
    Rig rig;
    rig.set("ft_sensor", "wrist");
    rig.set("ft_calibration", "other.json");
    check(rig.configure() == Callback::FAILURE && stub::world().said("error", "'other.json' is of another sensor"), "another sensor");
}

static void run(Rig &rig, int cycles)
{
    for (int cycle = 0; cycle < cycles; ++cycle) {
        rig.reading = robot::sensor::reading(rig.arm.q, rig.arm.push, BIAS, PAYLOAD);
        rig.run(1);
    }
}

static void measures_the_wrench_at_the_tip()
{
    Rig rig;
    rig.set("ft_sensor", "wrist");
    rig.set("ft_calibration", "calibration.json");
    rig.start();
    rig.arm.push = {3.0, -4.0, 20.0, 0.4, -0.3, 0.2};
    run(rig, 3000);
    rig.spin();
    check(rig.is_ok && rig.allocated == 0, "update allocates nothing");
    using Stamped = geometry_msgs::msg::WrenchStamped;
    const auto measured = rig.last<Stamped>("~/measured_wrench"), springs = rig.last<Stamped>("~/wrench");
    check(measured.header.frame_id == robot::BASE_FRAME, "axes of the base");
    const robot::Wrench seen = {measured.wrench.force.x, measured.wrench.force.y, measured.wrench.force.z,
        measured.wrench.torque.x, measured.wrench.torque.y, measured.wrench.torque.z};
    for (std::size_t k = 0; k < 6; ++k) { check(std::abs(seen[k] + rig.arm.push[k]) < 1e-4, "the tip exerts the push's opposite"); }
    check(springs.wrench.force.z < -5.0, "the tip's springs carry a share with the same sign; the joints' carry the other one");
}

static void goes_on_without_a_reading()
{
    Rig rig;
    rig.set("ft_sensor", "wrist");
    check(rig.configure() == Callback::SUCCESS, "configured without a calibration");
    rig.reading[1] = NOT_A_NUMBER;
    check(rig.activate() == Callback::FAILURE && stub::world().said("error", "wrist/force.y"), "the interface is named");
    rig.reading[1] = 0.0;
    check(rig.activate() == Callback::SUCCESS, "accepted once finite");
    rig.reading[1] = NOT_A_NUMBER;
    rig.run(200);
    check(rig.is_ok && !rig.has_fault(), "the springs need no reading");
    const auto topic = std::dynamic_pointer_cast<rclcpp_lifecycle::LifecyclePublisher<geometry_msgs::msg::WrenchStamped>>(
        rig.node->publishers.at("~/measured_wrench").lock());
    check(topic->sent.empty(), "nothing is published");
}

static geometry_msgs::msg::WrenchStamped press_message(double down)
{
    geometry_msgs::msg::WrenchStamped message;
    message.header.frame_id = robot::BASE_FRAME;
    message.wrench.force.z = -down;
    return message;
}

// Run against a floor of 1e4 N/m at a height [m], with damping.
static void run_on_floor(Rig &rig, int cycles, double height)
{
    double last = rig.tip()[2];
    for (int cycle = 0; cycle < cycles; ++cycle) {
        const double z = rig.tip()[2], speed = (z - last) / 1e-3;
        last = z;
        rig.arm.push[2] = z < height ? std::max(0.0, 1e4 * (height - z) - 50.0 * speed) : 0.0;
        run(rig, 1);
    }
}

static void presses_on_a_floor_and_stops_where_it_ends()
{
    Rig rig;
    rig.set("ft_sensor", "wrist");
    rig.set("ft_calibration", "calibration.json");
    rig.start();
    const double floor = rig.tip()[2] - 0.02;
    rig.publish("~/settle", [] { std_msgs::msg::Float64MultiArray message; message.data = {20.0, 3.0}; return message; }());
    rig.publish("~/press", press_message(15.0));
    run_on_floor(rig, 6000, floor);
    check(std::abs(rig.arm.push[2] - 15.0) < 0.5, "the force is held");
    check(rig.told("press") == "CONTACT", "the state says so");
    check(rig.told("settle").find("HELD") != std::string::npos, "Settle holds its offset meanwhile");
    check(rig.is_ok && rig.allocated == 0, "update allocates nothing");
    const auto before = rig.tip();
    run_on_floor(rig, 2000, floor - 1.0);
    check(rig.told("press") == "LOST", "contact is lost");
    check(distance(before, rig.tip()) < 0.025, "the tip stops");
    rig.publish("~/press", press_message(0.0));
    run_on_floor(rig, 3000, floor - 1.0);
    check(rig.told("press") == "OFF", "0 ends it");
    check(std::abs(rig.tip()[2] - floor - 0.02) < 2e-3, "the tip is back at its pose");
    check(!rig.has_fault(), "no fault");
}

static void refuses_a_bad_press()
{
    Rig rig;
    rig.set("ft_sensor", "wrist");
    rig.start();
    auto message = press_message(60.0);
    rig.publish("~/press", message);
    check(stub::world().said("warn", "above half of heaviest_wrench, 50"), "too much");
    message = press_message(NOT_A_NUMBER);
    rig.publish("~/press", message);
    check(stub::world().said("warn", "its force is not finite"), "NaN");
    message = press_message(15.0);
    message.wrench.torque.x = 1.0;
    rig.publish("~/press", message);
    check(stub::world().said("warn", "its torque must be 0"), "a torque");
    message = press_message(15.0);
    message.header.frame_id = "tool";
    rig.publish("~/press", message);
    check(stub::world().said("warn", "its frame_id is 'tool'"), "another frame");
    rig.run(10);
    check(rig.told("press") == "OFF", "nothing is pressed");
}

const std::vector<Scenario> SENSOR = {
    {"refuses_the_calibration_of_another_sensor", refuses_the_calibration_of_another_sensor},
    {"measures_the_wrench_at_the_tip", measures_the_wrench_at_the_tip},
    {"goes_on_without_a_reading", goes_on_without_a_reading},
    {"presses_on_a_floor_and_stops_where_it_ends", presses_on_a_floor_and_stops_where_it_ends},
    {"refuses_a_bad_press", refuses_a_bad_press},
};

#else

const std::vector<Scenario> SENSOR;

#endif
