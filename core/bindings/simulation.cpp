// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What Python calls of the simulation.
//
// A law of the aerodynamics or an effect is the name of one of this core, or a function of Python that is
// called without arguments: it reads and writes the state that the flight works on.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>

#include <list>
#include <string>

#include "bindings/rotors.hpp"
#include "quadpi/simulation/dynamics.hpp"
#include "quadpi/simulation/effects/table.hpp"
#include "quadpi/simulation/physical_aerodynamics.hpp"
#include "quadpi/simulation/reference_signals.hpp"
#include "quadpi/simulation/rotor_local.hpp"

namespace nb = nanobind;

namespace quadpi {
namespace {

using Parameters = Records<const double>;
using Law = std::function<void(State&)>;
using Vehicles = Records<const VehicleNumbers>;

const VehicleNumbers& flown(Vehicles vehicle) {
    checked_rotors(only(vehicle).rotors);
    return only(vehicle);
}

constexpr const char* NOT_SIX = "an effect gives six forces and moments, each a number or one per instant";

const WrenchEffect& effect_of(const std::string& name, Parameters parameters) {
    const WrenchEffect* effect = find_effect(name);
    require(effect != nullptr, "no such effect");
    require(parameters.size >= effect->parameters, "too few parameters of an effect");
    return *effect;
}

// A law of the aerodynamics by name, with its table of numbers.
Law aerodynamics_of(const std::string& name, const VehicleNumbers& vehicle, Parameters numbers) {
    if (name == "physical") {
        require(numbers.size == 2 * TERMS, "not the numbers of the physical model");
        const auto& values = *reinterpret_cast<const TermValues*>(numbers.data);
        const double reference_thrust = numbers[TERMS];
        return [&vehicle, &values, reference_thrust](State& state) {
            physical_aerodynamics(state, vehicle, values, reference_thrust);
        };
    }
    require(name == "rotor_local", "no such law of the aerodynamics");
    return [&vehicle](State& state) { rotor_local(state, vehicle); };
}

double number_of(nb::handle value) {
    if (PyFloat_Check(value.ptr())) {
        return PyFloat_AS_DOUBLE(value.ptr());
    }
    HeldBuffer buffer;
    if (buffer.hold<const double>(value.ptr()) && buffer.bytes() == sizeof(double)) {
        return *static_cast<const double*>(buffer.data());
    }
    double number = 0.0;
    require(nb::try_cast(value, number), NOT_SIX);
    return number;
}

// An `AddedEffect` of Python: the name of an effect or a function, its parameters, and the shape of its law.
class AddedEffect {
public:
    AddedEffect(nb::handle given, const VehicleNumbers& vehicle)
        : vehicle(vehicle),
          parameters(given, "parameters"),
          shape(given, "shape"),
          function(given.attr("law")) {
        if (nb::isinstance<nb::str>(function)) {
            effect = effect_of(nb::cast<std::string>(function), parameters.all()).function;
        }
    }

    void add_to(State& state) const {
        const Wrench law = effect != nullptr ? effect(state, vehicle, parameters.all().data) : called();
        const Wrench added = shaped(law, state, vehicle, shape.only());
        for (int axis = 0; axis < AXES; ++axis) {
            state.wrench[axis] += added[axis];
        }
    }

private:
    Wrench called() const {
        const nb::gil_scoped_acquire locked;
        const nb::object given = function();
        require(nb::isinstance<nb::sequence>(given) && nb::len(given) == AXES, NOT_SIX);
        Wrench wrench;
        for (int axis = 0; axis < AXES; ++axis) {
            wrench[axis] = number_of(given[axis]);
        }
        return wrench;
    }

    const VehicleNumbers& vehicle;
    Field<const double> parameters;
    Field<const Shape> shape;
    nb::object function;
    EffectFunction effect = nullptr;
};

Law law_of(nb::handle given, const VehicleNumbers& vehicle, Parameters numbers) {
    if (nb::isinstance<nb::str>(given)) {
        return aerodynamics_of(nb::cast<std::string>(given), vehicle, numbers);
    }
    return [given](State&) {
        const nb::gil_scoped_acquire locked;
        given();
    };
}

using Vectors = Records<const Vector3>;
using DemandFields = std::tuple<
    Vectors,
    Vectors,
    Vectors,
    Vectors,
    Parameters,
    Parameters,
    Records<const std::array<double, 2>>,
    Parameters,
    Vectors>;

Demand demand_of(const DemandFields& fields) {
    const auto demand = made_of<Demand>(fields);
    const std::size_t count = demand.yaw.size;
    require_each(count, demand.position, demand.velocity, demand.acceleration, demand.jerk, demand.wind);
    require_each(count, demand.yaw_rate, demand.thrust, demand.tilt);
    require(count > 0, DIFFERENT);
    return demand;
}

// Of arrays by the vehicle's rotors there is a copy with room for more; give_back() ends with it.
struct HeldControls {
    explicit HeldControls(nb::handle given)
        : nominal(given, "nominal"),
          disturbance(given, "disturbance"),
          command_given(given, "command"),
          rotors(checked_rotors(nominal.only().rotors)) {
        const Field<const double> mixing(given, "allocation"), acting(given, "effectiveness");
        require(mixing.all().size == 4 * rotors && acting.all().size == 4 * rotors, DIFFERENT);
        require(command_given.all().size == rotors, DIFFERENT);
        for (std::size_t rotor = 0; rotor < rotors; ++rotor) {
            command[rotor] = command_given.all()[rotor];
            for (std::size_t control = 0; control < 4; ++control) {
                allocation[rotor][control] = mixing.all()[4 * rotor + control];
                effectiveness[control][rotor] = acting.all()[control * rotors + rotor];
            }
        }
    }

    Controls controls() { return {nominal.only(), allocation, effectiveness, disturbance.only(), command}; }

    void give_back() const { std::copy_n(command.begin(), rotors, command_given.all().data); }

    Field<const VehicleNumbers> nominal;
    Field<Wrench> disturbance;
    Field<double> command_given;
    std::size_t rotors;
    Allocation allocation{};
    Effectiveness effectiveness{};
    PerRotor command{};
};

void fly_along(
    Vehicles vehicle,
    nb::handle aerodynamics,
    Parameters numbers,
    nb::sequence effects,
    nb::handle given_controls,
    const DemandFields& given_demand,
    Records<IntegratedMotion> motions,
    Records<State> state,
    Records<Logged> log,
    Records<std::int64_t> done
) {
    std::list<AddedEffect> added;
    Physics physics{flown(vehicle), law_of(aerodynamics, flown(vehicle), numbers), {}};
    for (const nb::handle effect : effects) {
        const AddedEffect& one = added.emplace_back(effect, flown(vehicle));
        physics.effects.push_back([&one](State& now) { one.add_to(now); });
    }
    HeldControls held_controls(given_controls);
    Controls controls = held_controls.controls();
    const Demand demand = demand_of(given_demand);
    require(log.size >= 2 && log.size <= demand.yaw.size, DIFFERENT);
    require((demand.yaw.size - 1) % (log.size - 1) == 0, "a log of other instants than those of the demand");
    require(motions.size == MOTIONS, "not the memory of the integrator");
    State& now = only(state);
    std::int64_t& flown = only(done);
    {
        const nb::gil_scoped_release unlocked;
        fly(physics, controls, demand, motions, now, log, flown);
    }
    held_controls.give_back();
}

void fill_aerodynamics(Records<State> states, Vehicles vehicle, const std::string& name, Parameters numbers) {
    const Law law = aerodynamics_of(name, flown(vehicle), numbers);
    for (State& state : states) {
        law(state);
    }
}

void effect_wrenches(
    const std::string& name,
    Records<State> states,
    Vehicles vehicle,
    Parameters parameters,
    Records<const Shape> shape,
    Records<Wrench> wrenches
) {
    const WrenchEffect& effect = effect_of(name, parameters);
    require(states.size == wrenches.size, DIFFERENT);
    for (std::size_t i = 0; i < states.size; ++i) {
        const Wrench law = effect.function(states[i], flown(vehicle), parameters.data);
        wrenches[i] = shaped(law, states[i], flown(vehicle), only(shape));
    }
}

void remember_along(
    const std::string& name, Records<State> states, Vehicles vehicle, Parameters parameters, double step_s
) {
    remember(effect_of(name, parameters).function, states, flown(vehicle), parameters.data, step_s);
}

void remembered_along(
    const std::string& name,
    Records<const State> states,
    Vehicles vehicle,
    Parameters parameters,
    Records<OwnState> memory,
    double step_s,
    Records<double> added
) {
    const EffectFunction effect = effect_of(name, parameters).function;
    require(added.size == states.size * AXES * memory.size, DIFFERENT);
    remembered_wrenches(effect, states, flown(vehicle), parameters.data, memory, step_s, added.data);
}

void fill_waves(
    Parameters time,
    double amplitude,
    Parameters frequencies,
    Parameters phases,
    double sweep,
    Records<const Span> window,
    Records<Jet> jets
) {
    require(jets.size == time.size && frequencies.size == phases.size, DIFFERENT);
    wave_jets(time, amplitude, frequencies, phases, sweep, only(window), jets);
}

void fill_edges(Parameters time, Parameters instants, Parameters heights, double rise, Records<Jet> jets) {
    require(jets.size == time.size && instants.size == heights.size, DIFFERENT);
    edge_jets(time, instants, heights, rise, jets);
}

void fill_orbit(
    Parameters time,
    double radius,
    double turn_rate,
    double bearing,
    Records<const Span> window,
    Records<Jet> jets
) {
    require(jets.size == 3 * time.size, DIFFERENT);
    orbit_jets(time, radius, turn_rate, bearing, only(window), jets);
}

void bind_constants(nb::module_& module) {
    NAME_CONSTANTS(module, ADVANCE_RATIO_MAX, FLOWN_RATE_MAX_RAD_S, OWN_STATE_CHANGE_MAX, NOT_SIX);
    module.attr("NEAREST_SURFACE") = effects::NEAREST_SURFACE;
    NAME_CONSTANTS(module, POSITION_ERROR_MAX_M, SHAPE_MAX);
    module.attr("SHORTEST_CABLE_M") = effects::SHORTEST_CABLE_M;
    NAME_CONSTANTS(module, SPECIFIC_FORCE_MIN, STEP_HZ, TILT_COSINE_MIN, TILT_MAX_DEG);
    nb::list names;
    for (const WrenchEffect& effect : WRENCH_EFFECTS) {
        names.append(nb::str(effect.name.data(), effect.name.size()));
    }
    module.attr("WRENCH_EFFECTS") = nb::tuple(names);
}

}  // namespace

void bind_simulation(nb::module_& module) {
    bind_constants(module);
    const nb::call_guard<nb::gil_scoped_release> unlocked;
    module.def("fly", &fly_along);
    module.def("fill_aerodynamics", &fill_aerodynamics, unlocked);
    module.def("effect_wrenches", &effect_wrenches, unlocked);
    module.def("remember", &remember_along, unlocked);
    module.def("remembered_wrenches", &remembered_along, unlocked);
    module.def("wave_jets", &fill_waves);
    module.def("edge_jets", &fill_edges);
    module.def("orbit_jets", &fill_orbit);
    module.def("quaternions_of", over_rows(&from_rotation_vector));
    module.def("rotation_vectors_of", over_rows(&to_rotation_vector));
}

}  // namespace quadpi
