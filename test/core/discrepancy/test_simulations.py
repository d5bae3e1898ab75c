# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Every kind of simulation that flights can be compared with, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

from quadpi_core.config import read_config
from quadpi_core.discrepancy import (
    AugmentedSimulation,
    CallableSimulation,
    Tolerances,
    VehicleSimulation,
    load_simulation,
)
from quadpi_core.discrepancy.external_simulations import RecordedSimulation
from quadpi_core.errors import DiscrepancyError, QuadpiError, VehicleError
from quadpi_core.estimator.fusion import fuse, fuse_airborne
from quadpi_core.flight import WrenchStream
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.logs import read_recording
from quadpi_core.logs.bags import read_bag, write_bag
from quadpi_core.models.candidate_pool import load_pools
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.parallel import Workers
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.simulation.effect_registry import EFFECTS, read_effects
from quadpi_core.vehicle import Vehicle


@pytest.fixture(scope="module")
def flight(flown):
    return flown()[0]


@pytest.fixture
def vehicle_file(tmp_path):
    """vehicle_file(key=value, …) → a copy of bebop2.yaml with other keys of its `simulation`."""

    def write(**changes):
        _, data = read_config("vehicle", "bebop2", VehicleError)
        path = tmp_path / "bebop2.yaml"
        path.write_text(yaml.safe_dump({**data, "simulation": {**data["simulation"], **changes}}))
        return str(path)

    return write


def thrust_only(flight):
    wrench = np.zeros((len(flight), 6))
    wrench[:, 2] = -1.9e-6 * np.square(flight.rotor_speeds).sum(axis=1)
    return wrench


# --- Of a vehicle file


def test_a_vehicle_by_name_or_path(vehicle_file, flight):
    one, other = load_simulation("bebop2"), load_simulation(vehicle_file())
    assert isinstance(one, VehicleSimulation)
    assert np.array_equal(one.wrench(flight), other.wrench(flight))
    assert one.tolerances == Tolerances()


def test_tolerances_of_the_vehicle_file(vehicle_file):
    found = load_simulation(vehicle_file(tolerances={"thrust": 0.03, "cg_m": 0.002})).tolerances
    assert found == Tolerances(thrust=0.03, cg_m=0.002)


@pytest.mark.parametrize(
    ("tolerances", "message"),
    [
        ({"thrusts": 0.1}, "simulation.tolerances: unknown key `thrusts`"),
        ({"inertia": -0.1}, "`inertia` must be a number"),
    ],
)
def test_tolerances_that_are_none(vehicle_file, tolerances, message):
    with pytest.raises(VehicleError, match=message):
        load_simulation(vehicle_file(tolerances=tolerances))


def test_effects_of_the_vehicle_file_are_in_its_wrench(vehicle_file, flight):
    file = vehicle_file(effects={"rotor_drag": {"drag_n_s_m": 0.05}, "payload": None})
    simulation = load_simulation(file)
    assert isinstance(simulation, AugmentedSimulation)
    plain = load_simulation("bebop2")
    added = simulation.wrench(flight) - plain.wrench(flight)
    moving = np.abs(flight.velocity[:, 0]) > 1.0
    assert np.all(added[moving, 0] * flight.velocity[moving, 0] < 0.0)
    assert simulation.vehicle.mass_kg == pytest.approx(plain.vehicle.mass_kg + 0.05)
    # What coefficients of effects refer to does not change with the payload.
    assert simulation.record()["hover_rotor_speed"] == plain.record()["hover_rotor_speed"]
    assert simulation.record()["mass"] == simulation.vehicle.mass_kg


# Not flown or not as strong as switched on: no flight leads away from the anchor of a typical tether, the
# estimator finds a late motion capture itself, and while markers are hidden less of a turned IMU is a bias.
WEAKENED = {"tether", "sensor_delay", "imu_misalignment"}


@pytest.mark.slow
@pytest.mark.parametrize("name", [e.name for e in EFFECTS.values() if e.shown_by and e.name not in WEAKENED])
def test_an_effect_added_takes_its_residual_away(name, flown):
    """Flights with an effect and the simulation with it are as close as flights and simulation without."""
    plain = load_simulation("bebop2")
    augmented = AugmentedSimulation(plain, read_effects({name: None}, "test"))

    def left(simulation):
        residual = np.concatenate(
            [measured_wrench(f, simulation.vehicle) - simulation.wrench(f) for f in flown(name)]
        )
        return residual.std(axis=0) + np.abs(residual.mean(axis=0))

    floor = np.concatenate([measured_wrench(f, plain.vehicle) - plain.wrench(f) for f in flown()]).std(axis=0)
    after = left(augmented)
    assert np.all(after < 1.6 * floor + 2e-4), (after / floor, left(plain) / floor)


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
    assert np.array_equal(simulation.wrench(flight), thrust_only(flight))
    weight = simulation.vehicle.mass_kg * simulation.vehicle.gravity_m_s2
    assert simulation.hover_rotor_speed == pytest.approx(np.sqrt(weight / (4 * 1.9e-6)))
    thrusts, torques = simulation.thrusts(flight)
    np.testing.assert_allclose(thrusts, 1.9e-6 * np.square(flight.rotor_speeds))
    assert np.all(torques == 0.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("no_such_module:f", "no_such_module:f: cannot be imported: ModuleNotFoundError"),
        ("json:nothing", "json:nothing: cannot be imported: AttributeError"),
        ("json:__name__", "json:__name__: is str, not a function"),
        ("bebob2", "bebob2: no simulation: .*did you mean `bebop2`"),
        ("recorded", "gives no thrust"),
    ],
)
def test_what_names_no_simulation(text, message):
    with pytest.raises(DiscrepancyError, match=message) as caught:
        load_simulation(text, "bebop2")
    assert "\n" not in str(caught.value)


def test_a_function_without_a_vehicle():
    with pytest.raises(DiscrepancyError, match="names no vehicle: give it with --vehicle"):
        load_simulation("json:dumps")


def test_a_module_that_raises(tmp_path, monkeypatch):
    (tmp_path / "broken_simulation.py").write_text("raise RuntimeError('no licence')\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(DiscrepancyError, match="cannot be imported: RuntimeError: no licence"):
        load_simulation("broken_simulation:f", "bebop2")


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
    identify(flights, vehicle, pools, IdentifyOptions(cutoff_hz=30.0)).save(folder)
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


# --- An addition


def test_an_addition_is_the_simulation_with_effects(tmp_path, flight):
    path = tmp_path / "addition.json"
    effects = {"body_drag": {"x_n_s2_m2": 0.002}}
    adjusted = {"thrust": 1.5}
    path.write_text(
        json.dumps({"simulation": "bebop2", "vehicle": "bebop2", "effects": effects, "adjusted": adjusted})
    )
    simulation = load_simulation(str(path))
    plain = load_simulation("bebop2")
    expected = AugmentedSimulation(plain.adjusted(adjusted), read_effects(effects, "test"))
    np.testing.assert_allclose(simulation.wrench(flight), expected.wrench(flight), atol=1e-9)
    assert np.abs(simulation.wrench(flight) - plain.wrench(flight))[:, 2].max() > 0.01


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not a readable JSON file"),
        ('{"simulation": "bebop2", "vehicle": "bebop2", "effect": {}}', "unknown key `effect`"),
        ('{"simulation": "bebop2", "vehicle": "bebop2", "effects": {"drag": {}}}', "unknown effect `drag`"),
    ],
)
def test_what_is_no_addition(tmp_path, text, message):
    path = tmp_path / "addition.json"
    path.write_text(text)
    with pytest.raises(QuadpiError, match=message):
        load_simulation(str(path))


def test_code_that_an_addition_names_is_not_even_imported(tmp_path, monkeypatch):
    """Nor through an addition to an addition."""
    (tmp_path / "trap_simulation.py").write_text("from pathlib import Path\nPath('sprung').touch()\n")
    monkeypatch.chdir(tmp_path)
    for name, named in (("one", "trap_simulation:f"), ("two", str(tmp_path / "one.json"))):
        (tmp_path / f"{name}.json").write_text(json.dumps({"simulation": named, "vehicle": "bebop2"}))
        with pytest.raises(DiscrepancyError, match=r"one\.json: names code to run, .*--allow-code"):
            load_simulation(str(tmp_path / f"{name}.json"))
        assert not (tmp_path / "sprung").exists()
    with pytest.raises(DiscrepancyError, match="cannot be imported: AttributeError"):
        load_simulation(str(tmp_path / "two.json"), allow_code=True)
    assert (tmp_path / "sprung").exists()
