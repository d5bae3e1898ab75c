// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Decoder of the frames of a Blackbox log; their fields are the residuals of a predictor.
//
// A log has frames of the main loop (I: intra, P: predicted from the frames before), others that are skipped
// (S, G, H) and events (E). There are no lengths and no checksums: a frame counts as whole if the byte behind
// it starts another one and its time continues that of the frame before. After a damaged frame the search
// resumes at its second byte, and P frames are used again from the next I frame on.
//
// Source: Betaflight's documentation, "Blackbox Internals"; for the predictor of the motor's lowest output,
// the values in logs.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "quadpi/logs/blackbox_encodings.hpp"
#include "quadpi/records.hpp"

namespace quadpi::blackbox {

// Firmwares log up to 200 fields.
constexpr std::size_t FIELDS_MAX = 256;
// Largest number of fields read again behind damaged frames, per byte of the flight, before the rest counts
// as damaged; random bytes take about four.
constexpr std::int64_t REREAD_MAX = 16;
// Largest step in time from frame to frame [µs]: longer than any pause of a logger that resumes by itself.
constexpr std::int64_t LEAP_MAX_US = 10'000'000;

// Kinds of frames beside events, by their places here.
constexpr std::string_view KINDS = "IPSGH";
constexpr std::int64_t INTRA = 0, PREDICTED = 1;
constexpr std::uint8_t EVENT = 'E', LOG_END = 255;
constexpr std::string_view END_OF_LOG = "End of log";
constexpr std::int64_t UINT32 = 0xFFFF'FFFF;

enum Predictor : std::int64_t {
    ZERO = 0,
    PREVIOUS = 1,
    LINE = 2,
    AVERAGE = 3,
    MINTHROTTLE = 4,
    MOTOR_0 = 5,
    INCREMENT = 6,
    MIDDLE = 8,  // 1500, the middle of a servo [µs]
    VBATREF = 9,
    MINMOTOR = 11,
};
constexpr std::array<std::int64_t, 10> PREDICTORS = {
    ZERO,
    PREVIOUS,
    LINE,
    AVERAGE,
    MINTHROTTLE,
    MOTOR_0,
    INCREMENT,
    MIDDLE,
    VBATREF,
    MINMOTOR,
};

using Fields = std::array<std::int64_t, FIELDS_MAX>;
template <class T>
using ByKind = std::array<T, KINDS.size()>;

// Layout of the frames of a log, as its headers say.
struct Rules {
    ByKind<Fields> encoding, predictor;
    ByKind<std::int64_t> sizes;           // number of fields; 0 for a kind that the log does not have
    Fields is_signed;                     // whether a field of main frames is signed
    std::int64_t time, iteration, motor;  // indices of the fields time, loopIteration and motor[0]
    // Logged iterations of the main loop: one in `every` as an I frame, `numerator` in `denominator` as P
    // frames.
    std::int64_t every, numerator, denominator;
    std::int64_t minthrottle, vbatref, minmotor;  // constants of predictors

    // Whether all indices lie within a frame and no interval is zero.
    bool valid() const {
        const auto is_field = [](std::int64_t place) {
            return 0 <= place && place < static_cast<std::int64_t>(FIELDS_MAX);
        };
        for (const std::int64_t size : sizes) {
            if (size != 0 && !is_field(size - 1)) {
                return false;
            }
        }
        return is_field(time) && is_field(iteration) && is_field(motor) && every > 0 && numerator > 0 &&
               denominator > 0;
    }
};

// What a log holds beside its frames.
struct Decoded {
    std::int64_t frames;      // number of main frames
    bool ended;               // whether it has an end event
    std::int64_t damaged_at;  // position of the first byte outside frames
    std::int64_t damaged;     // number of such bytes
};

// The place of a kind of frame; -1 for other bytes.
inline std::int64_t kind_of(std::uint8_t byte) {
    const std::size_t place = KINDS.find(static_cast<char>(byte));
    return place == std::string_view::npos ? -1 : static_cast<std::int64_t>(place);
}

// Step over an event behind its first byte; true at the end of the log.
inline bool skip_event(Cursor& cursor) {
    switch (cursor.next()) {
        case LOG_END:
            for (const char letter : END_OF_LOG) {
                if (cursor.next() != letter) {
                    cursor.fail();
                }
            }
            return !cursor.failed();
        // Sync beep, disarmed: one number.
        case 0:
        case 15:
            read_unsigned(cursor);
            break;
        // Logging resumed, flight mode: two numbers.
        case 14:
        case 30:
            read_unsigned(cursor);
            read_unsigned(cursor);
            break;
        // In-flight adjustment; a single-precision number where the highest bit is set.
        case 13:
            if (cursor.next() < 0x80) {
                read_unsigned(cursor);
            } else {
                cursor.skip(4);
            }
            break;
        default:
            cursor.fail();
    }
    return false;
}

// Number of iterations of the main loop to the next one that is logged.
inline std::int64_t to_next_logged(std::int64_t iteration, const Rules& rules) {
    const std::int64_t since = (iteration % rules.every + rules.every) % rules.every;
    const std::int64_t phase = (since + rules.numerator - 1) % rules.denominator;
    const bool next = (phase + 1) % rules.denominator < rules.numerator;
    return std::min(next ? 1 : rules.denominator - phase, rules.every - since);
}

// Finds the main frames of a flight, one after the other.
class Decoder {
public:
    Decoder(Bytes data, const Rules& rules) : data(data), rules(rules) {}

    // Fill a table with the chosen fields of the main frames, row by row, up to its number of rows.
    Decoded decode(std::size_t position, Records<const std::int64_t> chosen, Records<double> table) {
        Decoded found{};
        const std::size_t room = chosen.size > 0 ? table.size / chosen.size : 0;
        std::int64_t reread = 0;
        while (position < data.size) {
            const std::int64_t stop = frame(position);
            if (stop == CUT) {
                break;
            }
            const std::int64_t kind = kind_of(data[position]);
            bool whole = stop >= 0;
            if (whole && (kind == INTRA || (kind == PREDICTED && builds))) {
                whole = continues(kind, found.frames);
                if (whole) {
                    const auto row = static_cast<std::size_t>(found.frames++);
                    for (std::size_t column = 0; row < room && column < chosen.size; ++column) {
                        table[row * chosen.size + column] =
                            static_cast<double>(values[static_cast<std::size_t>(chosen[column])]);
                    }
                }
            }
            if (whole) {
                if (data[position] == EVENT && data[position + 1] == LOG_END) {
                    found.ended = true;
                    break;
                }
                position = static_cast<std::size_t>(stop);
                continue;
            }
            if (found.damaged == 0) {
                found.damaged_at = static_cast<std::int64_t>(position);
            }
            builds = false;
            ++found.damaged;
            ++position;
            reread += std::max<std::int64_t>(kind >= 0 ? rules.sizes[kind] : 0, 1);
            if (reread > REREAD_MAX * static_cast<std::int64_t>(data.size)) {
                found.damaged += static_cast<std::int64_t>(data.size - position);
                break;
            }
        }
        return found;
    }

private:
    bool starts_frame(std::uint8_t byte) const {
        const std::int64_t kind = kind_of(byte);
        return kind >= 0 && rules.sizes[kind] > 0;
    }

    // Read the residuals of a frame or step over an event; gives the position behind it.
    //
    // It also counts as broken if neither another frame nor the end of the file follows.
    std::int64_t frame(std::size_t position) {
        const std::uint8_t first = data[position];
        Cursor cursor(data, position + 1);
        if (first == EVENT) {
            if (skip_event(cursor)) {
                return cursor.stop();
            }
        } else if (starts_frame(first)) {
            const std::int64_t kind = kind_of(first);
            const auto count = static_cast<std::size_t>(rules.sizes[kind]);
            read_fields(cursor, {rules.encoding[kind].data(), count}, {values.data(), count});
        } else {
            return BROKEN;
        }
        const std::int64_t stop = cursor.stop();
        if (stop < 0 || static_cast<std::size_t>(stop) >= data.size) {
            return stop;
        }
        const std::uint8_t following = data[static_cast<std::size_t>(stop)];
        return following == EVENT || starts_frame(following) ? stop : BROKEN;
    }

    // Add to the residuals of a main frame the predictions from the two frames before it and the headers.
    void predict(std::int64_t kind) {
        for (std::size_t place = 0; place < static_cast<std::size_t>(rules.sizes[kind]); ++place) {
            const std::int64_t value =
                (values[place] + prediction(rules.predictor[kind][place], place)) & UINT32;
            values[place] = rules.is_signed[place] ? sign_extended(value, 32) : value;
        }
    }

    std::int64_t prediction(std::int64_t predictor, std::size_t place) const {
        switch (predictor) {
            case PREVIOUS:
                return before[place];
            case LINE:
                return 2 * before[place] - earlier[place];
            case AVERAGE:
                // Rounded toward zero, as in the firmware.
                return (before[place] + earlier[place]) / 2;
            case MINTHROTTLE:
                return rules.minthrottle;
            case MOTOR_0:
                return values[static_cast<std::size_t>(rules.motor)];
            case INCREMENT:
                return before[place] + to_next_logged(before[place], rules);
            case MIDDLE:
                return 1500;
            case VBATREF:
                return rules.vbatref;
            case MINMOTOR:
                return rules.minmotor;
            default:
                return 0;
        }
    }

    // Whether a 32-bit counter has advanced by at most `most`.
    static bool goes_on(std::int64_t since, std::int64_t now, std::int64_t most) {
        return ((now - since) & UINT32) <= most;
    }

    // Predict a main frame, and keep it if it continues those before.
    bool continues(std::int64_t kind, std::int64_t frames) {
        predict(kind);
        const auto time = static_cast<std::size_t>(rules.time),
                   iteration = static_cast<std::size_t>(rules.iteration);
        bool whole = frames == 0 || (goes_on(before[time], values[time], LEAP_MAX_US) &&
                                     goes_on(before[iteration], values[iteration], UINT32 >> 1));
        // Two refused I frames that agree with each other are right, and the frame before them was wrong.
        if (!whole && kind == INTRA) {
            whole = refused >= 0 && goes_on(refused, values[time], LEAP_MAX_US);
            refused = values[time];
        }
        if (whole) {
            builds = true;
            refused = -1;
            earlier = kind == INTRA ? values : before;
            before = values;
        }
        return whole;
    }

    Bytes data;
    const Rules& rules;
    Fields values{}, before{}, earlier{};
    // Whether a valid frame precedes, for P frames to be predicted from.
    bool builds = false;
    // Time of an I frame that was refused; -1 without one.
    std::int64_t refused = -1;
};

}  // namespace quadpi::blackbox
