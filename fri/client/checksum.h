// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_CHECKSUM_H
#define FRI_CLIENT_CHECKSUM_H

#include <cstddef>
#include <cstdint>

/* CRC-32 as of zlib, four bits at a time. */
inline std::uint32_t checksum(const std::uint8_t *bytes, std::size_t size)
{
    static const std::uint32_t table[16] = {0x00000000, 0x1db71064, 0x3b6e20c8, 0x26d930ac, 0x76dc4190, 0x6b6b51f4,
                                            0x4db26158, 0x5005713c, 0xedb88320, 0xf00f9344, 0xd6d6a3e8, 0xcb61b38c,
                                            0x9b64c2b0, 0x86d3d2d4, 0xa00ae278, 0xbdbdf21c};
    std::uint32_t crc = 0xffffffffu;
    for (std::size_t i = 0; i < size; ++i) {
        crc ^= bytes[i];
        crc = (crc >> 4) ^ table[crc & 15];
        crc = (crc >> 4) ^ table[crc & 15];
    }
    return ~crc;
}

inline std::uint32_t read_little_endian(const std::uint8_t *bytes)
{
    return bytes[0] | static_cast<std::uint32_t>(bytes[1]) << 8 | static_cast<std::uint32_t>(bytes[2]) << 16 |
           static_cast<std::uint32_t>(bytes[3]) << 24;
}

#endif
