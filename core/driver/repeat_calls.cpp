// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Repeats recorded calls of the core, and prints a checksum of what each function left in its arguments.
//
// Of a replay in Python (test/core/recorded_calls.py), built for any processor, without Python: two
// processors give the same bits where they print the same. A file is a sequence of calls: the name of the
// function, and its arguments in the order of quadpi_core/_core.pyi, each as a length in bytes and that many
// bytes; in the place of an object are its arrays, those of a model behind the name of its class.
#include <array>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "quadpi/estimator/filter_run.hpp"
#include "quadpi/models/ensembles.hpp"
#include "quadpi/models/physical_kernel.hpp"
#include "quadpi/models/polynomials.hpp"
#include "quadpi/monitor/monitor_step.hpp"
#include "quadpi/monitor/pairing.hpp"

namespace quadpi {
namespace {

// What a file holds in its order; it ends where a length would begin.
class Reader {
public:
    explicit Reader(const char* path) : file(path, std::ios::binary) {
        if (!file) {
            throw std::runtime_error(std::string(path) + ": cannot be read");
        }
    }

    bool ended() { return file.peek() == std::ifstream::traits_type::eof(); }

    std::int64_t length() {
        std::int64_t value = 0;
        fill(&value, sizeof value);
        return value;
    }

    void fill(void* into, std::size_t bytes) {
        if (!file.read(static_cast<char*>(into), static_cast<std::streamsize>(bytes))) {
            throw std::runtime_error("the file ends within a call");
        }
    }

private:
    std::ifstream file;
};

// The arguments of a call, taken one after the other.
class Arguments {
public:
    explicit Arguments(Reader& reader) {
        for (std::int64_t left = reader.length(); left > 0; --left) {
            const auto bytes = static_cast<std::size_t>(reader.length());
            sizes.push_back(bytes);
            // Of doubles, so that records are aligned.
            memory.emplace_back(bytes / sizeof(double) + 1);
            reader.fill(memory.back().data(), bytes);
        }
    }

    template <class T>
    Records<T> records() {
        const std::size_t bytes = sizes.at(taken);
        if (bytes % sizeof(T) != 0) {
            throw std::runtime_error("an argument of another size than its records");
        }
        return {reinterpret_cast<T*>(memory[taken++].data()), bytes / sizeof(T)};
    }

    template <class T>
    operator Records<T>() {
        return records<T>();
    }

    template <class T>
    T& one() {
        const Records<T> all = records<T>();
        if (all.size == 0) {
            throw std::runtime_error("an empty argument for a record");
        }
        return all[0];
    }

    // CRC-32 as of zip files, of all arguments.
    std::uint32_t checksum(std::uint32_t sum) const {
        sum = ~sum;
        for (std::size_t argument = 0; argument < sizes.size(); ++argument) {
            const auto* bytes = reinterpret_cast<const unsigned char*>(memory[argument].data());
            for (std::size_t i = 0; i < sizes[argument]; ++i) {
                sum ^= bytes[i];
                for (int bit = 0; bit < 8; ++bit) {
                    sum = (sum >> 1) ^ ((sum & 1) != 0 ? 0xEDB88320u : 0u);
                }
            }
        }
        return ~sum;
    }

private:
    std::vector<std::vector<double>> memory;
    std::vector<std::size_t> sizes;
    std::size_t taken = 0;
};

void catch_up_call(Arguments& given) {
    Filter& filter = given.one<Filter>();
    const Records<Estimate> ring = given;
    Buffer(filter, ring).catch_up(given);
}

void hold_call(Arguments& given) {
    Filter& filter = given.one<Filter>();
    const Records<Estimate> ring = given;
    Buffer(filter, ring).hold(given.one<Measurement>());
}

// In braces, arguments are taken from the left to the right.
Trace trace_of(Arguments& given) { return {given.one<Progress>(), given, given, given, given}; }

void run_call(Arguments& given) {
    Filter& filter = given.one<Filter>();
    const Records<Estimate> ring = given;
    const Arrivals arrivals{given, given, given};
    Trace trace = trace_of(given);
    run(filter, ring, arrivals, trace);
}

void record_call(Arguments& given) {
    Filter& filter = given.one<Filter>();
    const Records<Estimate> ring = given;
    Trace trace = trace_of(given);
    record(Buffer(filter, ring), filter, trace, given.one<std::int64_t>());
}

void take_stretch_call(Arguments& given) {
    auto& state = given.one<PairingState>();
    const Records<Entry> rings = given;
    const ArrivingSamples arriving{given, given, given, given, given, given, given, given, given, given};
    const auto start = given.one<std::int64_t>();
    const Records<std::int64_t> taken_ns = given;
    Pairing(state, rings).take_stretch(arriving, start, taken_ns, given.records<double>().data);
}

// Models of recorded calls, by the name of their class in quadpi_core/_core.pyi.
using Model = std::unique_ptr<Evaluator>;

Model polynomials(Arguments& given) {
    const Polynomials model{given, given, given, given.records<double>().data};
    return std::make_unique<PolynomialEvaluator>(model, Rows{given.records<double>().data, 1});
}

Model physical(Arguments& given) {
    const PhysicalModel model{given.one<const PhysicalCommon>(), given, given, given};
    return std::make_unique<PhysicalEvaluator>(model);
}

Model ensembles(Arguments& given) {
    const Ensembles model{given, given, given, given.records<double>().data};
    EnsembleScratch scratch{given.records<double>().data, given.records<double>().data, nullptr, 0};
    const Records<double> outputs = given;
    scratch.outputs = outputs.data;
    scratch.networks = outputs.size / (BANKS * MOST_OUTPUTS * ENSEMBLE_BLOCK);
    return std::make_unique<EnsembleEvaluator>(model, scratch);
}

const std::map<std::string, Model (*)(Arguments&)> MODELS = {
    {"Ensembles", &ensembles},
    {"Physical", &physical},
    {"Polynomials", &polynomials},
};

Model model_of(Arguments& given) {
    const auto name = given.records<char>();
    return MODELS.at(std::string(name.data, name.size))(given);
}

void evaluate_call(Arguments& given) {
    const Model model = model_of(given);
    const Records<const InputVector> inputs = given;
    const Records<const Derivatives> derivatives = given;
    const auto& factors = given.one<const Wrench>();
    model->evaluate(inputs, derivatives, factors, Evaluation::in(given, inputs.size));
}

void step_monitor_call(Arguments& given) {
    const MonitorMemory memory{
        given.one<const AlarmLimits>(), given.one<AlarmState>(), given, given.one<const Wrench>()
    };
    const Model model = model_of(given);
    auto& preparation = given.one<PreparationMemory>();
    const Records<const std::int64_t> time_ns = given;
    const Records<const double> samples = given;
    MonitorRows rows{given, given, given};
    const auto block = std::make_unique<MonitorBlock>();
    step(memory, preparation, *model, time_ns, samples, *block, rows);
}

using Call = void (*)(Arguments&);
const std::map<std::string, Call> CALLS = {
    {"catch_up", &catch_up_call},
    {"evaluate", &evaluate_call},
    {"hold", &hold_call},
    {"record", &record_call},
    {"run", &run_call},
    {"step_monitor", &step_monitor_call},
    {"take_stretch", &take_stretch_call},
};

void repeat(const char* path) {
    Reader reader(path);
    std::map<std::string, std::uint32_t> sums;
    while (!reader.ended()) {
        std::string name(static_cast<std::size_t>(reader.length()), ' ');
        reader.fill(name.data(), name.size());
        Arguments given(reader);
        CALLS.at(name)(given);
        sums[name] = given.checksum(sums[name]);
    }
    for (const auto& [name, sum] : sums) {
        std::printf("%s %08x\n", name.c_str(), static_cast<unsigned>(sum));
    }
}

}  // namespace
}  // namespace quadpi

int main(int count, char** arguments) {
    if (count != 2) {
        std::fprintf(stderr, "usage: repeat_calls FILE\n");
        return 2;
    }
    try {
        quadpi::repeat(arguments[1]);
    } catch (const std::exception& error) {
        std::fprintf(stderr, "repeat_calls: %s\n", error.what());
        return 1;
    }
    return 0;
}
