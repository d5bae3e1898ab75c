// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Where the messages lie in a chunk of an MCAP file.
//
// Source: the MCAP specification, version 0: records of an opcode, a length of 8 bytes, and that many bytes.
#pragma once

#include <cstddef>
#include <cstdint>

#include "quadpi/records.hpp"

namespace quadpi::mcap {

using Bytes = Records<const std::uint8_t>;

constexpr std::uint8_t MESSAGE = 0x05;
constexpr std::size_t PREFIX = 9;
// Of a message: channel (2 bytes), sequence (4), log time and time of publication (8 each).
constexpr std::size_t HEAD = 22;

struct MessagePlace {
    std::int64_t channel;
    std::int64_t time_ns;  // of the log; negative where it is beyond the year 2262
    std::int64_t start;    // of what follows the head
    std::int64_t length;
};

struct Messages {
    std::size_t count;
    std::size_t stop;  // the end of the chunk, or where the first record begins that is not whole
};

inline std::uint64_t little_endian(const std::uint8_t* bytes, std::size_t count) {
    std::uint64_t number = 0;
    for (std::size_t i = 0; i < count; ++i) {
        number |= static_cast<std::uint64_t>(bytes[i]) << (8 * i);
    }
    return number;
}

// Find the messages of a chunk, as many as there is room for.
inline Messages find_messages(Bytes chunk, Records<MessagePlace> found) {
    std::size_t position = 0, count = 0;
    while (position < chunk.size) {
        const std::size_t left = chunk.size - position;
        const std::uint8_t* record = chunk.data + position;
        const std::uint64_t length = left < PREFIX ? left : little_endian(record + 1, 8);
        const bool whole = left >= PREFIX && length <= left - PREFIX;
        const bool is_message = whole && record[0] == MESSAGE;
        if (!whole || (is_message && (length < HEAD || count == found.size))) {
            break;
        }
        if (is_message) {
            found[count++] = {
                static_cast<std::int64_t>(little_endian(record + PREFIX, 2)),
                static_cast<std::int64_t>(little_endian(record + PREFIX + 6, 8)),
                static_cast<std::int64_t>(position + PREFIX + HEAD),
                static_cast<std::int64_t>(length - HEAD),
            };
        }
        position += PREFIX + static_cast<std::size_t>(length);
    }
    return {count, position};
}

}  // namespace quadpi::mcap
