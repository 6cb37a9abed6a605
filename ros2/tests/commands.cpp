// SPDX-License-Identifier: MIT
// Scenarios: topics and parameters of a running controller.
#include "rig.hpp"

using Numbers = std_msgs::msg::Float64MultiArray;

static Numbers diagonal(double translation, double rotation)
{
    Numbers message;
    message.data.assign(36, 0.0);
    for (std::size_t k = 0; k < 6; ++k) { message.data[7 * k] = k < 3 ? translation : rotation; }
    return message;
}

static void follows_a_target_pose()
{
    Rig rig;
    rig.start();
    rig.run(100);
    auto message = rig.pose_message();
    const auto before = rig.tip();
    message.pose.position.z -= 0.1;
    rig.publish("~/target_pose", message);
    rig.run(4000);
    check(std::abs(rig.tip()[2] - before[2] + 0.1) < 3e-3, "the tip moves by 0.1 m");
    check(std::abs(rig.tip()[0] - before[0]) < 3e-3, "and in this direction alone");
    check(rig.allocated == 0 && stub::world().logged_in_update == 0, "no allocation, no log");
}

static void says_what_it_cannot_reach()
{
    Rig rig;
    rig.start();
    auto message = rig.pose_message();
    message.pose.position.x = 0.97 * robot::reach();
    message.pose.position.y = message.pose.position.z = 0.0; // beside a base that is a column
    rig.publish("~/target_pose", message);
    rig.run(4000);
    const auto target = rig.status().values[1];
    check(target.key == "target pose" && target.value.find("UNREACHABLE") != std::string::npos, "the state says so");
    check(!rig.has_fault(), "no fault");
}

static void refuses_a_bad_target_pose()
{
    Rig rig;
    rig.start();
    const auto before = rig.tip();
    auto message = rig.pose_message();
    message.pose.position.z -= 0.1;
    auto other = message;
    other.header.frame_id = "map";
    rig.publish("~/target_pose", other);
    check(stub::world().said("warn", "frame_id is 'map', and must be '" + std::string(robot::BASE_FRAME)), "another frame");
    other = message;
    other.pose.position.x = NOT_A_NUMBER;
    rig.publish("~/target_pose", other);
    check(stub::world().said("warn", "position is not finite"), "NaN");
    other = message;
    other.pose.orientation = {0.0, 0.0, 0.0, 0.0};
    rig.publish("~/target_pose", other);
    check(stub::world().said("warn", "quaternion does not have the norm 1"), "no quaternion");
    const int lines = static_cast<int>(stub::world().log.size());
    rig.publish("~/target_pose", other);
    check(static_cast<int>(stub::world().log.size()) == lines, "told once");
    rig.publish("~/target_pose", message, 2);
    check(stub::world().said("warn", "several publishers"), "a second publisher");
    rig.run(1000);
    check(distance(before, rig.tip()) < 1e-4, "the arm stays");
}

static void follows_a_target_joint_by_name()
{
    Rig rig;
    rig.start();
    sensor_msgs::msg::JointState message;
    for (std::size_t i = N; i-- > 0;) {
        message.name.push_back(robot::JOINTS[i]);
        message.position.push_back(rig.arm.q[i] + (i == 1 ? 0.2 : 0.0));
    }
    const double target = rig.arm.q[1] + 0.2;
    rig.publish("~/target_joint", message);
    rig.run(3000);
    check(std::abs(rig.arm.q[1] - target) < 0.01, "joint 1 moves");
    message.name[0] = "other";
    rig.publish("~/target_joint", message);
    check(stub::world().said("warn", "joint '" + std::string(robot::JOINTS[N - 1]) + "' is missing"), "a missing joint");
    message.position.pop_back();
    rig.publish("~/target_joint", message);
    check(stub::world().said("warn", "as many positions as names"), "a missing position");
}

static void refuses_what_the_arm_cannot_do()
{
    Rig rig;
    rig.start();
    const auto before = rig.tip();
    sensor_msgs::msg::JointState degrees;
    for (std::size_t i = 0; i < N; ++i) {
        degrees.name.push_back(robot::JOINTS[i]);
        degrees.position.push_back(rig.arm.q[i] * 180.0 / 3.14159265358979);
    }
    auto pose = rig.pose_message();
    pose.pose.position.x += 1000.0; // millimetres
    for (int k = 0; k < 3; ++k) { rig.publish("~/target_joint", degrees); }
    for (int k = 0; k < 3; ++k) { rig.publish("~/target_pose", pose); }
    rig.run(1000);
    rig.spin();
    check(stub::world().times("~/target_joint is refused: q0 of ") == 1 && stub::world().said("warn", "in radians"), "degrees");
    check(stub::world().times("~/target_pose is refused: its position is beyond the arm's reach; give metres") == 1, "millimetres");
    check(distance(before, rig.tip()) < 1e-4 && !rig.has_fault(), "the arm stays");
    check(rig.status().values[0].value.find("COMMAND_REFUSED") == std::string::npos, "the loop keeps the command before");
}

static void presses_along_a_target_wrench()
{
    Rig rig;
    rig.start();
    const auto before = rig.tip();
    geometry_msgs::msg::WrenchStamped message;
    message.header.frame_id = robot::BASE_FRAME;
    message.wrench.force.z = -10.0;
    for (int k = 0; k < 10; ++k) { // the wrench that the tip exerts: a free tip goes along it
        rig.publish("~/target_wrench", message);
        rig.run(200);
    }
    check(rig.tip()[2] < before[2] - 0.01, "the tip moves along the wrench");
    rig.spin();
    const auto springs = rig.last<geometry_msgs::msg::WrenchStamped>("~/wrench").wrench;
    check(springs.force.z > 5.0, "the springs pull back: the wrench that they exert on the environment is opposite");
    rig.run(4000);
    check(std::abs(rig.tip()[2] - before[2]) < 3e-3, "without messages it ends");
    message.wrench.force.z = 1e4;
    rig.publish("~/target_wrench", message);
    check(stub::world().said("warn", "larger than heaviest_wrench"), "too large");
}

static double deflection(Rig &rig, double force)
{
    rig.arm.push[2] = 0.0;
    rig.run(3000);
    const double before = rig.tip()[2];
    rig.arm.push[2] = force;
    rig.run(3000);
    return rig.tip()[2] - before;
}

static void takes_a_stiffness()
{
    Rig rig;
    rig.start();
    const double soft = deflection(rig, 10.0);
    rig.publish("~/stiffness", diagonal(1600.0, 80.0));
    const double stiff = deflection(rig, 10.0);
    check(soft > 2.0 * stiff && stiff > 0.0, "four times the stiffness, less deflection");
    auto wrong = diagonal(400.0, 20.0);
    wrong.data[1] = 50.0;
    rig.publish("~/stiffness", wrong);
    check(stub::world().said("warn", "not symmetric"), "asymmetric");
    wrong = diagonal(400.0, 20.0);
    wrong.data[3] = wrong.data[18] = 5.0;
    rig.publish("~/stiffness", wrong);
    check(stub::world().said("warn", "do not couple"), "coupled");
    wrong.data.pop_back();
    rig.publish("~/stiffness", wrong);
    check(stub::world().said("warn", "35 numbers instead of 36"), "35 numbers");
}

static void changes_parameters_while_it_runs()
{
    Rig rig;
    rig.start();
    const double soft = deflection(rig, 10.0);
    check(rig.set_now("translation_stiffness", {1600.0, 1600.0, 1600.0}).successful, "accepted");
    const double stiff = deflection(rig, 10.0);
    check(soft > 2.0 * stiff && stiff > 0.0, "the arm is stiffer");
    const Result negative = rig.set_now("translation_stiffness", {400.0, 400.0, -5.0});
    check(!negative.successful && negative.reason.find("positive semidefinite") != std::string::npos, "-5 N/m refused with its reason");
    check(!rig.set_now("translation_stiffness", {400.0}).successful, "one number refused");
    check(!rig.set_now("translation_stiffness", {9e9, 9e9, 9e9}).successful, "above the limit");
    const Result fixed = rig.node->set_parameters_atomically({rclcpp::Parameter("prefix", std::string("x"))});
    check(!fixed.successful && fixed.reason.find("unconfigured") != std::string::npos, "a fixed parameter");
    rig.node->declare_parameter("use_sim_time", false);
    check(rig.node->set_parameters_atomically({rclcpp::Parameter("use_sim_time", true)}).successful, "others are not ours");
    check(std::abs(deflection(rig, 10.0) / stiff - 1.0) < 0.1, "a refused change changes nothing");
    check(rig.set_now("damping_ratio", 1.0).successful && rig.set_now("heaviest_wrench", {50.0, 10.0}).successful, "fields");
    rig.run(500);
    check(rig.is_ok && !rig.has_fault() && rig.allocated == 0, "it goes on");
}

static void leads_proposals_through_the_policy_port()
{
    Rig rig;
    rig.set("policy", true);
    rig.set("target_timeout", 10.0); // the port has bounds of its own
    rig.start();
    rig.run(100);
    auto message = rig.pose_message();
    const double before = rig.tip()[2];
    for (int k = 0; k < 60; ++k) { // 20 Hz
        message.pose.position.z -= k < 20 ? 0.005 : 0.0;
        message.header.stamp = rig.node->now();
        rig.publish("~/target_pose", message);
        rig.run(50);
    }
    check(std::abs(rig.tip()[2] - before + 0.1) < 5e-3, "it follows the proposals");
    check(rig.allocated == 0, "no allocation");
    const auto values = rig.status().values;
    message.header.stamp = rclcpp::Time(rig.node->now().nanoseconds() - 5000000000LL);
    rig.publish("~/target_pose", message);
    rig.run(10);
    rig.spin();
    check(stub::world().said("warn", "commands refused: 1; the last one: "), "an old stamp is refused");
    rig.arm.push[2] = -5.0;
    rig.run(3000);
    check(rig.tip()[2] < before - 0.1 - 0.03, "without proposals the arm becomes soft");
    check(!rig.has_fault(), "and has no fault");
}

static void compensates_gravity()
{
    Rig rig;
    rig.set("compensate_gravity", true);
    rig.start();
    rig.read();
    for (int k = 0; k < 300; ++k) { rig.update(); } // the arm rests on a stand
    const robot::Joints wanted = robot::gravity::gradient(rig.arm.q, std::array<double, 3>{0.0, 0.0, -9.81});
    for (std::size_t i = 0; i < N; ++i) { check(std::abs(rig.torque[i] - wanted[i]) < 0.05, "gravity's torque"); }
    check(largest(wanted) > 1.0, "there is gravity");
}

static void tells_its_state()
{
    Rig rig;
    rig.start();
    rig.arm.push[0] = 10.0;
    rig.run(2000);
    rig.spin();
    const auto pose = rig.last<geometry_msgs::msg::PoseStamped>("~/pose").pose, wanted = rig.pose_message().pose;
    check(std::abs(pose.position.x - wanted.position.x) < 1e-4 && std::abs(pose.position.z - wanted.position.z) < 1e-4, "position");
    const auto &a = pose.orientation, &b = wanted.orientation;
    check(std::abs(std::abs(a.x * b.x + a.y * b.y + a.z * b.z + a.w * b.w) - 1.0) < 1e-6, "orientation");
    const auto rest = rig.last<geometry_msgs::msg::PoseStamped>("~/equilibrium").pose;
    check(rest.position.x < pose.position.x - 0.01, "the equilibrium is behind");
    check(rig.last<geometry_msgs::msg::WrenchStamped>("~/wrench").wrench.force.x < -5.0, "the springs push against the environment");
    const auto array = rig.last<diagnostic_msgs::msg::DiagnosticArray>("/diagnostics");
    check(array.status.size() == 1 && array.status[0].level == 0 && array.status[0].message == "active", "diagnostics");
    check(array.status[0].name == "arm: state" && array.status[0].hardware_id == robot::TIP_FRAME, "named after node and tip");
    check(array.status[0].values.size() >= 8 && array.status[0].values[2].key == "error [m]", "values");
}

static Numbers settle_message(double force, double moment)
{
    Numbers message;
    message.data = {force, moment};
    return message;
}

static void settles_under_an_unknown_payload()
{
    Rig rig;
    rig.start();
    rig.run(100);
    const auto wanted = rig.tip();
    rig.arm.push[2] = -10.0;
    rig.run(3000);
    const double before = distance(wanted, rig.tip());
    check(before > 0.01, "the payload bends the springs");
    rig.publish("~/settle", settle_message(20.0, 3.0));
    rig.run(8000);
    check(distance(wanted, rig.tip()) < 1.5e-3, "the tip is back within the band");
    check(rig.allocated == 0 && stub::world().logged_in_update == 0, "no allocation, no log");
    check(rig.told("settle").find("SETTLED") != std::string::npos, "the state says so");
    rig.publish("~/settle", settle_message(0.0, 0.0));
    rig.run(3000);
    check(std::abs(distance(wanted, rig.tip()) - before) < 1e-3, "0 ends it");
    check(!rig.has_fault(), "no fault");
}

static void keeps_settling_at_a_target_joint()
{
    Rig rig;
    rig.start();
    rig.arm.push[2] = -10.0;
    rig.publish("~/settle", settle_message(20.0, 3.0));
    sensor_msgs::msg::JointState message;
    robot::Joints q0 = rig.arm.q;
    q0[1] += 0.1;
    for (std::size_t i = 0; i < N; ++i) {
        message.name.push_back(robot::JOINTS[i]);
        message.position.push_back(q0[i]);
    }
    rig.publish("~/target_joint", message);
    rig.run(10000);
    const auto pose = robot::forward_kinematics(q0);
    check(distance({pose[3], pose[7], pose[11]}, rig.tip()) < 1.5e-3, "the tip is at the joints' pose");
}

static void refuses_a_bad_settle_or_press()
{
    Rig rig;
    rig.start();
    Numbers one;
    one.data = {20.0};
    rig.publish("~/settle", one);
    check(stub::world().said("warn", "~/settle is refused: it has 1 numbers"), "one number");
    rig.publish("~/settle", settle_message(-1.0, 0.0));
    check(stub::world().said("warn", "settle_force: every entry must lie between"), "a negative force");
    rig.publish("~/settle", settle_message(NOT_A_NUMBER, 0.0));
    check(stub::world().said("warn", "settle_force"), "NaN");
    geometry_msgs::msg::WrenchStamped press;
    press.header.frame_id = robot::BASE_FRAME;
    press.wrench.force.z = -15.0;
    rig.publish("~/press", press);
    check(stub::world().said("warn", "~/press is refused: it needs a force sensor: set ft_sensor"), "no sensor");
    const auto before = rig.tip();
    rig.run(500);
    check(distance(before, rig.tip()) < 1e-4, "the arm stays");
}

const std::vector<Scenario> COMMANDS = {
    {"follows_a_target_pose", follows_a_target_pose},
    {"says_what_it_cannot_reach", says_what_it_cannot_reach},
    {"refuses_a_bad_target_pose", refuses_a_bad_target_pose},
    {"follows_a_target_joint_by_name", follows_a_target_joint_by_name},
    {"refuses_what_the_arm_cannot_do", refuses_what_the_arm_cannot_do},
    {"presses_along_a_target_wrench", presses_along_a_target_wrench},
    {"takes_a_stiffness", takes_a_stiffness},
    {"changes_parameters_while_it_runs", changes_parameters_while_it_runs},
    {"leads_proposals_through_the_policy_port", leads_proposals_through_the_policy_port},
    {"compensates_gravity", compensates_gravity},
    {"tells_its_state", tells_its_state},
    {"settles_under_an_unknown_payload", settles_under_an_unknown_payload},
    {"keeps_settling_at_a_target_joint", keeps_settling_at_a_target_joint},
    {"refuses_a_bad_settle_or_press", refuses_a_bad_settle_or_press},
};
