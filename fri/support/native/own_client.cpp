// SPDX-License-Identifier: MIT
/* Behind docs/fri.md's StiffnessClient: the library's functions on plain memory, and a session of callbacks. */
#include <cstdio>

namespace KUKA {
namespace FRI {

struct ClientData {
    double measured[7], ipo[7], position[7], torque[7], time;
    int positions, torques;
    EClientCommandMode mode;
} robot;

static const double PERIOD = 0.005;

double LBRState::getSampleTime() const { return PERIOD; }
EClientCommandMode LBRState::getClientCommandMode() const { return robot.mode; }
unsigned int LBRState::getTimestampSec() const { return 1000u + static_cast<unsigned>(robot.time); }
unsigned int LBRState::getTimestampNanoSec() const { return static_cast<unsigned>(1e9 * (robot.time - std::floor(robot.time))); }
const double *LBRState::getMeasuredJointPosition() const { return robot.measured; }
const double *LBRState::getIpoJointPosition() const { return robot.ipo; }
void LBRCommand::setJointPosition(const double *values)
{
    std::memcpy(robot.position, values, sizeof robot.position);
    ++robot.positions;
}
void LBRCommand::setTorque(const double *values)
{
    std::memcpy(robot.torque, values, sizeof robot.torque);
    ++robot.torques;
}
LBRClient::LBRClient() {}
LBRClient::~LBRClient() {}
void LBRClient::onStateChange(ESessionState, ESessionState) {}
void LBRClient::monitor() {}
void LBRClient::waitForCommand() {}
void LBRClient::command() {}
ClientData *LBRClient::createData() { return nullptr; }

} // namespace FRI
} // namespace KUKA

static int failed = 0;
static void check(bool good, const char *what)
{
    if (!good) { std::printf("FAILED %s\n", what); }
    failed += !good;
}

/* Push joint 2 with 3 N m for 5 s, in steps of 5 ms, on an arm with damping 2 N m s/rad and rotors of 0.5 kg m^2; lose
   each 50th message. */
static void push_arm(StiffnessClient &client)
{
    auto &robot = KUKA::FRI::robot;
    double speed[7] = {}, mass[49];
    for (int cycle = 0; cycle < 1000; ++cycle, robot.time += 0.005) {
        if (cycle % 50 != 49) { client.command(); }
        iiwa14_mass_matrix(robot.measured, mass);
        for (int i = 0; i < 7; ++i) {
            const double push = i == 1 ? 3.0 : 0.0;
            speed[i] += 0.005 * (robot.torque[i] + push - 2.0 * speed[i]) / (mass[8 * i] + 0.5);
            robot.measured[i] += 0.005 * speed[i];
        }
    }
}

/* Step the client through a session, with a push, jumps of the clock, and NaN; return 1 if a check fails. */
int main()
{
    auto &robot = KUKA::FRI::robot;
    const double start[7] = {0.0, 0.5, 0.0, -1.0, 0.0, 0.5, 0.0};
    std::memcpy(robot.measured, start, sizeof start);
    std::memcpy(robot.ipo, start, sizeof start);
    robot.mode = KUKA::FRI::TORQUE;
    StiffnessClient client;
    client.onStateChange(KUKA::FRI::MONITORING_READY, KUKA::FRI::COMMANDING_WAIT);
    for (int cycle = 0; cycle < 20; ++cycle, robot.time += 0.005) { client.waitForCommand(); }
    check(robot.torques == 20 && robot.positions == 20, "both are sent while waiting");
    check(robot.torque[1] == 0.0 && robot.position[1] == start[1], "zero torque and the ipo's position while waiting");

    client.onStateChange(KUKA::FRI::COMMANDING_WAIT, KUKA::FRI::COMMANDING_ACTIVE);
    push_arm(client);
    const double moved = robot.measured[1] - start[1];
    check(moved > 0.002 && moved < 0.2, "the arm gives way to the push, and is held");
    check(std::fabs(robot.torque[1] + 3.0) < 0.5, "the torque carries the push");
    check(std::fabs(robot.position[1] - robot.measured[1]) < 0.01, "the position follows the measured one");

    for (const double jump : {1e9, -1e9, 0.0}) { // the clock is set, back, and stands still: undefined behaviour traps
        robot.time += jump;
        client.command();
    }
    for (int i = 0; i < 7; ++i) { check(std::isfinite(robot.torque[i]), "finite when the clock jumps"); }

    robot.measured[4] = std::nan("");
    for (int cycle = 0; cycle < 200; ++cycle, robot.time += 0.005) { client.command(); }
    for (int i = 0; i < 7; ++i) { check(std::isfinite(robot.torque[i]) && std::isfinite(robot.position[i]), "finite with a NaN"); }
    check(std::fabs(robot.torque[1]) < 0.1, "a latched fault lets go");

    robot.mode = KUKA::FRI::NO_COMMAND_MODE;
    const int before = robot.torques;
    client.command();
    check(robot.torques == before, "no torque in another mode");
    return failed;
}
