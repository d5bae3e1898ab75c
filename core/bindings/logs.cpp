// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What Python calls to read logs. Tables and rules are checked here, as all else of a file may be hostile.
#include <nanobind/nanobind.h>

#include "bindings/records.hpp"
#include "quadpi/logs/blackbox.hpp"
#include "quadpi/logs/mcap_messages.hpp"

namespace nb = nanobind;

namespace quadpi {
namespace {

nb::tuple decode_blackbox(
    blackbox::Bytes flight,
    std::size_t start,
    Records<const blackbox::Rules> rules,
    Records<const std::int64_t> chosen,
    Records<double> table
) {
    if (rules.size != 1 || !rules[0].valid()) {
        throw nb::value_error("rules that are none of a Blackbox log");
    }
    for (const std::int64_t field : chosen) {
        if (field < 0 || field >= static_cast<std::int64_t>(blackbox::FIELDS_MAX)) {
            throw nb::value_error("a field that no frame has");
        }
    }
    const blackbox::Decoded found = blackbox::Decoder(flight, rules[0]).decode(start, chosen, table);
    return nb::make_tuple(found.frames, found.ended, found.damaged_at, found.damaged);
}

template <std::size_t N>
nb::list listed(const std::array<std::int64_t, N>& numbers) {
    nb::list list;
    for (const std::int64_t number : numbers) {
        list.append(number);
    }
    return list;
}

nb::tuple mcap_messages(mcap::Bytes chunk, Records<mcap::MessagePlace> found) {
    const mcap::Messages messages = mcap::find_messages(chunk, found);
    return nb::make_tuple(messages.count, messages.stop);
}

}  // namespace

void bind_logs(nb::module_& module) {
    module.attr("BLACKBOX_ENCODINGS") = listed(blackbox::ENCODINGS);
    module.attr("BLACKBOX_PREDICTORS") = listed(blackbox::PREDICTORS);
    module.attr("BLACKBOX_KINDS") = nb::str(blackbox::KINDS.data(), blackbox::KINDS.size());
    module.attr("BLACKBOX_FIELDS_MAX") = blackbox::FIELDS_MAX;
    module.attr("BLACKBOX_NOTHING") = static_cast<std::int64_t>(blackbox::NOTHING);
    module.attr("BLACKBOX_TAG8_4S16") = static_cast<std::int64_t>(blackbox::TAG8_4S16);
    module.def("decode_blackbox", &decode_blackbox);
    module.def("mcap_messages", &mcap_messages);
}

}  // namespace quadpi
