// SPDX-License-Identifier: MIT
// Scenarios: time stamps of another clock, and parameters that change beside commands.
#include "rig.hpp"

using Numbers = std_msgs::msg::Float64MultiArray;

static Numbers stiffness(double translation, double rotation)
{
    Numbers message;
    message.data.assign(36, 0.0);
    for (std::size_t k = 0; k < 6; ++k) { message.data[7 * k] = k < 3 ? translation : rotation; }
    return message;
}

static rclcpp::Time later(const Rig &rig, double seconds)
{
    return rclcpp::Time(rig.node->now().nanoseconds() + std::llround(1e9 * seconds));
}

static double deflection(Rig &rig)
{
    rig.arm.push[2] = 0.0;
    rig.run(3000);
    const double before = rig.tip()[2];
    rig.arm.push[2] = 5.0;
    rig.run(3000);
    return rig.tip()[2] - before;
}

static void refuses_a_wrench_of_the_future()
{
    Rig rig;
    rig.node->clock = rclcpp::Time(100000000000LL); // simulated time
    rig.start();
    const auto before = rig.tip();
    geometry_msgs::msg::WrenchStamped message;
    message.header.frame_id = robot::BASE_FRAME;
    message.wrench.force.z = -15.0;
    message.header.stamp = later(rig, 1.7e9); // wall time
    rig.publish("~/target_wrench", message);
    rig.run(1000);
    check(distance(before, rig.tip()) < 1e-4, "it does not press");
    check(stub::world().said("warn", "~/target_wrench is refused: its stamp lies 1.7e+09 s ahead"), "told");
    message.header.stamp = later(rig, 0.09); // clocks of two computers
    rig.publish("~/target_wrench", message);
    rig.run(480);
    check(rig.tip()[2] < before[2] - 1e-3, "a small lead is accepted");
    const double deepest = rig.tip()[2];
    rig.run(120);
    rig.publish("~/stiffness", stiffness(400.0, 20.0)); // whatever else comes
    rig.run(3000);
    check(std::abs(rig.tip()[2] - before[2]) < 3e-3 && deepest < before[2], "and does not lengthen the wrench");
}

static void refuses_an_old_wrench()
{
    Rig rig;
    rig.node->clock = rclcpp::Time(100000000000LL);
    rig.start();
    geometry_msgs::msg::WrenchStamped message;
    message.header.frame_id = robot::BASE_FRAME;
    message.wrench.force.z = -15.0;
    message.header.stamp = later(rig, -0.6);
    rig.publish("~/target_wrench", message);
    check(stub::world().said("warn", "~/target_wrench is refused: its stamp is 0.6 s old, and wrench_timeout is 0.5 s"), "told");
}

static void refuses_targets_of_another_time()
{
    for (const double age : {3600.0, -3600.0}) {
        Rig rig;
        rig.node->clock = rclcpp::Time(10000000000000LL);
        rig.start();
        const auto before = rig.tip();
        auto pose = rig.pose_message();
        pose.pose.position.z -= 0.1;
        pose.header.stamp = later(rig, -age);
        rig.publish("~/target_pose", pose);
        sensor_msgs::msg::JointState joints;
        for (std::size_t i = 0; i < N; ++i) {
            joints.name.push_back(robot::JOINTS[i]);
            joints.position.push_back(rig.arm.q[i] + (i == 1 ? -0.2 : 0.0));
        }
        joints.header.stamp = pose.header.stamp;
        rig.publish("~/target_joint", joints);
        rig.run(1000);
        check(distance(before, rig.tip()) < 1e-4, "the arm stays");
        const std::string said = age > 0.0 ? "is refused: its stamp is 3600 s old" : "is refused: its stamp lies 3600 s ahead";
        check(stub::world().times(said) == 2, "both told");
        joints.header.stamp = pose.header.stamp = later(rig, -0.9);
        rig.publish("~/target_joint", joints);
        rig.publish("~/target_pose", pose);
        check(stub::world().times("is refused") == 2, "a second is young enough");
        joints.header.stamp = builtin_interfaces::msg::Time();
        rig.publish("~/target_joint", joints);
        check(stub::world().times("is refused") == 2, "a stamp of zero is now");
    }
}

static void takes_older_targets_if_told_so()
{
    Rig rig;
    rig.set("target_timeout", 7200.0);
    rig.node->clock = rclcpp::Time(10000000000000LL);
    rig.start();
    auto pose = rig.pose_message();
    pose.header.stamp = later(rig, -3600.0);
    rig.publish("~/target_pose", pose);
    check(stub::world().times("is refused") == 0, "two hours");
    check(!rig.set_now("target_timeout", 0.0).successful && rig.set_now("target_timeout", 1.0).successful, "above 0");
    rig.publish("~/target_pose", pose);
    check(stub::world().said("warn", "target_timeout is 1 s"), "now one second");
}

static void refuses_a_joint_that_is_named_twice()
{
    {
        Rig rig;
        rig.set("joints", std::vector<std::string>(N, "A1"));
        check(rig.configure() == Callback::FAILURE && stub::world().said("error", "'A1' twice"), "one name for all");
    }
    {
        Rig rig;
        std::vector<std::string> names(robot::JOINTS, robot::JOINTS + N);
        names[2].clear();
        rig.set("joints", names);
        check(rig.configure() == Callback::FAILURE && stub::world().said("error", "name 3 is empty"), "an empty name");
    }
    Rig rig;
    rig.start();
    sensor_msgs::msg::JointState message;
    for (std::size_t i = 0; i <= N; ++i) { // the first one again at the end, elsewhere
        message.name.push_back(robot::JOINTS[i % N]);
        message.position.push_back(rig.arm.q[i % N] + (i == N ? 0.2 : 0.0));
    }
    rig.publish("~/target_joint", message);
    check(stub::world().said("warn", "joint '" + std::string(robot::JOINTS[0]) + "' is given twice"), "in a message");
}

static void refuses_integers_that_do_not_fit()
{
    for (const char *name : {"missed_limit", "delay_samples", "call_gap_limit"}) {
        for (const std::int64_t value : {4294967299LL, -4294967293LL}) { // 3 in 32 bits
            Rig rig;
            rig.set(name, value);
            check(rig.configure() == Callback::FAILURE && stub::world().said("error", name) && stub::world().said("error", "must lie between"), name);
        }
        Rig rig;
        rig.start();
        const Result result = rig.set_now(name, std::int64_t{4294967299LL});
        check(!result.successful && result.reason.find("must lie between") != std::string::npos, name);
    }
}

static void keeps_the_commanded_stiffness()
{
    Rig rig;
    rig.start();
    rig.publish("~/stiffness", stiffness(1600.0, 80.0));
    const double commanded = deflection(rig);
    check(rig.set_now("damping_ratio", 1.0).successful && rig.set_now("wrench_timeout", 0.4).successful, "others");
    check(rig.set_now("gravity", {0.0, 0.0, -9.0}).successful, "gravity");
    check(std::abs(deflection(rig) / commanded - 1.0) < 0.02, "the commanded stiffness stays");
    check(rig.set_now("rotation_stiffness", std::vector<double>(3, 80.0)).successful, "rotation alone");
    check(std::abs(deflection(rig) / commanded - 1.0) < 0.02, "the translation stays");
    check(rig.set_now("translation_stiffness", std::vector<double>(3, 400.0)).successful, "the value that the parameter has");
    check(deflection(rig) > 2.0 * commanded, "is commanded anew");
    rig.publish("~/stiffness", stiffness(1600.0, 80.0));
    check(std::abs(deflection(rig) / commanded - 1.0) < 0.02, "the newest counts");
    check(!rig.has_fault() && rig.allocated == 0, "no fault, no allocation");
}

static void keeps_the_commanded_stiffness_of_a_policy()
{
    Rig rig;
    rig.set("policy", true);
    rig.start();
    rig.publish("~/stiffness", stiffness(1600.0, 80.0));
    auto message = rig.pose_message();
    rig.arm.push[2] = 5.0;
    const double before = rig.tip()[2];
    const auto proposed = [&](double translation) { // 20 Hz
        for (int k = 0; k < 60; ++k) {
            message.header.stamp = rig.node->now();
            rig.publish("~/target_pose", message);
            if (translation > 0.0) { rig.publish("~/stiffness", stiffness(translation, 80.0)); }
            rig.run(50);
        }
        return rig.tip()[2] - before;
    };
    const double stiff = proposed(1600.0);
    rig.set_now("rotation_stiffness", std::vector<double>(3, 80.0));
    check(std::abs(proposed(0.0) / stiff - 1.0) < 0.02, "the translation stays");
    rig.set_now("translation_stiffness", std::vector<double>(3, 400.0));
    check(proposed(0.0) > 2.0 * stiff, "the parameter counts");
    check(std::abs(proposed(1600.0) / stiff - 1.0) < 0.02, "until another one is commanded");
    check(!rig.has_fault(), "no fault");
}

static void a_new_activation_begins_with_the_parameters()
{
    Rig rig;
    rig.start();
    const double soft = deflection(rig);
    rig.publish("~/stiffness", stiffness(1600.0, 80.0));
    check(deflection(rig) < 0.5 * soft, "stiff");
    check(rig.controller->on_deactivate(rig.state) == Callback::SUCCESS, "deactivate");
    rig.arm.push[2] = 0.0;
    rig.arm.dq.fill(0.0);
    rig.read();
    check(rig.activate() == Callback::SUCCESS, "activate");
    check(std::abs(deflection(rig) / soft - 1.0) < 0.1, "as the parameters say");
}

// Return the largest change of a torque in an update, over its limit.
static double largest_change(Rig &rig, int cycles)
{
    const auto config = robot::Impedance::default_config();
    double most = 0.0;
    for (int cycle = 0; cycle < cycles; ++cycle) {
        const robot::Joints before = rig.torque;
        rig.run(1);
        for (std::size_t i = 0; i < N; ++i) {
            most = std::max(most, std::abs(rig.torque[i] - before[i]) / (1e-3 * config.torque_rate_limit[i]));
        }
    }
    return most;
}

static void another_configuration_restarts_the_controller()
{
    Rig rig;
    rig.start();
    rig.arm.push[2] = 10.0;
    check(rig.set_now("wrench_timeout", 0.4).successful && rig.set_now("posture_stiffness", {2.0}).successful, "no configuration");
    rig.run(5000);
    const auto before = rig.tip();
    rig.spin();
    check(stub::world().times("restarted with another configuration") == 0, "goes on");
    check(rig.set_now("damping_ratio", 1.0).successful, "configuration");
    check(largest_change(rig, 100) <= 1.0 + 1e-9, "the torque in force goes on at its rate limit");
    rig.run(5000);
    rig.spin();
    check(stub::world().times("restarted with another configuration, from the torque in force") == 1, "told once");
    check(distance(before, rig.tip()) < 1e-3, "the arm is back where it was");
    rig.run(10);
    for (int cycle = 0; cycle < 5; ++cycle) {
        rig.read();
        rig.q[4] = NOT_A_NUMBER;
        rig.update();
    }
    check(rig.set_now("damping_ratio", 0.8).successful, "accepted during a fault");
    rig.run(500);
    check(rig.has_fault(), "which it does not end");
    rig.call_reset();
    rig.run(500);
    check(!rig.has_fault() && stub::world().times("restarted with another configuration") == 2, "it counts after the reset");
    check(rig.allocated == 0 && stub::world().logged_in_update == 0, "no allocation, no log");
}

static void a_restart_keeps_gravitys_torque()
{
    Rig rig;
    rig.set("compensate_gravity", true);
    rig.start();
    rig.read();
    const auto rest = [&rig, q = rig.q](int cycle) { // on a stand; the encoders' last bits move
        for (std::size_t i = 0; i < N; ++i) { rig.q[i] = q[i] + 1e-9 * (cycle % 2); }
        rig.update();
    };
    for (int k = 0; k < 300; ++k) { rest(k); }
    const robot::Joints before = rig.torque;
    check(rig.set_now("damping_ratio", 1.0).successful, "configuration");
    double away = 0.0;
    for (int k = 0; k < 100; ++k) {
        rest(k);
        for (std::size_t i = 0; i < N; ++i) { away = std::max(away, std::abs(rig.torque[i] - before[i])); }
    }
    check(largest(before) > 1.0 && away < 0.05, "the torque stays");
}

static void a_refused_change_does_not_act()
{
    Rig rig;
    bool refuses = false; // registered before the controller's callback, and called after it
    const auto other = rig.node->add_on_set_parameters_callback([&refuses](const std::vector<rclcpp::Parameter> &) {
        Result result;
        result.successful = !refuses;
        result.reason = "another callback refuses";
        return result;
    });
    rig.start();
    rig.publish("~/stiffness", stiffness(1600.0, 80.0));
    const double commanded = deflection(rig);
    refuses = true;
    check(!rig.set_now("translation_stiffness", std::vector<double>(3, 200.0)).successful, "refused by a later callback");
    check(!rig.set_now("heaviest_wrench", std::vector<double>{1.0, 1.0}).successful, "and another one");
    geometry_msgs::msg::WrenchStamped message;
    message.header.frame_id = robot::BASE_FRAME;
    message.wrench.force.z = -10.0;
    rig.publish("~/target_wrench", message);
    check(stub::world().times("larger than heaviest_wrench") == 0, "the topics keep their limits");
    rig.run(1000);
    check(std::abs(deflection(rig) / commanded - 1.0) < 0.02, "the stiffness stays");
}

static void the_last_of_two_values_counts()
{
    Rig rig;
    rig.start();
    const rclcpp::Parameter good("wrench_timeout", 0.3), bad("wrench_timeout", -1.0);
    check(!rig.set_now(std::vector<rclcpp::Parameter>{good, bad}).successful, "the value that would be in force is checked");
    check(rig.set_now(std::vector<rclcpp::Parameter>{bad, good}).successful, "and it alone");
}

const std::vector<Scenario> CHANGES = {
    {"refuses_a_wrench_of_the_future", refuses_a_wrench_of_the_future},
    {"refuses_an_old_wrench", refuses_an_old_wrench},
    {"refuses_targets_of_another_time", refuses_targets_of_another_time},
    {"takes_older_targets_if_told_so", takes_older_targets_if_told_so},
    {"refuses_a_joint_that_is_named_twice", refuses_a_joint_that_is_named_twice},
    {"refuses_integers_that_do_not_fit", refuses_integers_that_do_not_fit},
    {"keeps_the_commanded_stiffness", keeps_the_commanded_stiffness},
    {"keeps_the_commanded_stiffness_of_a_policy", keeps_the_commanded_stiffness_of_a_policy},
    {"a_new_activation_begins_with_the_parameters", a_new_activation_begins_with_the_parameters},
    {"another_configuration_restarts_the_controller", another_configuration_restarts_the_controller},
    {"a_restart_keeps_gravitys_torque", a_restart_keeps_gravitys_torque},
    {"a_refused_change_does_not_act", a_refused_change_does_not_act},
    {"the_last_of_two_values_counts", the_last_of_two_values_counts},
};
