// SPDX-License-Identifier: MIT
// Scenarios of examples/ros2/stiffness_controller.cpp on the stubs: prints a line for each that fails.
#include "stiffness_controller.cpp"

#include <cstdio>

using Callback = controller_interface::CallbackReturn;
static int failed = 0;
static void check(bool good, const char *what)
{
    if (!good) { std::printf("FAILED %s\n", what); }
    failed += !good;
}

struct Arm {
    std::array<double, 7> q = {0.0, 0.5, 0.0, -1.0, 0.0, 0.5, 0.0}, dq{}, torque{};
    StiffnessController controller;
    rclcpp_lifecycle::State state;

    Arm()
    {
        controller.stub_init(std::make_shared<rclcpp_lifecycle::LifecycleNode>("arm"), 1000);
        check(controller.on_init() == Callback::SUCCESS, "init");
    }
    void claim()
    {
        std::vector<hardware_interface::LoanedCommandInterface> commands;
        std::vector<hardware_interface::LoanedStateInterface> states;
        for (std::size_t i = 0; i < 7; ++i) {
            commands.emplace_back(std::make_shared<hardware_interface::CommandInterface>(torque[i], "joint", "effort"));
            states.emplace_back(std::make_shared<hardware_interface::StateInterface>(q[i], "joint", "position"));
            states.emplace_back(std::make_shared<hardware_interface::StateInterface>(dq[i], "joint", "velocity"));
        }
        controller.stub_assign(std::move(commands), std::move(states));
    }
    double largest() const
    {
        double most = 0.0;
        for (const double each : torque) { most = std::max(most, std::abs(each)); }
        return most;
    }
    void update()
    {
        check(controller.update(rclcpp::Time(0), rclcpp::Duration(0, 1000000)) == controller_interface::return_type::OK, "update");
    }
};

int main()
{
    for (const int end : {0, 1, 2}) {
        Arm arm;
        arm.claim();
        check(arm.controller.on_activate(arm.state) == Callback::SUCCESS, "activate");
        arm.update();
        arm.torque.fill(5.0); // as under a load
        const auto done = end == 0 ? arm.controller.on_deactivate(arm.state)
            : end == 1 ? arm.controller.on_error(arm.state)
                       : arm.controller.on_shutdown(arm.state);
        check(done == Callback::SUCCESS, "end");
        check(arm.largest() == 0.0, end == 0 ? "zero on deactivation" : end == 1 ? "zero on error" : "zero on shutdown");
    }
    for (const int which : {0, 1}) {
        Arm arm;
        (which == 0 ? arm.q : arm.dq)[3] = std::nan("");
        arm.claim();
        check(arm.controller.on_activate(arm.state) == Callback::FAILURE, "NaN refused");
    }
    Arm arm;
    arm.torque.fill(5.0);
    arm.torque[2] = std::nan("");
    arm.torque[6] = 1e9;
    arm.claim();
    check(arm.controller.on_activate(arm.state) == Callback::SUCCESS, "activate under torque");
    arm.update();
    check(std::abs(arm.torque[0] - 5.0) < 5.0, "torque in force goes on");
    check(arm.torque[0] > 1.5, "no step of the torque"); // 3.2 N m per millisecond at most
    check(std::abs(arm.torque[2]) < 3.3 && std::isfinite(arm.torque[2]), "NaN counts as zero");
    check(arm.torque[6] > 39.0 && arm.torque[6] <= 40.0, "clamped to the effort limit");
    return failed;
}
