// SPDX-License-Identifier: MIT
/* State, command and the cycle of the client application. Part of open_fri. */
#include "friClientApplication.h"
#include "friLBRClient.h"

#include <cmath>
#include <cstring>

namespace KUKA {
namespace FRI {

namespace {

enum IoType { IO_BOOLEAN = 0, IO_DIGITAL = 1, IO_ANALOG = 2 };
enum { IO_OUTPUT = 1 };

/* Return whether no value is NaN or infinite. */
bool all_finite(const double *values, int count)
{
    for (int i = 0; i < count; ++i) {
        if (!std::isfinite(values[i])) {
            return false;
        }
    }
    return true;
}

#if FRI_VERSION >= 200
/* Convert a pose, x y z and quaternion w x y z, into rows of rotation and translation. */
void to_matrix(const double *pose, double (&matrix)[3][4])
{
    const double w = pose[3], x = pose[4], y = pose[5], z = pose[6];
    const double rows[3][4] = {
        {1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y), pose[0]},
        {2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x), pose[1]},
        {2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y), pose[2]},
    };
    std::memcpy(matrix, rows, sizeof rows);
}
#endif

} // namespace

/* ---- state ------------------------------------------------------------------------------------------------------ */

const double *LBRState::getIpoJointPosition() const
{
    if (!message_.has_interpolator_position) {
        throw FRIException("the message has no interpolator position: the robot is not commanding joints");
    }
    return message_.interpolator_position;
}

/* Return an IO of the last message by name and type; throw if there is none. */
const open_fri::Io &LBRState::io(const char *name, std::uint32_t type) const
{
    for (int i = 0; i < message_.io_count; ++i) {
        if (message_.ios[i].type == type && std::strcmp(message_.ios[i].name, name) == 0) {
            return message_.ios[i];
        }
    }
    throw FRIException("the robot application has registered no IO of that name and type");
}

bool LBRState::getBooleanIOValue(const char *name) const
{
    return io(name, IO_BOOLEAN).digital != 0;
}

unsigned long long LBRState::getDigitalIOValue(const char *name) const
{
    return io(name, IO_DIGITAL).digital;
}

double LBRState::getAnalogIOValue(const char *name) const
{
    return io(name, IO_ANALOG).analog;
}

#if FRI_VERSION >= 200
void LBRState::getMeasuredCartesianPoseAsMatrix(double (&matrix)[3][4]) const
{
    to_matrix(message_.pose, matrix);
}

void LBRState::getIpoCartesianPoseAsMatrix(double (&matrix)[3][4]) const
{
    to_matrix(message_.interpolator_pose, matrix);
}
#endif

/* ---- command ---------------------------------------------------------------------------------------------------- */

LBRCommand::LBRCommand(const LBRState &state) : state_(state)
{
    clear();
}

void LBRCommand::clear()
{
    std::memset(&message_, 0, sizeof message_);
}

void LBRCommand::require(bool fits, const char *message) const
{
    if (!fits) {
        throw FRIException(message);
    }
}

/* Command positions [rad]; throw if the robot takes none now, or one is not finite. */
void LBRCommand::setJointPosition(const double *values)
{
#if FRI_VERSION >= 207
    const EClientCommandMode mode = state_.getClientCommandMode();
    require(mode == JOINT_POSITION || mode == WRENCH || mode == TORQUE, "the robot takes no joint position now");
#endif
    require(all_finite(values, open_fri::JOINTS), "a joint position is not finite");
    std::memcpy(message_.position, values, sizeof message_.position);
    message_.has_position = true;
}

/* Command a wrench [N, N m]; throw if the robot takes none now, or it is not finite. */
void LBRCommand::setWrench(const double *values)
{
#if FRI_VERSION >= 207
    require(state_.getClientCommandMode() == WRENCH, "the robot takes no wrench now");
#endif
    require(all_finite(values, 6), "a wrench is not finite");
    std::memcpy(message_.wrench, values, sizeof message_.wrench);
    message_.has_wrench = true;
}

/* Command torques [N m]; throw if the robot takes none now, or one is not finite. */
void LBRCommand::setTorque(const double *values)
{
#if FRI_VERSION >= 207
    require(state_.getClientCommandMode() == TORQUE, "the robot takes no torque now");
#endif
    require(all_finite(values, open_fri::JOINTS), "a torque is not finite");
    std::memcpy(message_.torque, values, sizeof message_.torque);
    message_.has_torque = true;
}

/* Return the entry of an output in this command, added if it is new. */
open_fri::Io &LBRCommand::output(const char *name, std::uint32_t type)
{
    require(state_.io(name, type).direction == IO_OUTPUT, "the IO is an input");
    int i = 0;
    while (i < message_.io_count && std::strcmp(message_.ios[i].name, name) != 0) {
        ++i;
    }
    if (i == message_.io_count) {
        require(i < open_fri::IOS, "too many IOs in one command");
        ++message_.io_count;
    }
    message_.ios[i] = state_.io(name, type);
    return message_.ios[i];
}

void LBRCommand::setBooleanIOValue(const char *name, const bool value)
{
    output(name, IO_BOOLEAN).digital = value ? 1 : 0;
}

void LBRCommand::setDigitalIOValue(const char *name, const unsigned long long value)
{
    output(name, IO_DIGITAL).digital = value;
}

void LBRCommand::setAnalogIOValue(const char *name, const double value)
{
    require(std::isfinite(value), "an analog value is not finite");
    output(name, IO_ANALOG).analog = value;
}

/* ---- client ----------------------------------------------------------------------------------------------------- */

/* Answer a monitored message; 1.x repeats the commanded position. */
void LBRClient::monitor()
{
#if FRI_VERSION < 200
    if (all_finite(state_.getCommandedJointPosition(), open_fri::JOINTS)) {
        command_.setJointPosition(state_.getCommandedJointPosition());
    }
#endif
}

void LBRClient::waitForCommand()
{
    command_.setJointPosition(state_.getIpoJointPosition());
}

void LBRClient::command()
{
    command_.setJointPosition(state_.getIpoJointPosition());
}

/* ---- application ------------------------------------------------------------------------------------------------ */

ClientApplication::ClientApplication(IConnection &connection, IClient &client)
    : connection_(connection), client_(client), state_(IDLE), sent_count_(0), since_answer_(0)
{
}

bool ClientApplication::connect(int port, const char *remoteHost)
{
    return connection_.isOpen() || connection_.open(port, remoteHost);
}

void ClientApplication::disconnect()
{
    if (connection_.isOpen()) {
        connection_.close();
    }
}

/* Call the client for this state; return whether an answer is due. */
bool ClientApplication::callback(LBRState &state)
{
    const ESessionState now = state.getSessionState();
    if (now != state_) {
        const ESessionState before = state_;
        state_ = now;
        client_.onStateChange(before, now);
    }
    switch (now) {
    case MONITORING_WAIT:
    case MONITORING_READY: client_.monitor(); break;
    case COMMANDING_WAIT: client_.waitForCommand(); break;
    case COMMANDING_ACTIVE: client_.command(); break;
    default: return false;
    }
    if (++since_answer_ < state.message_.multiplier) {
        return false;
    }
    since_answer_ = 0;
    return true;
}

/* Receive a message, call the client, and answer; false if there was no message or no answer left. */
bool ClientApplication::step()
{
    if (!connection_.isOpen()) {
        return false;
    }
    const int size = connection_.receive(reinterpret_cast<char *>(received_), open_fri::DATAGRAM_SIZE);
    if (size < 0 || !open_fri::decode(received_, static_cast<std::size_t>(size), &incoming_)) {
        return false;
    }
    LBRState &state = client_.receivedState();
    LBRCommand &command = client_.nextCommand();
    state.message_ = incoming_;
    command.clear();
    if (!callback(state)) { /* no answer is due */
        return true;
    }
    const std::size_t length = open_fri::encode(command.message_, sent_count_, incoming_.sequence, sent_, sizeof sent_);
    if (length == 0 || !connection_.send(reinterpret_cast<char *>(sent_), static_cast<BufferSize>(length))) {
        return false;
    }
    ++sent_count_;
    return true;
}

} // namespace FRI
} // namespace KUKA
