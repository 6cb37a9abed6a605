// SPDX-License-Identifier: MIT
// Scenarios: samples that are late, missing or wrong, and drivers with rules of their own.
#include "rig.hpp"

static void late_cycles_are_no_sensor_fault()
{
    Rig rig;
    rig.start();
    const robot::Joints before = rig.arm.q;
    double time = 0.0;
    for (int cycle = 0; cycle < 1000; ++cycle) { // led by hand, at up to 1 rad/s
        const double period = cycle % 10 == 9 ? 3e-3 : 1e-3;
        time += period;
        for (std::size_t i = 0; i < N; ++i) {
            const double inwards = 2.0 * before[i] > robot::LOWER[i] + robot::UPPER[i] ? -1.0 : 1.0;
            rig.arm.q[i] = before[i] + inwards * 0.2 * (1.0 - std::cos(5.0 * time));
            rig.arm.dq[i] = inwards * std::sin(5.0 * time);
        }
        rig.read();
        rig.update(period);
    }
    check(!rig.has_fault(), "each tenth cycle three times as long");
}

static void a_wrong_rate_is_told()
{
    Rig rig;
    rig.start();
    for (int k = 0; k < 20; ++k) {
        rig.run(50, 2e-3);
        rig.spin();
    }
    check(stub::world().times("updates in a row came too late: the manager does not keep its update_rate") == 1, "half of the rate");
    check(!rig.has_fault(), "which the account covers");
    rig.run(100, 1e-2);
    check(rig.has_fault() && stub::world().said("error", "calls are missing"), "a tenth of the rate");
    check(largest(rig.torque) < 5.0, "the arm is released");
}

static void tells_a_fault_once_and_resets()
{
    Rig rig;
    rig.start();
    const auto before = rig.tip();
    rig.run(100);
    for (int cycle = 0; cycle < 100; ++cycle) {
        rig.read();
        rig.q[4] = NOT_A_NUMBER;
        rig.update();
        rig.arm.step(rig.applied, 1e-3);
        if (cycle % 20 == 0) { rig.spin(); }
    }
    check(rig.has_fault(), "a fault");
    check(largest(rig.torque) < 5.0, "torques are finite, and small");
    check(stub::world().times("fault: ") == 1 && stub::world().said("error", "NaN, infinite"), "logged once, with its reason");
    check(rig.status().message.find("NaN, infinite") != std::string::npos, "the state has the reason");
    check(stub::world().logged_in_update == 0 && rig.allocated == 0, "no log and no allocation in update");
    rig.run(500);
    check(rig.has_fault(), "latched");
    const auto answer = rig.call_reset();
    check(answer.success && answer.message.find("NaN, infinite") != std::string::npos, "reset tells what it resets");
    rig.run(4000);
    check(!rig.has_fault() && distance(before, rig.tip()) < 3e-3, "back under control");
    check(rig.call_reset().message == "no fault was latched", "nothing to reset");
}

static void tells_the_fault_of_each_activation()
{
    Rig rig;
    rig.arm.q[1] = robot::UPPER[1] + 0.5;
    for (int activation = 1; activation < 4; ++activation) {
        rig.read();
        if (activation == 1) {
            rig.start();
        } else {
            check(rig.activate() == Callback::SUCCESS, "activate");
        }
        rig.update();
        check(rig.has_fault(), "beyond its limit");
        check(stub::world().times("fault: ") == activation && stub::world().said("error", "beyond its limit"), "told each time");
        check(rig.controller->on_deactivate(rig.state) == Callback::SUCCESS, "deactivate");
    }
}

static void kuka_needs_position_and_torque()
{
    for (const bool both : {false, true}) {
        Rig rig;
        rig.driver = Rig::KUKA;
        rig.set("command_position", both);
        rig.start();
        rig.arm.push[2] = 10.0;
        rig.run(300);
        const bool moves_freely = largest(rig.applied) == 0.0;
        check(moves_freely == !both, both ? "torque counts with command_position" : "without it the torque does not count");
        double away = 0.0;
        for (std::size_t i = 0; i < N && both; ++i) { away = std::max(away, std::abs(rig.position[i] - rig.arm.q[i])); }
        check(away < 1e-2, "the position commanded is the measured one");
    }
}

static void an_interface_that_is_locked()
{
#if RCLCPP_VERSION_MAJOR >= 21
    Rig rig;
    rig.start();
    rig.run(100);
    auto &state = *rig.states.at(std::string(robot::JOINTS[1]) + "/position"); // far from 0
    for (int k = 0; k < 50; ++k) {
        state.locked = k % 10 < 2;
        rig.run(1);
    }
    check(!rig.has_fault() && rig.is_ok, "a sample now and then is missing");
    auto &command = *rig.commands.at(std::string(robot::JOINTS[2]) + "/effort");
    command.locked = true;
    rig.run(1);
    check(rig.is_ok, "one torque that is not taken");
    rig.run(5);
    check(!rig.is_ok, "many are an error: the driver goes on with an old torque");
    check(rig.controller->on_deactivate(rig.state) == Callback::ERROR, "a torque that stays in force is an error");
    check(stub::world().said("error", "could not be set to zero"), "and told");
    command.locked = false;
    check(rig.controller->on_error(rig.state) == Callback::SUCCESS && largest(rig.torque) == 0.0, "zero once it can be written");
#endif
}

static void a_wild_period_is_survived()
{
    Rig rig;
    rig.start();
    for (const double period : {0.0, -1.0, 1e-9, 5.0}) {
        rig.read();
        rig.update(period);
    }
    check(largest(rig.torque) < 50.0, "torques are finite");
    rig.run(100);
    check(rig.is_ok, "and it goes on");
}

static void a_frozen_position_is_a_fault()
{
    for (const bool differenced : {false, true}) {
        Rig rig;
        rig.set("velocity_interface", !differenced);
        rig.start();
        sensor_msgs::msg::JointState message;
        for (std::size_t i = 0; i < N; ++i) {
            message.name.push_back(robot::JOINTS[i]);
            message.position.push_back(rig.arm.q[i] + (i == 1 ? 0.3 : 0.0));
        }
        rig.publish("~/target_joint", message);
        rig.read();
        const double frozen = rig.q[1];
        for (int cycle = 0; cycle < 500; ++cycle) { // its velocity is the quotient of a position that does not change
            rig.read();
            rig.q[1] = frozen;
            rig.dq[1] = 0.0;
            rig.update();
            rig.arm.step(rig.applied, 1e-3);
        }
        check(rig.has_fault() && stub::world().said("error", "stands still"), differenced ? "seen without velocities" : "seen with velocities");
    }
}

static void a_torque_of_the_wrong_sign_is_a_fault()
{
    Rig rig;
    rig.set("compensate_gravity", true);
    rig.start();
    rig.arm.push[2] = -10.0;
    for (int cycle = 0; cycle < 2000; ++cycle) {
        rig.read();
        rig.update();
        for (double &each : rig.applied) { each = -each; }
        rig.arm.step(rig.applied, 1e-3);
    }
    check(rig.has_fault() && stub::world().said("error", "although it is braked: look at sign and order of the joints"), "DISSIPATION");
    check(largest(rig.torque) == 0.0, "no torque is left, not even gravity's");
}

static void a_pose_goes_on_after_a_fault()
{
    Rig rig;
    rig.start();
    rig.run(100);
    auto message = rig.pose_message();
    message.pose.position.z -= 0.2;
    rig.publish("~/target_pose", message);
    rig.run(300); // on its way
    rig.q[2] = NOT_A_NUMBER;
    for (int cycle = 0; cycle < 3; ++cycle) { rig.update(); }
    rig.run(2000);
    const auto left = rig.tip();
    check(rig.has_fault() && std::abs(left[2] - message.pose.position.z) > 0.02, "a fault on its way");
    rig.call_reset();
    rig.run(50);
    check(rig.status().values[1].value.find("MOVING") != std::string::npos, "Follow begins where the arm is");
    double fastest = 0.0;
    for (int cycle = 0; cycle < 4000; ++cycle) {
        const auto before = rig.tip();
        rig.run(1);
        fastest = std::max(fastest, 1e3 * distance(before, rig.tip()));
    }
    check(std::abs(rig.tip()[2] - message.pose.position.z) < 3e-3 && !rig.has_fault(), "the pose is reached after the reset");
    check(fastest < 1.0, "by a ramp from where the arm was, below tip_velocity_limit");
}

const std::vector<Scenario> FAULTS = {
    {"a_torque_of_the_wrong_sign_is_a_fault", a_torque_of_the_wrong_sign_is_a_fault},
    {"a_pose_goes_on_after_a_fault", a_pose_goes_on_after_a_fault},
    {"a_frozen_position_is_a_fault", a_frozen_position_is_a_fault},
    {"late_cycles_are_no_sensor_fault", late_cycles_are_no_sensor_fault},
    {"a_wrong_rate_is_told", a_wrong_rate_is_told},
    {"tells_a_fault_once_and_resets", tells_a_fault_once_and_resets},
    {"tells_the_fault_of_each_activation", tells_the_fault_of_each_activation},
    {"kuka_needs_position_and_torque", kuka_needs_position_and_torque},
    {"an_interface_that_is_locked", an_interface_that_is_locked},
    {"a_wild_period_is_survived", a_wild_period_is_survived},
};
