# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A simulation that is known by the wrench in the logs, and what flights tell of it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from quadpi_core.discrepancy import discover, load_simulation
from quadpi_core.discrepancy.augmented_simulation import AugmentedSimulation
from quadpi_core.discrepancy.effect_response import Compared, explained_wrench
from quadpi_core.discrepancy.quiet_flight import quiet
from quadpi_core.discrepancy.recorded_simulation import Recorded, RecordedSimulation
from quadpi_core.discrepancy.reflight import rollout
from quadpi_core.discrepancy.simulations import VehicleSimulation, airspeed
from quadpi_core.discrepancy.study import read_flights
from quadpi_core.discrepancy.uncertain_parts import EVEN, LINEAR, SQUARED
from quadpi_core.errors import DiscrepancyError, QuadpiError
from quadpi_core.estimator.fusion import fuse, fuse_airborne
from quadpi_core.flight import AXES, WrenchStream
from quadpi_core.logs import read_recording
from quadpi_core.logs.bags import read_bag, write_bag
from quadpi_core.logs.importing import import_logs
from quadpi_core.signals.filters import zero_phase
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.simulation.effect_registry import EFFECTS, read_effects
from quadpi_core.vehicle import Vehicle

# --- The wrench


@pytest.fixture(scope="module")
def recorded_bags(bags, tmp_path_factory):
    """Bags with a simulated wrench of thrust alone, at half the rate of the IMU."""
    folder = tmp_path_factory.mktemp("recorded")
    for bag in bags:
        recording = read_bag(bag, Vehicle.load("neurobem"))
        rotors = recording.rotor_speeds
        wrench = np.zeros((len(rotors), 6))
        wrench[:, 2] = -1.56e-6 * np.square(rotors.speeds).sum(axis=1)
        simulated = WrenchStream(rotors.time_ns[::2], wrench[::2])
        write_bag(folder / bag.name, replace(recording, simulated=simulated))
    return sorted(folder.glob("*.mcap"))


def test_a_recorded_wrench_is_aligned_by_its_stamps(recorded_bags):
    simulation = load_simulation("recorded", "neurobem", recorded_bags)
    assert isinstance(simulation, RecordedSimulation)
    vehicle = Vehicle.load("neurobem")
    flight = fuse_airborne(read_recording(recorded_bags[1], vehicle), vehicle, 30.0)
    expected = -1.56e-6 * np.square(flight.rotor_speeds).sum(axis=1)
    found = simulation.wrench(flight)
    assert np.std(found[:, 2] - expected) < 0.05 * np.std(expected)
    assert simulation.thrust_n_s2 == pytest.approx(1.56e-6, rel=1e-3)
    part = flight.slice(slice(100, 200))
    assert np.array_equal(simulation.wrench(part), found[100:200])


def test_a_recorded_wrench_on_another_clock(recorded_bags, tmp_path):
    vehicle = Vehicle.load("neurobem")
    recording = read_bag(recorded_bags[0], vehicle)
    stream = recording.simulated
    late = replace(recording, simulated=replace(stream, time_ns=stream.time_ns + 3 * 10**9))
    write_bag(tmp_path / "late.mcap", late)
    simulation = load_simulation("recorded", "neurobem", [tmp_path / "late.mcap"])
    flight = fuse(read_recording(tmp_path / "late.mcap", vehicle), vehicle, 30.0)
    with pytest.raises(
        DiscrepancyError,
        match=r"its stamps, 2\.\d+ to \d+\.\d+ s after the start of the flight, do not cover it",
    ):
        simulation.wrench(flight)


def table_of(recording, folder):
    """The recording as a table with a row for each IMU sample, body axes and world as here."""
    imu, rotors, pose, simulated = recording.imu, recording.rotor_speeds, recording.pose, recording.simulated
    nearest = np.clip(np.searchsorted(pose.time_ns, imu.time_ns), 0, len(pose) - 1)
    rows = np.column_stack(
        (
            1e-9 * (imu.time_ns - imu.time_ns[0]),
            imu.angular_velocity,
            imu.specific_force,
            *(np.interp(imu.time_ns, rotors.time_ns, column) for column in rotors.speeds.T),
            pose.position[nearest],
            pose.attitude[nearest],
            *(np.interp(imu.time_ns, simulated.time_ns, column) for column in simulated.wrench.T),
        )
    )
    columns = [
        *("t", *"pqr", "ax", "ay", "az", "w0", "w1", "w2", "w3"),
        *("x", "y", "z", "qw", "qx", "qy", "qz", "fx", "fy", "fz", "mx", "my", "mz"),
    ]
    table = folder / f"{recording.name}.csv"
    np.savetxt(table, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
    return table


TABLE_MAPPING = """
time: {columns: [t], unit: s}
body: frd
world: ned
angular_velocity: {columns: [p, q, r], unit: rad/s}
acceleration: {columns: [ax, ay, az], unit: m/s2, axes: body, gravity: included}
rotor_speeds: {columns: [w0, w1, w2, w3], unit: rad/s}
mocap_position: {columns: [x, y, z], unit: m}
mocap_attitude: {columns: [qw, qx, qy, qz], form: wxyz}
simulated_force: {columns: [fx, fy, fz], unit: N}
simulated_moment: {columns: [mx, my, mz], unit: Nm}
"""


def test_logs_are_searched_by_their_mapping_as_the_bags_that_import_makes_of_them(recorded_bags, tmp_path):
    vehicle, mapping = Vehicle.load("neurobem"), tmp_path / "columns.yaml"
    mapping.write_text(TABLE_MAPPING)
    logs = [table_of(read_bag(bag, vehicle), tmp_path) for bag in recorded_bags]
    import_logs(logs, vehicle, tmp_path / "bags", str(mapping))
    made = sorted((tmp_path / "bags").glob("*.mcap"))
    of_logs = load_simulation("recorded", "neurobem", logs, mapping=str(mapping))
    of_bags = load_simulation("recorded", "neurobem", made)
    assert of_logs.thrust_n_s2 == pytest.approx(of_bags.thrust_n_s2, rel=1e-9)
    flights = read_flights(logs, of_logs, mapping=str(mapping))
    for own, other in zip(flights, read_flights(made, of_bags), strict=True):
        np.testing.assert_allclose(of_logs.wrench(own), of_bags.wrench(other), rtol=0.0, atol=1e-6)
        np.testing.assert_allclose(own.specific_force, other.specific_force, rtol=0.0, atol=1e-6)


def test_effects_that_a_recorded_wrench_cannot_show_are_listed(recorded_bags):
    """Thrust alone, which errors of rotor speeds show in, tells nothing of the wind."""
    simulation = load_simulation("recorded", "neurobem", recorded_bags)
    flights = read_flights(recorded_bags, simulation)
    found = discover(simulation, flights, names=["wind", "rotor_speed_scale", "body_drag"])
    assert found.without_trace == ("wind",)


def test_a_table_without_a_mapping_asks_for_one(recorded_bags, tmp_path):
    table = table_of(read_bag(recorded_bags[0], Vehicle.load("neurobem")), tmp_path)
    with pytest.raises(QuadpiError, match=rf"{table.name}.*--mapping"):
        load_simulation("recorded", "neurobem", [table])


def test_bags_without_a_recorded_wrench(bags):
    with pytest.raises(DiscrepancyError, match="topic simulation/wrench: missing: no simulated wrench"):
        load_simulation("recorded", "neurobem", bags)


def test_columns_of_a_table_become_a_simulated_wrench(tmp_path):
    """Forward-left-up in the table, forward-right-down here; millinewtons made newtons."""
    rows = ["t,wx,wy,wz,ax,ay,az,fx,fy,fz,mx,my,mz"]
    rows += [f"{0.01 * k:.2f},0,0,0,0,0,9.81,{k},1,2000,0.1,0.2,0.3" for k in range(20)]
    (tmp_path / "flight.csv").write_text("\n".join(rows) + "\n")
    (tmp_path / "mine.yaml").write_text(
        "time: {columns: [t], unit: s}\nbody: flu\nworld: enu\n"
        "angular_velocity: {columns: [wx, wy, wz], unit: rad/s}\n"
        "acceleration: {columns: [ax, ay, az], unit: m/s2, axes: body, gravity: included}\n"
        "simulated_force: {columns: [fx, fy, fz], unit: mN}\n"
        "simulated_moment: {columns: [mx, my, mz], unit: Nm}\n"
    )
    recording = read_recording(tmp_path / "flight.csv", Vehicle.load("neurobem"), str(tmp_path / "mine.yaml"))
    write_bag(tmp_path / "flight.mcap", recording)
    again = read_bag(tmp_path / "flight.mcap").simulated
    assert len(again.wrench) == 20
    np.testing.assert_allclose(again.wrench[7], [0.007, -0.001, -2.0, 0.1, -0.2, -0.3])
    assert np.array_equal(again.time_ns, recording.imu.time_ns)


# --- What flights tell of it


BEBOP = Vehicle.load("bebop2")
THRUST = 1.9e-6
NOISE = np.array([0.05, 0.05, 0.1, 1e-3, 1e-3, 1e-3])


def truth(flight):
    """Wrench (N, 6) of thrust, drag of rotors, lift and damping, of the flight's states alone."""
    squares, velocity = np.square(flight.rotor_speeds), airspeed(flight)
    x, y, _ = BEBOP.rotor_positions.T
    wrench = np.zeros((len(flight), 6))
    wrench[:, :2] = -1e-4 * flight.rotor_speeds.mean(axis=1)[:, None] * velocity[:, :2]
    wrench[:, 2] = -THRUST * squares.sum(axis=1) - 0.02 * np.square(velocity[:, :2]).sum(axis=1)
    wrench[:, 3], wrench[:, 4] = -THRUST * squares @ y, THRUST * squares @ x
    wrench[:, 3:5] -= 3e-3 * flight.rates[:, :2]
    wrench[:, 4] += 2e-3 * velocity[:, 0]
    return wrench


def stamps_of(flight):
    return flight.start_ns + np.round(1e9 * flight.time).astype(np.int64)


def recorded(flights, wrenches, base=BEBOP):
    """A simulation that recorded these wrenches beside the flights."""
    found = {
        flight.source: Recorded(stamps_of(flight), wrench)
        for flight, wrench in zip(flights, wrenches, strict=True)
    }
    return RecordedSimulation(base, found, THRUST, 0.0)


def noise_of(flights, seed=0):
    rng = np.random.default_rng(seed)
    return [NOISE * rng.standard_normal((len(flight), 6)) for flight in flights]


@pytest.fixture(scope="module")
def noise(flights):
    return noise_of(flights)


@pytest.fixture(scope="module")
def learned(flights, noise):
    wrenches = [truth(quiet(flight)) + more for flight, more in zip(flights, noise, strict=True)]
    return recorded(flights, wrenches).learned([(flight, quiet(flight)) for flight in flights])


def missed(found, expected):
    """Largest share of an axis that is not as expected."""
    left = np.std(found - expected, axis=0) / np.maximum(np.std(expected, axis=0), 1e-9)
    return left[np.std(expected, axis=0) > 0.0].max()


def test_what_is_explained_is_the_wrench_without_its_noise(learned, flights, noise):
    for flight, own in zip(flights, noise, strict=True):
        found, expected = learned.explained(quiet(flight)), truth(quiet(flight))
        assert missed(found, expected) < 0.15
        left = found - expected
        assert np.abs(np.sum(left * own) / np.sum(own**2)) < 0.01


def test_noise_of_a_flight_is_in_no_column_of_its_own(flights, noise):
    """The same motion with other noise in one flight leaves what is explained of it as it was."""
    clean = [truth(quiet(flight)) for flight in flights]
    pairs = [(flight, quiet(flight)) for flight in flights]
    other = [noise_of(flights, 9)[0], *noise[1:]]
    found = []
    for drawn in (noise, other):
        simulation = recorded(flights, [one + more for one, more in zip(clean, drawn, strict=True)])
        found.append(simulation.learned(pairs).explained(pairs[0][1]))
    changed, drew = found[1] - found[0], other[0] - noise[0]
    # Which functions are chosen may change with the noise of any flight.
    assert np.abs(np.sum(changed * drew, axis=0) / np.sum(drew**2, axis=0)).max() < 0.01


def test_what_is_explained_follows_wind_and_rotor_speeds(learned, flights):
    """As the simulation itself would, though it recorded one wrench alone."""
    flight = quiet(flights[1])
    for other in (
        replace(flight, wind=flight.wind + np.array([2.0, -1.0, 0.0])),
        replace(flight, rotor_speeds=1.05 * flight.rotor_speeds),
    ):
        changed = learned.explained(other) - learned.explained(flight)
        expected = truth(other) - truth(flight)
        assert missed(changed[:, :3], expected[:, :3]) < 0.15
        assert np.array_equal(learned.wrench(other), learned.wrench(flight))


def test_parts_of_what_is_explained_add_up_to_it(learned, flights):
    flight, tolerances = quiet(flights[0]), learned.tolerances
    columns = {column.name: column.wrench for column in learned.uncertain(flight)}
    total = np.zeros((len(flight), 6))
    for name, column in columns.items():
        axis, _, part = name.partition(" of ")
        if axis not in AXES:
            continue
        share = tolerances.coefficient * np.sqrt(0.5)
        if part == "rotors":
            known = {"Fz": tolerances.thrust, "Mx": tolerances.inertia, "My": tolerances.inertia}
            share = known.get(axis, tolerances.coefficient)
        total += column / share
    np.testing.assert_allclose(total, learned.explained(flight), atol=1e-9)
    shared = {name for name in columns if " and " in name}
    laws = (LINEAR, EVEN, SQUARED)
    assert shared == {f"{axes} of {law}" for axes in ("Fz, Mx and My", "Fx, Fy and Mz") for law in laws}


def test_a_hover_among_flights_has_their_columns(flights, noise):
    """With an airspeed of exactly zero, and in an axis without any wrench at all."""
    none = np.zeros_like(flights[0].velocity)
    hover = replace(flights[0], source="hover", velocity=none, wind=none)
    flown = [hover, *flights[1:]]
    wrenches = [truth(quiet(own)) + more for own, more in zip(flown, noise, strict=True)]
    for wrench in wrenches:
        wrench[:, 5] = 0.0
    compared = Compared.together(flown, recorded(flown, wrenches))
    columns = [[(column.name, column.law) for column in own.uncertain()] for own in compared]
    assert all(one == other for one, other in pairwise(columns))
    by_name = [{column.name: column.wrench for column in own.uncertain()} for own in compared]
    assert not by_name[0]["Fx of airspeed"].any()
    assert all(own["Fx of airspeed"].any() for own in by_name[1:])
    assert not any(own[f"Mz of {part}"].any() for own in by_name for part in ("rates", "airspeed"))


def test_few_flights_are_told_of_by_all_of_them(flights, noise):
    few = flights[:2]
    wrenches = [truth(quiet(flight)) + own for flight, own in zip(few, noise, strict=False)]
    found = recorded(few, wrenches).learned([(flight, quiet(flight)) for flight in few])
    first, second = found.weights.values()
    assert np.array_equal(first, second)
    assert missed(found.explained(quiet(few[0])), truth(quiet(few[0]))) < 0.15


def test_a_flight_that_none_learned_of_tells_of_itself(flights, noise):
    """In a wind that an addition gives it, too: the recorded wrench is of the wind as it was known."""
    wrench = truth(quiet(flights[0])) + noise[0]
    alone = recorded(flights[:1], [wrench])
    assert missed(alone.explained(flights[0]), truth(flights[0])) < 0.15
    windy = read_effects({"wind": {"north_m_s": 2.0, "east_m_s": 0.0, "down_m_s": 0.0}}, "test")
    moved = replace(flights[0], wind=flights[0].wind + np.array([2.0, 0.0, 0.0]))
    added = AugmentedSimulation(alone, windy).wrench(flights[0]) - wrench
    assert missed(added[:, :2], (truth(moved) - truth(flights[0]))[:, :2]) < 0.15


BLOWING = {"north_m_s": 2.0, "east_m_s": -1.0, "down_m_s": 0.0}


def blown(flight):
    return replace(flight, wind=flight.wind + list(BLOWING.values()))


@pytest.fixture(scope="module")
def in_wind(flights, noise, pushed):
    """Flights in a wind that nobody knew of, and a simulation that recorded the wrench of calm air."""
    rng, flown = np.random.default_rng(1), []
    for flight in flights:
        felt = truth(blown(flight)) + 0.3 * NOISE * rng.standard_normal((len(flight), 6))
        flown.append(pushed(flight, BEBOP, felt - measured_wrench(flight, BEBOP)))
    wrenches = [truth(quiet(flight)) + own for flight, own in zip(flown, noise, strict=True)]
    return flown, recorded(flown, wrenches)


def test_an_addition_with_wind_closes_the_residual(in_wind):
    flown, simulation = in_wind
    for own, flight in zip(Compared.together(flown, simulation), flown, strict=True):
        expected = truth(blown(flight)) - truth(flight)
        added = own.added(EFFECTS["wind"], np.array(list(BLOWING.values())))
        assert missed(added[:, :2], expected[:: own.step, :2]) < 0.15
        addition = AugmentedSimulation(own.simulation, read_effects({"wind": BLOWING}, "test"))
        changed = addition.wrench(flight) - own.simulation.wrench(flight)
        assert missed(changed[:, :2], expected[:, :2]) < 0.15
        explained = explained_wrench(flight, addition) - explained_wrench(flight, own.simulation)
        np.testing.assert_allclose(explained, changed, atol=1e-9)
        before, after = (
            np.mean(np.square(measured_wrench(flight, BEBOP) - explained_wrench(flight, each)), axis=0)
            for each in (own.simulation, addition)
        )
        assert np.all(after[:2] < 0.1 * before[:2])


def test_wind_is_found_beside_a_recorded_wrench(in_wind):
    flown, simulation = in_wind
    found = discover(simulation, flown, names=["wind", "rotor_drag", "force_bias", "body_drag"])
    assert [effect.name for effect in found.effects] == ["wind"]
    for parameter in found.effects[0].parameters[:2]:
        assert parameter.value == pytest.approx(BLOWING[parameter.name], abs=0.4)


def test_nothing_more_is_found_with_the_wind_added(in_wind):
    """The addition learns of the flights as its base does."""
    flown, simulation = in_wind
    addition = AugmentedSimulation(simulation, read_effects({"wind": BLOWING}, "test"))
    own = Compared.together(flown, addition)[0].simulation
    assert list(own.base.weights) == [flight.source for flight in flown]
    found = discover(addition, flown, names=["wind", "rotor_drag", "force_bias", "body_drag"])
    assert (found.verdict, found.effects) == ("none", ())


@pytest.mark.parametrize("known", [True, False], ids=["learned", "by itself"])
def test_an_addition_corrects_rotor_speeds_that_are_reported_too_high(known, flights, noise, pushed):
    """The recorded wrench is that of the speeds as reported."""
    flown = []
    for flight in flights:
        felt = truth(flight) - measured_wrench(flight, BEBOP)
        flown.append(replace(pushed(flight, BEBOP, felt), rotor_speeds=1.05 * flight.rotor_speeds))
    wrenches = [truth(quiet(flight)) + own for flight, own in zip(flown, noise, strict=True)]
    simulation = recorded(flown, wrenches)
    if known:
        simulation = Compared.together(flown, simulation)[0].simulation
    scale = read_effects({"rotor_speed_scale": {"change": 0.05}}, "test")
    changed = AugmentedSimulation(simulation, scale).wrench(flown[0]) - simulation.wrench(flown[0])
    expected = truth(flights[0]) - truth(flown[0])
    assert missed(changed[:, :3], expected[:, :3]) < 0.2


def test_roll_outs_have_the_wrench_of_sensors_without_the_error(flights):
    """Also where what was recorded is of rotor speeds as they were reported."""
    flown = [replace(flight, rotor_speeds=1.05 * flight.rotor_speeds) for flight in flights]
    simulation = recorded(flown, [truth(flight) for flight in flown]).learned([(own, own) for own in flown])
    added = AugmentedSimulation(simulation, read_effects({"rotor_speed_scale": {"change": 0.05}}, "test"))
    corrected = added.corrected(flown[0])
    answered = added.answering(flown[0], corrected).base.wrench(corrected) - simulation.wrench(flown[0])
    expected = truth(flights[0]) - truth(flown[0])
    assert missed(answered[:, :3], expected[:, :3]) < 0.2
    np.testing.assert_allclose(added.states(flown[0])["wrench"], answered + simulation.wrench(flown[0]))
    before, after = (rollout(flown[0], own).mean(axis=0) for own in (simulation, added))
    assert np.all(after < before)


def test_an_addition_of_other_coefficients_is_refused(learned, flights):
    added = AugmentedSimulation(learned, {}, {"Fx of the rest": 1.0})
    with pytest.raises(DiscrepancyError, match="no coefficient is named `Fx of the rest`"):
        added.wrench(flights[0])


def test_noise_of_a_recorded_simulation_does_not_shrink_it(flown, moved_tolerances):
    """A wrench of noisy velocities, as a log has them, moves the tolerance of drag by less than two."""
    base, flights, wrenches = VehicleSimulation.load("bebop2"), flown(), {}
    renamed = [replace(flight, source=f"flight {index}") for index, flight in enumerate(flights)]
    for index, flight in enumerate(renamed):
        rng = np.random.default_rng(index)
        rough = replace(flight, velocity=flight.velocity + 0.1 * rng.standard_normal(flight.velocity.shape))
        wrench = zero_phase(base.wrench(rough), 30.0, flight.rate_hz, slice(0)).value
        wrenches[flight.source] = Recorded(stamps_of(flight), wrench)
    hover = base.vehicle.mass_kg * base.vehicle.gravity_m_s2 / (4.0 * base.hover_rotor_speed**2)
    torque = hover * float(np.abs(base.thrusts(flights[0])[1]).mean() / base.thrusts(flights[0])[0].mean())
    moved = moved_tolerances(
        renamed, RecordedSimulation(base.vehicle, wrenches, hover, torque, base.tolerances)
    )
    drag = {name: value for name, value in moved.items() if name in ("Fx of airspeed", "Fy of airspeed")}
    assert len(drag) == 2
    assert max(map(abs, drag.values())) < 2.0, moved
