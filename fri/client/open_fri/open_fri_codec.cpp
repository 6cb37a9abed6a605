// SPDX-License-Identifier: MIT
/* The messages to and from bytes, by nanopb. Part of open_fri. */
#include "open_fri_messages.h"

#include "checksum.h"

#include "fri.pb.h"

#include <pb_decode.h>
#include <pb_encode.h>

#include <cmath>
#include <cstring>
#include <limits>

namespace open_fri {
namespace {

const std::uint32_t MONITORING_IDENTIFIER = 0x245142, COMMAND_IDENTIFIER = 0x34001;

#if FRI_VERSION >= 207
const std::size_t FRAME_FRONT = 4, FRAME_BACK = 4;

void write_little_endian(std::uint32_t value, std::uint8_t *bytes)
{
    for (int i = 0; i < 4; ++i) {
        bytes[i] = static_cast<std::uint8_t>(value >> (8 * i));
    }
}
#else
const std::size_t FRAME_FRONT = 0, FRAME_BACK = 0;
#endif

/* ---- decoding --------------------------------------------------------------------------------------------------- */

void fill(double *values, int count)
{
    for (int i = 0; i < count; ++i) {
        values[i] = std::numeric_limits<double>::quiet_NaN();
    }
}

/* Take an array of joints; false if it is present without exactly seven values. */
bool take(bool present, const open_fri_Joints &from, double *to)
{
    if (present && from.value_count != JOINTS) {
        return false;
    }
    if (present) {
        std::memcpy(to, from.value, sizeof from.value);
    }
    return true;
}

void take_pose(bool present, const open_fri_Pose &from, double *to)
{
    if (present && from.element_count == 7) {
        std::memcpy(to, from.element, sizeof from.element);
    }
}

/* Take drives, safety and modes; false for a value that the protocol does not have. */
bool take_robot(const open_fri_Robot &from, Monitoring *to)
{
    if (from.has_joints && from.joints != JOINTS) {
        return false;
    }
    if (from.drives_count != 0 && from.drives_count != JOINTS) {
        return false;
    }
    to->drive = from.drives_count ? from.drives[0] : 0;
    for (int i = 0; i < from.drives_count; ++i) {
        if (from.drives[i] > 2) {
            return false;
        }
        if (from.drives[i] != from.drives[0]) {
            to->drive = 1; /* TRANSITIONING */
        }
    }
    to->safety = from.safety;
    to->operation = from.operation;
    to->control = from.control;
    return from.safety <= 3 && from.operation <= 2 && from.control <= 3;
}

/* Take every array of joints; false if one has neither seven values nor none. */
bool take_joints(const open_fri_Measurement &from, Monitoring *to)
{
    return take(from.has_position, from.position, to->position) && take(from.has_torque, from.torque, to->torque) &&
           take(from.has_commanded_position, from.commanded_position, to->commanded_position) &&
           take(from.has_commanded_torque, from.commanded_torque, to->commanded_torque) &&
           take(from.has_external_torque, from.external_torque, to->external_torque);
}

/* Take the inputs and outputs; false for an unknown type or direction. */
bool take_ios(const open_fri_Measurement &from, Monitoring *to)
{
    to->io_count = from.ios_count;
    for (int i = 0; i < to->io_count; ++i) {
        const open_fri_Io &io = from.ios[i];
        if (io.type > 2 || io.direction > 1) { /* there are three types and two directions */
            return false;
        }
        std::memcpy(to->ios[i].name, io.name, sizeof to->ios[i].name);
        to->ios[i].type = io.type;
        to->ios[i].direction = io.direction;
        to->ios[i].digital = io.digital;
        to->ios[i].analog = io.analog;
    }
    return true;
}

/* Take the measured values; false for arrays of wrong length or values out of range. */
bool take_measurement(const open_fri_Measurement &from, Monitoring *to)
{
    if (!take_joints(from, to)) {
        return false;
    }
    if (from.has_external_force && from.external_force.element_count == 6) {
        std::memcpy(to->external_force, from.external_force.element, sizeof to->external_force);
    }
    take_pose(from.has_pose, from.pose, to->pose);
    if (from.has_redundancy) {
        to->redundancy = from.redundancy.value;
        to->strategy = from.redundancy.strategy;
    }
    to->seconds = from.has_time ? from.time.seconds : 0;
    to->nanoseconds = from.has_time ? from.time.nanoseconds : 0;
    const bool strategy = to->strategy == 0 || to->strategy == 4;
    return take_ios(from, to) && strategy && to->nanoseconds < 1000000000u;
}

/* Take what the robot's interpolator commands; false for values out of range. */
bool take_interpolator(const open_fri_Interpolator &from, Monitoring *to)
{
    if (!take(from.has_position, from.position, to->interpolator_position)) {
        return false;
    }
    to->has_interpolator_position = from.has_position;
    take_pose(from.has_pose, from.pose, to->interpolator_pose);
    to->interpolator_redundancy = from.has_redundancy ? from.redundancy.value : to->interpolator_redundancy;
    to->command_mode = from.command_mode;
    to->overlay = from.overlay;
    to->tracking = from.tracking;
    return from.command_mode <= 4 && from.overlay <= 2; /* the last values that FRI has */
}

/* Take a decoded message; false if it is another message, or a value is out of range. */
bool take_message(const open_fri_Monitoring &from, Monitoring *to)
{
    clear(to);
    if (from.header.identifier != MONITORING_IDENTIFIER) {
        return false;
    }
    to->sequence = from.header.sequence;
    to->reflected = from.header.reflected;
    if (from.has_connection) {
        if (from.connection.state > 4 || from.connection.quality > 3) { /* the last of each enumeration */
            return false;
        }
        to->state = from.connection.state;
        to->quality = from.connection.quality;
        to->period = from.connection.period;
        to->multiplier = from.connection.multiplier;
    }
    return (!from.has_robot || take_robot(from.robot, to)) &&
           (!from.has_measurement || take_measurement(from.measurement, to)) &&
           (!from.has_interpolator || take_interpolator(from.interpolator, to));
}

/* ---- encoding --------------------------------------------------------------------------------------------------- */

/* Joint values go out unpacked, one key a value, as KUKA's library does it; nanopb's own arrays would be packed. */
bool encode_joints(pb_ostream_t *stream, const pb_field_t *field, void *const *values)
{
    const double *const value = static_cast<const double *>(*values);
    for (int i = 0; i < JOINTS; ++i) {
        if (!pb_encode_tag_for_field(stream, field) || !pb_encode_fixed64(stream, value + i)) {
            return false;
        }
    }
    return true;
}

/* Let a joint array be encoded unpacked, if it is present. */
void give_joints(bool present, const double *values, bool *has, open_fri_SentJoints *to)
{
    *has = present;
    if (present) {
        to->value.funcs.encode = encode_joints;
        to->value.arg = const_cast<double *>(values);
    }
}

/* Fill the command's part of the message that is to be encoded. */
void give_data(const Command &from, open_fri_CommandData *to)
{
    give_joints(from.has_position, from.position, &to->has_position, &to->position);
    give_joints(from.has_torque, from.torque, &to->has_torque, &to->torque);
    to->has_wrench = from.has_wrench;
    if (from.has_wrench) {
        to->wrench.element_count = 6;
        std::memcpy(to->wrench.element, from.wrench, sizeof from.wrench);
    }
    to->ios_count = static_cast<pb_size_t>(from.io_count);
    for (int i = 0; i < from.io_count; ++i) {
        open_fri_Io &io = to->ios[i];
        std::memcpy(io.name, from.ios[i].name, sizeof io.name);
        io.type = from.ios[i].type;
        io.direction = from.ios[i].direction;
        io.has_analog = from.ios[i].type == 2; /* the analog type; the others share a field */
        io.has_digital = !io.has_analog;
        io.digital = from.ios[i].digital;
        io.analog = from.ios[i].analog;
    }
}

} // namespace

/* Set counters to 0 and values to NaN, so that a field that is left out is never an old one. */
void clear(Monitoring *message)
{
    std::memset(message, 0, sizeof *message);
    fill(message->position, JOINTS);
    fill(message->torque, JOINTS);
    fill(message->commanded_position, JOINTS);
    fill(message->commanded_torque, JOINTS);
    fill(message->external_torque, JOINTS);
    fill(message->external_force, 6);
    fill(message->pose, 7);
    fill(&message->redundancy, 1);
    fill(message->interpolator_position, JOINTS);
    fill(message->interpolator_pose, 7);
    fill(&message->interpolator_redundancy, 1);
}

/* Decode a datagram; false if frame, checksum or message are wrong. */
bool decode(const std::uint8_t *datagram, std::size_t size, Monitoring *message)
{
    if (size < FRAME_FRONT + FRAME_BACK || size > DATAGRAM_SIZE) {
        return false;
    }
    const std::uint8_t *const body = datagram + FRAME_FRONT;
    const std::size_t length = size - FRAME_FRONT - FRAME_BACK;
#if FRI_VERSION >= 207
    if (read_little_endian(datagram) != length || read_little_endian(body + length) != checksum(body, length)) {
        return false;
    }
#endif
    open_fri_Monitoring wire = open_fri_Monitoring_init_zero;
    pb_istream_t stream = pb_istream_from_buffer(body, length);
    return pb_decode(&stream, open_fri_Monitoring_fields, &wire) && take_message(wire, message);
}

/* Encode a command, with its frame in 2.7; return its size, 0 if it does not fit. */
std::size_t encode(const Command &command, std::uint32_t sequence, std::uint32_t reflected, std::uint8_t *datagram,
                   std::size_t capacity)
{
    if (capacity < FRAME_FRONT + FRAME_BACK) {
        return 0;
    }
    open_fri_Command wire = open_fri_Command_init_zero;
    wire.header.identifier = COMMAND_IDENTIFIER;
    wire.header.sequence = sequence;
    wire.header.reflected = reflected;
    wire.has_data = command.has_position || command.has_torque || command.has_wrench || command.io_count > 0;
    give_data(command, &wire.data);
    pb_ostream_t stream = pb_ostream_from_buffer(datagram + FRAME_FRONT, capacity - FRAME_FRONT - FRAME_BACK);
    if (!pb_encode(&stream, open_fri_Command_fields, &wire)) {
        return 0;
    }
    const std::size_t length = stream.bytes_written;
#if FRI_VERSION >= 207
    write_little_endian(static_cast<std::uint32_t>(length), datagram);
    write_little_endian(checksum(datagram + FRAME_FRONT, length), datagram + FRAME_FRONT + length);
#endif
    return FRAME_FRONT + length + FRAME_BACK;
}

} // namespace open_fri
