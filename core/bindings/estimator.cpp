// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What Python calls of the estimator. Records are changed in place; single ones are arrays of length one.
#include <nanobind/nanobind.h>

#include "bindings/records.hpp"
#include "quadpi/estimator/smoother.hpp"

namespace nb = nanobind;

namespace quadpi {
namespace {

using Filters = Records<Filter>;
using Ring = Records<Estimate>;

// The arrays of a filter that takes sample by sample.
class LiveFilter {
public:
    explicit LiveFilter(nb::object its_arrays) : arrays(its_arrays) {}

    nb::object arrays;
    const Field<Filter> filter{arrays, "filter"};
    const Field<Estimate> ring{arrays, "ring"};
    const Field<ImuSample> sample{arrays, "sample"};
    const Field<FusedSample> fused{arrays, "fused"};
};

nb::tuple step_live(
    LiveFilter& live,
    std::int64_t time_ns,
    Records<const Vector3> rates,
    Records<const Vector3> specific_force
) {
    ImuSample& sample = live.sample.only();
    sample.time_ns = time_ns;
    sample.rates = only(rates);
    sample.specific_force = only(specific_force);
    Filter& filter = live.filter.only();
    Outcome outcome = COLLECTED;
    if (filter.filled > 0) {
        Buffer buffer(filter, live.ring.all());
        outcome = step(buffer, filter, sample, {}, live.fused.only());
    }
    return nb::make_tuple(static_cast<std::int64_t>(outcome), filter.status);
}

void catch_up(Filters filter, Ring ring, Records<ImuSample> samples) {
    Buffer(only(filter), ring).catch_up(samples);
}

std::int64_t hold(Filters filter, Ring ring, Records<Measurement> measurement) {
    return Buffer(only(filter), ring).hold(only(measurement));
}

bool usable_measurement(Records<Measurement> measurement) { return usable(only(measurement)); }

void fill_newest(Filters filter, Ring ring, Records<FusedSample> fused) {
    fill_fused(ring[only(filter).newest], only(filter).noise.rates, only(fused));
}

using ArrivalFields = std::tuple<Records<ImuSample>, Records<Measurement>, Records<std::int64_t>>;
using TraceFields = std::tuple<
    Records<Progress>,
    Records<std::int64_t>,
    Records<FilteredSample>,
    Records<FusedSample>,
    Records<Correction>>;

void run_all(Filters filter, Ring ring, const ArrivalFields& arrivals, const TraceFields& fields) {
    auto trace = made_of<Trace>(fields);
    run(only(filter), ring, made_of<Arrivals>(arrivals), trace);
}

void record_newest(Filters filter, Ring ring, const TraceFields& fields, std::int64_t sample) {
    auto trace = made_of<Trace>(fields);
    record(Buffer(only(filter), ring), only(filter), trace, sample);
}

using TapeFields = std::
    tuple<Records<Length>, Records<std::int64_t>, Records<Transition>, Records<Scalar>, Records<Estimate>>;

std::int64_t forward_pass(
    const std::tuple<Records<ImuSample>, Records<Correction>, Records<Noise>>& inputs,
    Records<Estimate> estimate,
    std::int64_t first,
    std::int64_t last,
    std::int64_t applied,
    const TapeFields& fields
) {
    auto tape = made_of<Tape>(fields);
    return forward(made_of<SmootherInputs>(inputs), only(estimate), first, last, applied, tape);
}

void backward_pass(
    const TapeFields& fields,
    Records<ErrorVector> adjoint,
    Records<ErrorMatrix> information,
    Records<EstimatedSample> smoothed
) {
    auto tape = made_of<Tape>(fields);
    backward(tape, only(adjoint), only(information), smoothed);
}

void find_pose_information(
    Records<StepMotion> steps,
    Records<Noise> noise,
    Records<PoseLimits> limits,
    double poses,
    Records<std::array<double, 2>> found
) {
    require(found.size == steps.size, DIFFERENT);
    pose_information(steps, only(noise), only(limits), poses, found);
}

// Attitudes at IMU samples relative to the body at `last_ns`, by the gyro alone.
void relative_attitudes(Records<ImuSample> imu, std::int64_t last_ns, Records<Quaternion> attitude) {
    require(imu.size >= 1 && attitude.size == imu.size, DIFFERENT);
    attitude[imu.size - 1] = {1.0, 0.0, 0.0, 0.0};
    for (std::size_t index = imu.size - 1; index-- > 0;) {
        const ImuSample &sample = imu[index], &following = imu[index + 1];
        attitude[index] = {1.0, 0.0, 0.0, 0.0};
        if (following.time_ns <= last_ns) {
            const double half = 0.5e-9 * static_cast<double>(following.time_ns - sample.time_ns);
            Vector3 turn;
            for (int axis = 0; axis < 3; ++axis) {
                turn[axis] = -half * (sample.rates[axis] + following.rates[axis]);
            }
            attitude[index] = product(attitude[index + 1], from_rotation_vector(turn));
        }
    }
}

}  // namespace

void bind_estimator(nb::module_& module) {
    NAME_CONSTANTS(module, ANGULAR_ACCELERATION, BUFFER_NS, HELD);
    module.def("pose_information", &find_pose_information);
    bind_held<LiveFilter>(module, "LiveFilter").def(nb::init<nb::object>());
    module.def("step", &step_live);
    module.def("catch_up", &catch_up);
    module.def("hold", &hold);
    module.def("usable_measurement", &usable_measurement);
    module.def("fill_newest", &fill_newest);
    module.def("run", &run_all);
    module.def("record", &record_newest);
    module.def("forward", &forward_pass);
    module.def("backward", &backward_pass);
    module.def("relative_attitudes", &relative_attitudes);
}

}  // namespace quadpi
