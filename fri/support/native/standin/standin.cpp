// SPDX-License-Identifier: MIT
/* A library in the place of KUKA's, for tests: README.md. */
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>

#include "friClientApplication.h"
#include "friConnectionIf.h"
#include "friException.h"
#include "friLBRClient.h"

#include "checksum.h"
#include "fri.pb.h"

#include <pb_decode.h>
#include <pb_encode.h>

namespace KUKA {
namespace FRI {

namespace {

/* Value of memory that was never written: finite, and conspicuous wherever it is used. */
const double NEVER_WRITTEN = 7.0e77;

/* Seven places, written cyclically; the place of the next value is never reset. */
struct Ring {
    double value[7];
    int next;

    void take(bool has, const open_fri_Joints &from)
    {
        for (int i = 0; has && i < from.value_count; ++i) {
            value[next] = from.value[i];
            next = (next + 1) % 7;
        }
    }
};

/* Encode joint values unpacked, one key per value. */
bool encode_joints(pb_ostream_t *stream, const pb_field_t *field, void *const *values)
{
    const double *const value = static_cast<const double *>(*values);
    for (int i = 0; i < 7; ++i) {
        if (!pb_encode_tag_for_field(stream, field) || !pb_encode_fixed64(stream, value + i)) {
            return false;
        }
    }
    return true;
}

} // namespace

struct ClientData {
    open_fri_Monitoring in;
    open_fri_Command out;
    Ring position, torque, commanded_position, commanded_torque, external_torque, ipo;
    double out_position[7], out_torque[7];
    char received[1500], sent[1500];
    ESessionState last;
    uint32_t sequence, count;

    ClientData()
    {
        std::memset(this, 0, sizeof *this);
        Ring *const rings[] = {&position, &torque, &commanded_position, &commanded_torque, &external_torque, &ipo};
        for (Ring *ring : rings) {
            for (double &value : ring->value) {
                value = NEVER_WRITTEN;
            }
        }
    }

    const open_fri_Io &io(const char *name, uint32_t type) const
    {
        for (int i = 0; i < in.measurement.ios_count; ++i) {
            if (std::strcmp(in.measurement.ios[i].name, name) == 0 && in.measurement.ios[i].type == type) {
                return in.measurement.ios[i];
            }
        }
        throw FRIException("IO does not exist");
    }

    open_fri_Io &output(const char *name, uint32_t type)
    {
        const open_fri_Io &known = io(name, type);
        out.has_data = true;
        return out.data.ios[out.data.ios_count++] = known;
    }
};

/* ---- state ------------------------------------------------------------------------------------------------------ */

double LBRState::getSampleTime() const
{
    return data->in.has_connection && data->in.connection.has_period ? data->in.connection.period * 0.001 : 0.0;
}

ESessionState LBRState::getSessionState() const
{
    return data->in.has_connection ? static_cast<ESessionState>(data->in.connection.state) : IDLE;
}

EConnectionQuality LBRState::getConnectionQuality() const
{
    return data->in.has_connection ? static_cast<EConnectionQuality>(data->in.connection.quality) : POOR;
}

ESafetyState LBRState::getSafetyState() const
{
    return static_cast<ESafetyState>(data->in.robot.safety);
}

EOperationMode LBRState::getOperationMode() const
{
    return static_cast<EOperationMode>(data->in.robot.operation);
}

/* Return the drives' state, TRANSITIONING if they differ. */
EDriveState LBRState::getDriveState() const
{
    for (int i = 1; i < data->in.robot.drives_count; ++i) {
        if (data->in.robot.drives[i] != data->in.robot.drives[0]) {
            return TRANSITIONING;
        }
    }
    return static_cast<EDriveState>(data->in.robot.drives[0]);
}

EClientCommandMode LBRState::getClientCommandMode() const
{
    return static_cast<EClientCommandMode>(data->in.has_interpolator ? data->in.interpolator.command_mode : 0);
}

EOverlayType LBRState::getOverlayType() const
{
    return static_cast<EOverlayType>(data->in.has_interpolator ? data->in.interpolator.overlay : 0);
}

EControlMode LBRState::getControlMode() const
{
    return static_cast<EControlMode>(data->in.robot.control);
}

unsigned int LBRState::getTimestampSec() const
{
    return data->in.measurement.has_time ? data->in.measurement.time.seconds : 0;
}

unsigned int LBRState::getTimestampNanoSec() const
{
    return data->in.measurement.has_time ? data->in.measurement.time.nanoseconds : 0;
}

const double *LBRState::getMeasuredJointPosition() const { return data->position.value; }
const double *LBRState::getMeasuredTorque() const { return data->torque.value; }
const double *LBRState::getCommandedTorque() const { return data->commanded_torque.value; }
const double *LBRState::getExternalTorque() const { return data->external_torque.value; }

const double *LBRState::getIpoJointPosition() const
{
    if (!data->in.has_interpolator || !data->in.interpolator.has_position) {
        throw FRIException("IPO joint position not available");
    }
    return data->ipo.value;
}

double LBRState::getTrackingPerformance() const
{
    return data->in.has_interpolator ? data->in.interpolator.tracking : 0.0;
}

bool LBRState::getBooleanIOValue(const char *name) const { return data->io(name, 0).digital != 0; }
unsigned long long LBRState::getDigitalIOValue(const char *name) const { return data->io(name, 1).digital; }
double LBRState::getAnalogIOValue(const char *name) const { return data->io(name, 2).analog; }

#if STANDIN_VERSION < 200
const double *LBRState::getCommandedJointPosition() const { return data->commanded_position.value; }
#else
const double *LBRState::getMeasuredCartesianPose() const { return data->in.measurement.pose.element; }

/* Convert x y z and quaternion w x y z into rows of rotation and translation. */
void LBRState::getMeasuredCartesianPoseAsMatrix(double (&matrix)[3][4]) const
{
    const double *const p = getMeasuredCartesianPose();
    const double w = p[3], x = p[4], y = p[5], z = p[6];
    const double rows[3][4] = {{1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), p[0]},
                               {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), p[1]},
                               {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), p[2]}};
    std::memcpy(matrix, rows, sizeof rows);
}

double LBRState::getMeasuredRedundancyValue() const { return data->in.measurement.redundancy.value; }

ERedundancyStrategy LBRState::getRedundancyStrategy() const
{
    return static_cast<ERedundancyStrategy>(data->in.measurement.redundancy.strategy);
}
#endif

#if STANDIN_VERSION >= 207
const double *LBRState::getExternalForce() const { return data->in.measurement.external_force.element; }
#endif

/* ---- command ---------------------------------------------------------------------------------------------------- */

namespace {

/* Throw, from 2.7 on, if a command does not fit the command mode. */
void require_mode(const ClientData *data, bool fits)
{
#if STANDIN_VERSION >= 207
    if (!fits) {
        throw FRIException("command does not fit the client command mode");
    }
#endif
    (void)data;
    (void)fits;
}

void joints(const double *values, double *copy, open_fri_SentJoints *to)
{
    std::memcpy(copy, values, 7 * sizeof *copy);
    to->value.funcs.encode = encode_joints;
    to->value.arg = copy;
}

} // namespace

void LBRCommand::setJointPosition(const double *values)
{
    const int mode = data->in.has_interpolator ? static_cast<int>(data->in.interpolator.command_mode) : 0;
    require_mode(data, mode == 1 || mode == 2 || mode == 3);
    data->out.has_data = data->out.data.has_position = true;
    joints(values, data->out_position, &data->out.data.position);
}

void LBRCommand::setTorque(const double *values)
{
    require_mode(data, data->in.has_interpolator && data->in.interpolator.command_mode == 3);
    data->out.has_data = data->out.data.has_torque = true;
    joints(values, data->out_torque, &data->out.data.torque);
}

void LBRCommand::setWrench(const double *values)
{
    require_mode(data, data->in.has_interpolator && data->in.interpolator.command_mode == 2);
    data->out.has_data = data->out.data.has_wrench = true;
    data->out.data.wrench.element_count = 6;
    std::memcpy(data->out.data.wrench.element, values, 6 * sizeof *values);
}

void LBRCommand::setBooleanIOValue(const char *name, const bool value)
{
    open_fri_Io &io = data->output(name, 0);
    io.has_digital = true;
    io.digital = value;
}

void LBRCommand::setDigitalIOValue(const char *name, const unsigned long long value)
{
    open_fri_Io &io = data->output(name, 1);
    io.has_digital = true;
    io.digital = value;
}

void LBRCommand::setAnalogIOValue(const char *name, const double value)
{
    open_fri_Io &io = data->output(name, 2);
    io.has_analog = true;
    io.analog = value;
}

/* ---- client ----------------------------------------------------------------------------------------------------- */

LBRClient::LBRClient()
{
    state_.data = command_.data = new ClientData;
}

LBRClient::~LBRClient()
{
    delete state_.data;
}

ClientData *LBRClient::createData()
{
    return state_.data;
}

void LBRClient::onStateChange(ESessionState oldState, ESessionState newState)
{
    std::printf("LBRiiwaClient state changed from %d to %d\n", oldState, newState);
}

void LBRClient::monitor() {}

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
    : connection_(connection), client_(client), data_(client.createData())
{
}

bool ClientApplication::connect(int port, const char *remoteHost)
{
    return connection_.isOpen() || connection_.open(port, remoteHost);
}

void ClientApplication::disconnect()
{
    connection_.close();
}

namespace {

/* Find the message in a datagram. */
bool unframe(const char *received, size_t size, const uint8_t **body, size_t *length)
{
    *body = reinterpret_cast<const uint8_t *>(received);
    *length = size;
#if STANDIN_VERSION >= 207
    *length = read_little_endian(*body);
    if (*length + 8 != size) {
        std::fprintf(stderr, "standin: a length that is not the datagram's; KUKA's library would read beyond it\n");
        std::abort();
    }
    *body += 4;
    if (read_little_endian(*body + *length) != checksum(*body, *length)) {
        std::printf("Error: wrong CRC!\n");
        return false;
    }
#endif
    return true;
}

/* Decode a message, and say what is wrong, as KUKA's library does. */
bool decode(const uint8_t *body, size_t length, open_fri_Monitoring *message)
{
    pb_istream_t in = pb_istream_from_buffer(body, length);
    if (!pb_decode(&in, open_fri_Monitoring_fields, message)) {
        std::printf("Error: failed to decode: %s\n", PB_GET_ERROR(&in));
        return false;
    }
    if (message->header.identifier != 0x245142) {
        std::printf("Error: wrong message identifier!\n");
        return false;
    }
    return true;
}

/* Keep a message, and begin its answer. */
void keep(const open_fri_Monitoring &message, ClientData &data)
{
    const open_fri_Measurement &from = message.measurement;
    const bool measured = message.has_measurement;
    data.in = message;
    data.position.take(measured && from.has_position, from.position);
    data.torque.take(measured && from.has_torque, from.torque);
    data.commanded_position.take(measured && from.has_commanded_position, from.commanded_position);
    data.commanded_torque.take(measured && from.has_commanded_torque, from.commanded_torque);
    data.external_torque.take(measured && from.has_external_torque, from.external_torque);
    data.ipo.take(message.has_interpolator && message.interpolator.has_position, message.interpolator.position);
    data.out = open_fri_Command_init_zero;
}

/* Call the client for a state; false if the state has no answer. */
bool call(ESessionState state, IClient &client)
{
    switch (state) {
    case MONITORING_WAIT:
    case MONITORING_READY: client.monitor(); return true;
    case COMMANDING_WAIT: client.waitForCommand(); return true;
    case COMMANDING_ACTIVE: client.command(); return true;
    default: return false;
    }
}

/* Encode the answer into data.sent; return its size, or 0. */
size_t encode(ClientData &data)
{
    data.out.header.identifier = 0x34001;
    data.out.header.sequence = data.sequence++;
    data.out.header.reflected = data.in.header.sequence;
    const size_t front = STANDIN_VERSION >= 207 ? 4 : 0; /* 2.7 puts length and checksum round a message */
    pb_ostream_t out = pb_ostream_from_buffer(reinterpret_cast<uint8_t *>(data.sent) + front, sizeof data.sent - 8);
    if (!pb_encode(&out, open_fri_Command_fields, &data.out)) {
        std::printf("Error: failed to encode!\n");
        return 0;
    }
    if (front) {
        const uint8_t *const encoded = reinterpret_cast<uint8_t *>(data.sent) + front;
        const uint32_t words[2] = {static_cast<uint32_t>(out.bytes_written), checksum(encoded, out.bytes_written)};
        std::memcpy(data.sent, &words[0], 4);
        std::memcpy(data.sent + front + out.bytes_written, &words[1], 4);
    }
    return out.bytes_written + 2 * front;
}

} // namespace

/* Receive a message, call the client, and answer, as KUKA's library does. */
bool ClientApplication::step()
{
    if (!connection_.isOpen()) {
        std::printf("Error: client application is not connected!\n");
        return false;
    }
    ClientData &data = *data_;
    const int size = connection_.receive(data.received, sizeof data.received);
    if (size <= 0) {
        std::printf("Error: failed while trying to receive monitoring message!\n");
        return false;
    }
    const uint8_t *body = NULL;
    size_t length = 0;
    open_fri_Monitoring message = open_fri_Monitoring_init_zero;
    if (!unframe(data.received, static_cast<size_t>(size), &body, &length) || !decode(body, length, &message)) {
        return false;
    }
    keep(message, data);
    const ESessionState state = message.has_connection ? static_cast<ESessionState>(message.connection.state) : IDLE;
    if (state != data.last) {
        const ESessionState before = data.last;
        data.last = state;
        client_.onStateChange(before, state);
    }
    /* the robot wants one answer in so many messages */
    if (!call(state, client_) || ++data.count < message.connection.multiplier) {
        return true;
    }
    data.count = 0;
    const size_t answer = encode(data);
#if STANDIN_VERSION >= 207
    typedef unsigned int Size;
#else
    typedef int Size;
#endif
    return answer > 0 && connection_.send(data.sent, static_cast<Size>(answer));
}

} // namespace FRI
} // namespace KUKA
