// SPDX-License-Identifier: MIT
/*
 * Content of the two messages, and their conversion to and from bytes. Part of open_fri; not in KUKA's library.
 */
#ifndef OPEN_FRI_MESSAGES_H
#define OPEN_FRI_MESSAGES_H

#include <cstddef>
#include <cstdint>

#ifndef FRI_VERSION
#error "define FRI_VERSION as 115, 205 or 207 (CMake: -DOPEN_FRI_VERSION=1.15, 2.5 or 2.7)"
#endif

namespace open_fri {

enum { JOINTS = 7, IOS = 10, NAME_SIZE = 64, DATAGRAM_SIZE = 1500 };

struct Io {
    char name[NAME_SIZE];
    std::uint32_t type;
    std::uint32_t direction;
    std::uint64_t digital;
    double analog;
};

/* A monitoring message. A missing field is 0, false or NaN, never the value of an earlier message. */
struct Monitoring {
    std::uint32_t sequence, reflected;
    std::uint32_t state, quality, period, multiplier;
    std::uint32_t safety, drive, operation, control, command_mode, overlay;
    std::uint32_t seconds, nanoseconds;
    double position[JOINTS], torque[JOINTS], commanded_position[JOINTS], commanded_torque[JOINTS];
    double external_torque[JOINTS], external_force[6];
    double pose[7], redundancy;
    std::uint32_t strategy;
    bool has_interpolator_position;
    double interpolator_position[JOINTS], interpolator_pose[7], interpolator_redundancy;
    double tracking;
    int io_count;
    Io ios[IOS];
};

/* A command message. */
struct Command {
    bool has_position, has_torque, has_wrench;
    double position[JOINTS], torque[JOINTS], wrench[6];
    int io_count;
    Io ios[IOS];
};

/* A message that has nothing in it. */
void clear(Monitoring *message);

/* False if the datagram is no sound monitoring message; *message is then not to be used. Reads no byte beyond size. */
bool decode(const std::uint8_t *datagram, std::size_t size, Monitoring *message);

/* Bytes written, at most capacity; 0 if it does not fit. */
std::size_t encode(const Command &command, std::uint32_t sequence, std::uint32_t reflected, std::uint8_t *datagram,
                   std::size_t capacity);

} // namespace open_fri

#endif
