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

const std::vector<Scenario> SENSOR = {
    {"refuses_the_calibration_of_another_sensor", refuses_the_calibration_of_another_sensor},
    {"measures_the_wrench_at_the_tip", measures_the_wrench_at_the_tip},
    {"goes_on_without_a_reading", goes_on_without_a_reading},
};

#else

const std::vector<Scenario> SENSOR;

#endif
