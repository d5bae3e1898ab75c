# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Simulations by a function, by an identified model, and by the wrench in logs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.discrepancy.augmented_simulation import AugmentedSimulation
from quadpi_core.discrepancy.effect_response import Compared, explained_wrench, quiet
from quadpi_core.discrepancy.loading import load_simulation
from quadpi_core.discrepancy.other_simulations import (
    EVEN,
    LINEAR,
    OF_ROTORS,
    SQUARED,
    CallableSimulation,
    Part,
    RecordedSimulation,
    learned_weights,
    of_coefficient,
    part_columns,
)
from quadpi_core.discrepancy.reflight import rollout
from quadpi_core.discrepancy.simulations import Tolerances, VehicleSimulation, airspeed
from quadpi_core.discrepancy.study import discover, read_flights
from quadpi_core.discrepancy.unmeasured_states import INDEPENDENT_HZ
from quadpi_core.errors import DiscrepancyError, QuadpiError
from quadpi_core.estimator.fusion import fuse, fuse_airborne
from quadpi_core.flight import AXES, WrenchStream
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.logs import read_recording
from quadpi_core.logs.bags import read_bag, write_bag
from quadpi_core.logs.importing import import_logs
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.parallel import Workers
from quadpi_core.signals.chain import zero_phase
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.simulation.applied_effects import EFFECTS, read_effects
from quadpi_core.vehicle import Vehicle

BEBOP = Vehicle.load("bebop2")
# Every sample is independent.
RATE_HZ = INDEPENDENT_HZ.value
THRUST, TORQUE, DAMPING, DRAG, LIFT, AIRFRAME = 1.9e-6, 2e-8, 3e-3, 1e-4, 5e-2, 2e-2
PARTS = ("rotors", "rates", "airspeed", "airspeed, even", "airspeed, squared")


def known_parts(flight):
    """Wrench (N, 6) of one law of each order and parity, by the name of the part that it is."""
    velocity, squares = airspeed(flight), np.square(flight.rotor_speeds)
    parts = {name: np.zeros((len(flight), 6)) for name in PARTS}
    parts["rotors"][:, 2] = -THRUST * squares.sum(axis=1)
    parts["rotors"][:, 5] = TORQUE * squares @ [1.0, -1.0, 1.0, -1.0]
    parts["rates"][:, 3:5] = -DAMPING * flight.rates[:, :2]
    parts["airspeed"][:, :2] = -DRAG * flight.rotor_speeds.mean(axis=1)[:, None] * velocity[:, :2]
    parts["airspeed, even"][:, 2] = -LIFT * np.square(velocity[:, :2]).sum(axis=1)
    parts["airspeed, even"][:, 5] = 1e-3 * flight.rates[:, 2] * velocity[:, 0]
    parts["airspeed, squared"][:, :3] = -AIRFRAME * np.linalg.norm(velocity, axis=1)[:, None] * velocity
    return parts


def share_of(simulation, axis, part):
    """Standard deviation of the axis of a part, in shares of it; the law of its axes has the same."""
    tolerances = simulation.tolerances
    if part != "rotors":
        return tolerances.coefficient * np.sqrt(0.5)
    known = {"Fz": tolerances.thrust, "Mx": tolerances.inertia, "My": tolerances.inertia}
    return known.get(axis, tolerances.coefficient)


def columns_of(simulation, flight):
    return {column.name: column.wrench for column in simulation.uncertain(flight)}


def sum_of_parts(simulation, flight):
    """Wrench (N, 6) of all parts that may be wrong."""
    columns = columns_of(simulation, flight).items()
    names = [(name.partition(" of "), column) for name, column in columns]
    return sum(c / share_of(simulation, axis, part) for (axis, _, part), c in names if axis in AXES)


# --- A function


def test_a_function_of_the_working_directory(tmp_path, monkeypatch, flight):
    (tmp_path / "my_simulation.py").write_text(
        "import numpy as np\n"
        "def wrench(flight):\n"
        "    found = np.zeros((len(flight), 6))\n"
        "    found[:, 2] = -1.9e-6 * np.square(flight.rotor_speeds).sum(axis=1)\n"
        "    return found\n"
    )
    monkeypatch.chdir(tmp_path)
    simulation = load_simulation("my_simulation:wrench", "bebop2")
    wrench, thrusts, torques = simulation.loads(flight)
    np.testing.assert_allclose(wrench[:, 2], -THRUST * np.square(flight.rotor_speeds).sum(axis=1))
    np.testing.assert_allclose(thrusts, THRUST * np.square(flight.rotor_speeds))
    assert np.all(torques == 0.0)
    weight = simulation.vehicle.mass_kg * simulation.vehicle.gravity_m_s2
    assert simulation.hover_rotor_speed == pytest.approx(np.sqrt(weight / (4 * THRUST)))


def raising(flight):
    raise ValueError(f"{len(flight)} samples are too many")


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (raising, r"raised ValueError for flight \w+: \d+ samples are too many"),
        (
            lambda flight: np.zeros((len(flight), 5)),
            r"expected a wrench of shape \(\d+, 6\), found \(\d+, 5\)",
        ),
        (lambda flight: np.full((len(flight), 6), np.nan), "sample 0: not finite"),
        (lambda _: "lift", "raised ValueError"),
    ],
)
def test_functions_that_give_no_wrench(function, message, flight):
    simulation = CallableSimulation("mine:f", BEBOP, function)
    with pytest.raises(DiscrepancyError, match=message) as caught:
        simulation.wrench(flight)
    assert "\n" not in str(caught.value)


@pytest.fixture(params=[0.0, 3.0], ids=["calm", "windy"])
def blown(request, flight):
    return replace(flight, wind=flight.wind + request.param * np.array([1.0, -0.5, 0.0]))


def test_laws_of_each_order_and_parity_are_parts_by_themselves(blown):
    known = CallableSimulation("known", BEBOP, lambda flight: sum(known_parts(flight).values()))
    parts, columns = known_parts(blown), columns_of(known, blown)
    for name, wrench in parts.items():
        for axis, values in zip(AXES, wrench.T, strict=True):
            expected = np.outer(share_of(known, axis, name) * values, np.array(AXES) == axis)
            if (name, axis) not in {("rotors", "Mx"), ("rotors", "My")}:
                found = columns.pop(f"{axis} of {name}")
                np.testing.assert_allclose(found, expected, atol=1e-12, err_msg=f"{axis} of {name}")
    for axes, kept in (("Fz, Mx and My", [2, 3, 4]), ("Fx, Fy and Mz", [0, 1, 5])):
        for law, whole in {
            "the motion": parts["rates"] + parts["airspeed"],
            "airspeed, even": parts["airspeed, even"],
            "airspeed, squared": parts["airspeed, squared"],
        }.items():
            found = columns.pop(f"{axes} of {law}")
            np.testing.assert_allclose(found[:, kept], 0.1 * np.sqrt(0.5) * whole[:, kept], atol=1e-12)
            assert not np.delete(found, kept, axis=1).any()
    assert set(columns) == {"Mx of rotors", "My of rotors"}
    hover = replace(blown, velocity=0.0 * blown.velocity, wind=0.0 * blown.wind, rates=0.0 * blown.rates)
    names = [[(column.name, column.law) for column in known.uncertain(own)] for own in (blown, hover)]
    assert names[0] == names[1]


def test_parts_add_up_to_the_wrench_whatever_its_order(blown):
    """A cubic law is shared between the orders that are told apart."""

    def cubic(flight):
        return np.hstack((airspeed(flight) ** 3, flight.rates**3 * airspeed(flight)))

    simulation = CallableSimulation("cubic", BEBOP, cubic)
    np.testing.assert_allclose(sum_of_parts(simulation, blown), cubic(blown), atol=1e-9)


# --- An identified model


@pytest.fixture(scope="module")
def model(bags, tmp_path_factory):
    """A model of all axes as a simulation, and a flight that it was identified on."""
    vehicle, folder = Vehicle.load("neurobem"), tmp_path_factory.mktemp("models") / "model"
    flights = prepare_flights(bags, vehicle, 30.0, workers=Workers(1))
    options = IdentifyOptions(method="polynomial", cutoff_hz=30.0)
    identify(flights, vehicle, load_pools("quadrotor"), options).save(folder)
    return load_simulation(str(folder)), fuse_airborne(read_recording(bags[0], vehicle), vehicle, 30.0)


def test_a_model_predicts_and_keeps_its_intervals(model):
    simulation, flight = model
    lower, upper, _ = simulation.margins(flight)
    assert np.all((lower < 0.0) & (upper > 0.0))
    measured = measured_wrench(flight, simulation.vehicle)
    assert np.std(measured - simulation.wrench(flight), axis=0)[2] < 0.3 * np.std(measured, axis=0)[2]
    assert 500.0 < simulation.hover_rotor_speed < 2000.0
    # A model that was fitted to flights says nothing of their motion reversed.
    columns = columns_of(simulation, flight)
    assert {name.partition(" of ")[2] for name in columns} == {"rotors", "rates", "airspeed", "the motion"}
    np.testing.assert_allclose(sum_of_parts(simulation, flight), simulation.wrench(flight), atol=1e-9)


def test_a_model_of_another_vehicle(model):
    with pytest.raises(QuadpiError, match="is of vehicle neurobem, not bebop2"):
        load_simulation(model[0].name, "bebop2")


def test_samples_that_a_model_cannot_judge_are_left_out_and_counted(model):
    simulation, flight = model

    def gappy(share):
        velocity, count = flight.velocity.copy(), int(share * len(flight))
        velocity[:count] = np.nan
        return replace(flight, velocity=velocity), count

    few, count = gappy(0.01)
    assert simulation.unjudged(few) == count > 0
    left = simulation.wrench(few)
    assert np.all(np.isfinite(left))
    np.testing.assert_array_equal(left[count:], simulation.wrench(flight)[count:])
    with pytest.raises(DiscrepancyError, match=r"no finite wrench for 6% of it, first for sample 0"):
        simulation.wrench(gappy(0.06)[0])


# --- Which functions a wrench with noise of its own is a sum of


def drawn(rng, flights, samples, functions):
    """Functions of the order of 1 of each flight."""
    return [rng.standard_normal((samples, functions)) for _ in range(flights)]


def test_a_sum_of_a_few_functions_is_recovered_and_hardly_any_other_is_taken():
    """Schwarz's criterion takes a function of noise alone in one of 400 cases, with so many samples."""
    rng = np.random.default_rng(0)
    functions, true = drawn(rng, 5, 2000, 30), np.zeros((30, 6))
    for axis, chosen in enumerate(([1, 7], [0], [3, 4, 29], [], [12], [9, 20])):
        true[chosen, axis] = rng.uniform(0.5, 2.0, len(chosen)) * rng.choice([-1.0, 1.0], len(chosen))
    wrenches = [own @ true + 0.5 * rng.standard_normal((2000, 6)) for own in functions]
    for weights in learned_weights(wrenches, functions, RATE_HZ):
        assert np.all(weights[true != 0.0] != 0.0)
        assert np.sum(weights[true == 0.0] != 0.0) <= 2
        np.testing.assert_allclose(weights, true, atol=0.03)


@pytest.mark.parametrize(("flights", "held"), [(5, 0.0), (3, 20 / 120)], ids=["left out", "few, all"])
def test_noise_of_a_flight_in_what_is_explained_of_it(flights, held):
    """Weights from all flights hold a share of 20 functions over samples, those from all others nothing."""
    shares = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        known, true = drawn(rng, flights, 40, 20), rng.choice([-1.0, 1.0], (20, 6))
        noise = [0.3 * rng.standard_normal((40, 6)) for _ in known]
        wrenches = [own @ true + more for own, more in zip(known, noise, strict=True)]
        weights = learned_weights(wrenches, known, RATE_HZ)
        of_noise = [np.sum(own @ (w - true) * n) for own, w, n in zip(known, weights, noise, strict=True)]
        shares.append(sum(of_noise) / np.sum(np.square(noise)))
    assert np.mean(shares) == pytest.approx(held, abs=0.02)


def test_a_function_that_one_flight_lacks_is_known_from_the_others():
    """And one that no other flight has is not known of that flight; without noise nothing is left over."""
    rng = np.random.default_rng(5)
    functions = drawn(rng, 4, 200, 4)
    functions[0][:, 1] = 0.0
    for own in functions[1:]:
        own[:, 2] = 0.0
    wrenches = [own[:, 1:3].sum(axis=1)[:, None] * [1.0, 1.0, 1.0, 1.0, 1.0, 0.0] for own in functions]
    with np.errstate(all="raise"):
        weights = np.array(learned_weights(wrenches, functions, RATE_HZ))
    assert not weights[:, :, 5].any()
    np.testing.assert_allclose(weights[:, 1, :5], 1.0, rtol=1e-3)
    assert not weights[0, 2].any()
    np.testing.assert_allclose(weights[1:, 2, :5], 1.0, rtol=1e-3)


# --- A wrench in logs


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
    with pytest.raises(QuadpiError, match=rf"{logs[0].name}.*--mapping"):
        load_simulation("recorded", "neurobem", logs[:1])


def test_effects_that_a_recorded_wrench_cannot_show_are_listed(recorded_bags):
    """Thrust alone, which errors of rotor speeds show in, tells nothing of the wind."""
    simulation = load_simulation("recorded", "neurobem", recorded_bags)
    flights = read_flights(recorded_bags, simulation)
    found = discover(simulation, flights, names=["wind", "rotor_speed_scale", "body_drag"])
    assert found.without_trace == ("wind",)


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


NOISE = np.array([0.05, 0.05, 0.1, 1e-3, 1e-3, 1e-3])
BLOWING = {"north_m_s": 2.0, "east_m_s": -1.0, "down_m_s": 0.0}
WINDY = read_effects({"wind": BLOWING}, "test")
FASTER = read_effects({"rotor_speed_scale": {"change": 0.05}}, "test")


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


def recorded(flights, wrenches):
    """A simulation that recorded these wrenches beside the flights."""
    pairs = zip(flights, wrenches, strict=True)
    found = {flight.source: WrenchStream(flight.stamps_ns, wrench) for flight, wrench in pairs}
    return RecordedSimulation(BEBOP, found, THRUST, 0.0)


def noise_of(flights, seed=0):
    rng = np.random.default_rng(seed)
    return [NOISE * rng.standard_normal((len(flight), 6)) for flight in flights]


def noisy(flights, noise):
    return recorded(flights, [truth(quiet(own)) + more for own, more in zip(flights, noise, strict=True)])


def learned_of(simulation, flights):
    return simulation.learned([(flight, quiet(flight)) for flight in flights])


@pytest.fixture(scope="module")
def noise(flights):
    return noise_of(flights)


@pytest.fixture(scope="module")
def learned(flights, noise):
    return learned_of(noisy(flights, noise), flights)


def missed(found, expected):
    """Largest share of an axis that is not as expected."""
    left = np.std(found - expected, axis=0) / np.maximum(np.std(expected, axis=0), 1e-9)
    return left[np.std(expected, axis=0) > 0.0].max()


def blown_away(flight):
    return replace(flight, wind=flight.wind + list(BLOWING.values()))


@pytest.mark.parametrize("count", [2, 4])
def test_what_is_explained_is_the_wrench_without_its_noise(count, flights, noise):
    """And its parts add up to it."""
    flights, noise = flights[:count], noise[:count]
    found = learned_of(noisy(flights, noise), flights)
    for flight, own in zip(map(quiet, flights), noise, strict=True):
        left = found.explained(flight) - truth(flight)
        assert missed(found.explained(flight), truth(flight)) < 0.15
        assert np.abs(np.sum(left * own) / np.sum(own**2)) < 0.01
        np.testing.assert_allclose(sum_of_parts(found, flight), found.explained(flight), atol=1e-9)
        pushed = replace(flight, specific_force=flight.specific_force + 1.0)
        np.testing.assert_array_equal(found.explained(pushed), found.explained(flight))


def test_laws_of_what_is_explained_are_told_apart(learned, flights):
    flight = quiet(flights[0])
    velocity, columns = airspeed(flight), columns_of(learned, flight)
    drag = -1e-4 * flight.rotor_speeds.mean(axis=1) * velocity[:, 0]
    lift = -0.02 * np.square(velocity[:, :2]).sum(axis=1)
    for name, axis, law in (("Fx of airspeed", 0, drag), ("Fz of airspeed, even", 2, lift)):
        found = columns[name][:, axis] / (0.1 * np.sqrt(0.5))
        assert missed(found[:, None], law[:, None]) < 0.4


def test_what_is_explained_follows_wind_and_rotor_speeds(learned, flights):
    """As the simulation itself would, though it recorded one wrench alone."""
    flight = quiet(flights[1])
    for other in (blown_away(flight), replace(flight, rotor_speeds=1.05 * flight.rotor_speeds)):
        changed = learned.explained(other) - learned.explained(flight)
        assert missed(changed[:, :3], (truth(other) - truth(flight))[:, :3]) < 0.15
        assert np.array_equal(learned.wrench(other), learned.wrench(flight))


def test_a_hover_among_flights_has_their_columns(flights, noise):
    """With an airspeed of exactly zero, and in an axis without any wrench at all."""
    none = np.zeros_like(flights[0].velocity)
    flown = [replace(flights[0], source="hover", velocity=none, wind=none), *flights[1:]]
    wrenches = [truth(quiet(own)) + more for own, more in zip(flown, noise, strict=True)]
    for wrench in wrenches:
        wrench[:, 5] = 0.0
    columns = [own.uncertain() for own in Compared.together(flown, recorded(flown, wrenches))]
    names = [[(column.name, column.law) for column in own] for own in columns]
    assert all(own == names[0] for own in names)
    by_name = [{column.name: column.wrench for column in own} for own in columns]
    assert [bool(own["Fx of airspeed"].any()) for own in by_name] == [False] + [True] * (len(flown) - 1)
    assert not any(own[f"Mz of {part}"].any() for own in by_name for part in ("rates", "airspeed"))


def test_a_flight_that_none_learned_of_tells_of_itself(flights, noise):
    """In a wind that an addition gives it, too: the recorded wrench is of the wind as it was known."""
    alone, flight = noisy(flights[:1], noise[:1]), flights[0]
    assert missed(alone.explained(flight), truth(flight)) < 0.15
    added = AugmentedSimulation(alone, WINDY).wrench(flight) - alone.wrench(flight)
    assert missed(added[:, :2], (truth(blown_away(flight)) - truth(flight))[:, :2]) < 0.15


@pytest.fixture(scope="module")
def in_wind(flights, noise, pushed):
    """Flights in a wind that nobody knew of, and a simulation that recorded the wrench of calm air."""
    rng, flown = np.random.default_rng(1), []
    for flight in flights:
        felt = truth(blown_away(flight)) + 0.3 * NOISE * rng.standard_normal((len(flight), 6))
        flown.append(pushed(flight, BEBOP, felt - measured_wrench(flight, BEBOP)))
    return flown, noisy(flown, noise)


def test_an_addition_with_wind_closes_the_residual(in_wind):
    flown, simulation = in_wind
    for own, flight in zip(Compared.together(flown, simulation), flown, strict=True):
        expected = truth(blown_away(flight)) - truth(flight)
        added = own.added(EFFECTS["wind"], np.array(list(BLOWING.values())))
        assert missed(added[:, :2], expected[:: own.step, :2]) < 0.15
        addition = AugmentedSimulation(own.simulation, WINDY)
        changed = addition.wrench(flight) - own.simulation.wrench(flight)
        assert missed(changed[:, :2], expected[:, :2]) < 0.15
        explained = explained_wrench(flight, addition) - explained_wrench(flight, own.simulation)
        np.testing.assert_allclose(explained, changed, atol=1e-9)
        before, after = (
            np.mean(np.square(measured_wrench(flight, BEBOP) - explained_wrench(flight, each)), axis=0)
            for each in (own.simulation, addition)
        )
        assert np.all(after[:2] < 0.1 * before[:2])


def test_wind_is_found_beside_a_recorded_wrench_and_nothing_more_once_it_is_added(in_wind):
    """The addition learns of the flights as its base does."""
    (flown, simulation), names = in_wind, ["wind", "rotor_drag", "force_bias", "body_drag"]
    found = discover(simulation, flown, names=names)
    assert [effect.name for effect in found.effects] == ["wind"]
    for parameter in found.effects[0].parameters[:2]:
        assert parameter.value == pytest.approx(BLOWING[parameter.name], abs=0.4)
    again = discover(AugmentedSimulation(simulation, WINDY), flown, names=names)
    assert (again.verdict, again.effects) == ("none", ())


@pytest.mark.parametrize("known", [True, False], ids=["learned", "by itself"])
def test_an_addition_corrects_rotor_speeds_that_are_reported_too_high(known, flights, noise, pushed):
    """The recorded wrench is that of the speeds as reported."""
    flown = []
    for flight in flights:
        felt = truth(flight) - measured_wrench(flight, BEBOP)
        flown.append(replace(pushed(flight, BEBOP, felt), rotor_speeds=1.05 * flight.rotor_speeds))
    simulation = noisy(flown, noise)
    if known:
        simulation = Compared.together(flown, simulation)[0].simulation
    changed = AugmentedSimulation(simulation, FASTER).wrench(flown[0]) - simulation.wrench(flown[0])
    assert missed(changed[:, :3], (truth(flights[0]) - truth(flown[0]))[:, :3]) < 0.2


def test_roll_outs_have_the_wrench_of_sensors_without_the_error(flights):
    """Also where what was recorded is of rotor speeds as they were reported."""
    flown = [replace(flight, rotor_speeds=1.05 * flight.rotor_speeds) for flight in flights]
    simulation = recorded(flown, [truth(flight) for flight in flown]).learned([(own, own) for own in flown])
    added = AugmentedSimulation(simulation, FASTER)
    changed = added.states(flown[0])["wrench"] - simulation.wrench(flown[0])
    assert missed(changed[:, :3], (truth(flights[0]) - truth(flown[0]))[:, :3]) < 0.2
    before, after = (rollout(flown[0], own).mean(axis=0) for own in (simulation, added))
    assert np.all(after < before)


def test_an_addition_of_other_coefficients_is_refused(learned, flights):
    added = AugmentedSimulation(learned, {}, {"Fx of the rest": 1.0})
    with pytest.raises(DiscrepancyError, match="no coefficient is named `Fx of the rest`"):
        added.wrench(flights[0])


def test_noise_of_a_recorded_simulation_does_not_shrink_it(flown, moved_tolerances):
    """A wrench of noisy velocities, as a log has them, moves the tolerance of drag by less than two."""
    base, wrenches = VehicleSimulation.load("bebop2"), []
    flights = [replace(flight, source=f"flight {index}") for index, flight in enumerate(flown())]
    for index, flight in enumerate(flights):
        rng = np.random.default_rng(index)
        rough = replace(flight, velocity=flight.velocity + 0.1 * rng.standard_normal(flight.velocity.shape))
        wrenches.append(zero_phase(base.wrench(rough), 30.0, flight.rate_hz, slice(0)).value)
    hover = base.vehicle.mass_kg * base.vehicle.gravity_m_s2 / (4.0 * base.hover_rotor_speed**2)
    _, thrusts, torques = base.loads(flights[0])
    torque = hover * float(np.abs(torques).mean() / thrusts.mean())
    simulation = replace(recorded(flights, wrenches), thrust_n_s2=hover, torque_nm_s2=torque)
    moved = moved_tolerances(flights, replace(simulation, tolerances=base.tolerances))
    drag = {name: value for name, value in moved.items() if name in ("Fx of airspeed", "Fy of airspeed")}
    assert len(drag) == 2
    assert max(map(abs, drag.values())) < 2.0, moved


# --- Tolerances of a simulation known by its wrench alone

TOLERANCES = Tolerances(thrust=0.01, coefficient=0.1, inertia=0.02)
SAMPLES = 7


def wrench_of(seed):
    return np.random.default_rng(seed).standard_normal((SAMPLES, 6))


@pytest.fixture
def parts():
    """Of each law one, but two of the first order in the motion."""
    return [
        Part(OF_ROTORS, wrench_of(0), OF_ROTORS),
        Part("rates", wrench_of(1), LINEAR),
        Part("airspeed", wrench_of(2), LINEAR),
        Part(EVEN, wrench_of(3), EVEN),
        Part(SQUARED, wrench_of(4), SQUARED),
    ]


def by_name(parts):
    columns = part_columns(parts, TOLERANCES)
    found = {column.name: column for column in columns}
    assert len(found) == len(columns)
    return found


def test_the_law_of_a_column_names_the_one_that_holds_its_axis(parts):
    columns = by_name(parts)
    for name, column in columns.items():
        if not column.law:
            assert name.endswith(" of rotors") or " and " in name
            continue
        axis = name.partition(" of ")[0]
        assert columns[column.law].law == ""
        assert columns[column.law].wrench[:, AXES.index(axis)].any()


def test_a_coefficient_is_wrong_by_what_its_columns_add_up_to(parts):
    """Multiples of its own column and of the shared one, in tolerances of the part."""
    part, own, shared = parts[4], 1.7, -0.4
    columns = by_name([part])
    for index, axis in enumerate(AXES):
        column = columns[f"{axis} of {part.name}"]
        added = own * column.wrench + shared * columns[column.law].wrench
        expected = of_coefficient(own, shared) * 0.1 * part.wrench[:, index]
        np.testing.assert_allclose(added[:, index], expected)
