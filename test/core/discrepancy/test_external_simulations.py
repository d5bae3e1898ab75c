# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Simulations by a function, an identified model, and a recorded wrench."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.discrepancy import (
    CallableSimulation,
    discover,
    load_simulation,
)
from quadpi_core.discrepancy.external_simulations import RecordedSimulation
from quadpi_core.discrepancy.study import read_flights
from quadpi_core.errors import DiscrepancyError, QuadpiError
from quadpi_core.estimator.fusion import fuse, fuse_airborne
from quadpi_core.flight import WrenchStream
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.logs import read_recording
from quadpi_core.logs.bags import read_bag, write_bag
from quadpi_core.logs.importing import import_logs
from quadpi_core.models.candidate_pool import load_pools
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.parallel import Workers
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.vehicle import Vehicle


def thrust_only(flight):
    wrench = np.zeros((len(flight), 6))
    wrench[:, 2] = -1.9e-6 * np.square(flight.rotor_speeds).sum(axis=1)
    return wrench


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
    assert np.array_equal(simulation.wrench(flight), thrust_only(flight))
    weight = simulation.vehicle.mass_kg * simulation.vehicle.gravity_m_s2
    assert simulation.hover_rotor_speed == pytest.approx(np.sqrt(weight / (4 * 1.9e-6)))
    thrusts, torques = simulation.thrusts(flight)
    np.testing.assert_allclose(thrusts, 1.9e-6 * np.square(flight.rotor_speeds))
    assert np.all(torques == 0.0)


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
    simulation = CallableSimulation("mine:f", Vehicle.load("bebop2"), function)
    with pytest.raises(DiscrepancyError, match=message) as caught:
        simulation.wrench(flight)
    assert "\n" not in str(caught.value)


# --- An identified model


@pytest.fixture(scope="module")
def model(bags, tmp_path_factory):
    vehicle = Vehicle.load("neurobem")
    pools = load_pools("quadrotor")
    flights = prepare_flights(bags, vehicle, 30.0, workers=Workers(1))
    folder = tmp_path_factory.mktemp("models") / "model"
    identify(flights, vehicle, pools, IdentifyOptions(method="polynomial", cutoff_hz=30.0)).save(folder)
    return folder


def test_a_model_predicts_and_keeps_its_intervals(model, bags):
    simulation = load_simulation(str(model))
    vehicle = Vehicle.load("neurobem")
    flight = fuse_airborne(read_recording(bags[0], vehicle), vehicle, 30.0)
    wrench, (lower, upper) = simulation.wrench(flight), simulation.intervals(flight)
    assert np.all((lower < wrench) & (wrench < upper))
    # Of a flight that it was identified on, it explains most.
    measured = measured_wrench(flight, vehicle)
    assert np.std(measured - wrench, axis=0)[2] < 0.3 * np.std(measured, axis=0)[2]
    assert 500.0 < simulation.hover_rotor_speed < 2000.0


def test_a_model_of_another_vehicle(model):
    with pytest.raises(QuadpiError, match="is of vehicle neurobem, not bebop2"):
        load_simulation(str(model), "bebop2")


# --- A recorded wrench


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
    simulation = load_simulation("recorded", "neurobem", recorded_bags)
    flights = read_flights(recorded_bags, simulation)
    found = discover(simulation, flights, names=["wind", "rotor_speed_scale", "body_drag"])
    assert found.without_trace == ("wind", "rotor_speed_scale")


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


def test_samples_that_a_model_cannot_judge_are_left_out_and_counted(model, bags):
    simulation, vehicle = load_simulation(str(model)), Vehicle.load("neurobem")
    flight = fuse_airborne(read_recording(bags[0], vehicle), vehicle, 30.0)
    whole = simulation.wrench(flight)

    def gappy(share):
        def predict(asked):
            wrench = whole.copy()
            wrench[: int(share * len(asked))] = np.nan
            return wrench

        return replace(simulation, function=predict)

    few = gappy(0.01)
    assert few.unjudged(flight) == int(0.01 * len(flight))
    left = few.wrench(flight)
    assert np.all(np.isfinite(left))
    np.testing.assert_array_equal(left[few.unjudged(flight) :], whole[few.unjudged(flight) :])
    with pytest.raises(DiscrepancyError, match=r"no finite wrench for 6% of it, first for sample 0"):
        gappy(0.06).wrench(flight)
