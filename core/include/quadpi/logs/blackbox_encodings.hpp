// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Decoding of the fields of a Blackbox frame: variable-length numbers, alone or in groups of 3, 4 and 8.
//
// Source: Betaflight's documentation, "Blackbox Internals"; for triples of variable size, the values in logs.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "quadpi/records.hpp"

namespace quadpi::blackbox {

using Bytes = Records<const std::uint8_t>;

enum Encoding : std::int64_t {
    SIGNED_VB = 0,
    UNSIGNED_VB = 1,
    NEG_14BIT = 3,
    TAG8_8SVB = 6,
    TAG2_3S32 = 7,
    TAG8_4S16 = 8,
    NOTHING = 9,  // zero, without a byte
    TAG2_3SVARIABLE = 10,
};
constexpr std::array<std::int64_t, 8> ENCODINGS = {
    SIGNED_VB,
    UNSIGNED_VB,
    NEG_14BIT,
    TAG8_8SVB,
    TAG2_3S32,
    TAG8_4S16,
    NOTHING,
    TAG2_3SVARIABLE,
};

// Given in place of the position behind a frame: the file ends within it, or its bytes are invalid.
constexpr std::int64_t CUT = -1, BROKEN = -2;

// Reads bytes one by one, and none beyond the last: from the first failure on, every byte reads as zero.
class Cursor {
public:
    Cursor(Bytes data, std::size_t position) : data(data), position(position) {}

    std::int64_t next() {
        if (!failure && position >= data.size) {
            failure = CUT;
        }
        return failure ? 0 : data[position++];
    }

    void skip(std::size_t count) {
        if (!failure && (position > data.size || data.size - position < count)) {
            failure = CUT;
        }
        position += failure ? 0 : count;
    }

    void fail() { failure = failure ? failure : BROKEN; }
    bool failed() const { return failure != 0; }
    // The position of the next byte, or why there is none.
    std::int64_t stop() const { return failure ? failure : static_cast<std::int64_t>(position); }

private:
    Bytes data;
    std::size_t position;
    std::int64_t failure = 0;
};

// A number of up to 32 bits, seven in each byte, lowest first.
inline std::int64_t read_unsigned(Cursor& cursor) {
    std::int64_t value = 0;
    for (int shift = 0; shift < 35; shift += 7) {
        const std::int64_t byte = cursor.next();
        if (cursor.failed()) {
            return 0;
        }
        value |= (byte & 0x7F) << shift;
        if (byte < 0x80) {
            return value;
        }
    }
    cursor.fail();
    return 0;
}

// A signed number in zigzag encoding.
inline std::int64_t read_signed(Cursor& cursor) {
    const std::int64_t value = read_unsigned(cursor);
    return (value >> 1) ^ -(value & 1);
}

// The number in the lowest bits, 32 at most, read as two's complement.
inline std::int64_t sign_extended(std::int64_t value, int bits) {
    const std::int64_t range = std::int64_t{1} << bits;
    value &= range - 1;
    return value >> (bits - 1) ? value - range : value;
}

using Group = std::array<std::int64_t, 4>;

// Three numbers whose size the first two bits give.
inline void read_triple(Cursor& cursor, bool variable, Group& values) {
    const std::int64_t lead = cursor.next();
    const int size = static_cast<int>(lead >> 6);
    if (size == 3) {
        for (int k = 0; k < 3; ++k) {
            const int length = static_cast<int>(lead >> (2 * k) & 3) + 1;
            std::int64_t value = 0;
            for (int byte = 0; byte < length; ++byte) {
                value |= cursor.next() << (8 * byte);
            }
            values[k] = sign_extended(value, 8 * length);
        }
        return;
    }
    std::int64_t bits = lead;
    for (int k = 0; k < size; ++k) {
        bits = bits << 8 | cursor.next();
    }
    if (size == 2 && !variable) {
        // The numbers of six bits fill a byte each.
        for (int k = 0; k < 3; ++k) {
            values[k] = sign_extended(bits >> (16 - 8 * k), 6);
        }
        return;
    }
    int first = 2, second = 2, third = 2;
    if (size == 1) {
        first = second = variable ? 5 : 4;
        third = 4;
    } else if (size == 2) {
        first = 8;
        second = third = 7;
    }
    values[0] = sign_extended(bits >> (second + third), first);
    values[1] = sign_extended(bits >> third, second);
    values[2] = sign_extended(bits, third);
}

// Four numbers of 0, 4, 8 or 16 bits, by the byte before them; the higher half of a byte comes first.
inline void read_quadruple(Cursor& cursor, Group& values) {
    const std::int64_t sizes = cursor.next();
    std::int64_t byte = 0;
    bool half_left = false;
    for (int k = 0; k < 4; ++k) {
        const int tag = static_cast<int>(sizes >> (2 * k) & 3);
        const int length = tag == 0 ? 0 : 1 << (tag - 1);
        std::int64_t value = 0;
        for (int nibble = 0; nibble < length; ++nibble) {
            if (!half_left) {
                byte = cursor.next();
            }
            value = value << 4 | (half_left ? byte & 0xF : byte >> 4);
            half_left = !half_left;
        }
        values[k] = length ? sign_extended(value, 4 * length) : 0;
    }
}

// Residuals of the fields of a frame, as many as there are encodings; `values` has room for them.
inline void read_fields(Cursor& cursor, Records<const std::int64_t> encoding, Records<std::int64_t> values) {
    const std::size_t count = std::min(encoding.size, values.size);
    Group some{};
    for (std::size_t place = 0; place < count && !cursor.failed();) {
        std::size_t group = 1;
        switch (encoding[place]) {
            case SIGNED_VB:
                values[place] = read_signed(cursor);
                break;
            case UNSIGNED_VB:
                values[place] = read_unsigned(cursor);
                break;
            case NEG_14BIT:
                values[place] = -sign_extended(read_unsigned(cursor), 14);
                break;
            case TAG8_8SVB: {
                while (group < 8 && place + group < count && encoding[place + group] == TAG8_8SVB) {
                    ++group;
                }
                const std::int64_t there = group > 1 ? cursor.next() : 1;
                for (std::size_t k = 0; k < group; ++k) {
                    values[place + k] = there >> k & 1 ? read_signed(cursor) : 0;
                }
                break;
            }
            case TAG8_4S16:
                read_quadruple(cursor, some);
                group = std::min<std::size_t>(4, count - place);
                std::copy_n(some.begin(), group, values.begin() + place);
                break;
            case TAG2_3S32:
            case TAG2_3SVARIABLE:
                read_triple(cursor, encoding[place] == TAG2_3SVARIABLE, some);
                group = std::min<std::size_t>(3, count - place);
                std::copy_n(some.begin(), group, values.begin() + place);
                break;
            default:
                values[place] = 0;
        }
        place += group;
    }
}

}  // namespace quadpi::blackbox
