# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What was found, added: the simulation written runs, is closer, and can be searched on again."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from quadpi_core.discrepancy.augmented_simulation import (
    AugmentedSimulation,
    _with_own,
    augmented,
    merged,
    write_addition,
)
from quadpi_core.discrepancy.candidates import candidates
from quadpi_core.discrepancy.discrepancy_result import discovery_json
from quadpi_core.discrepancy.loading import load_simulation
from quadpi_core.discrepancy.other_simulations import CallableSimulation
from quadpi_core.discrepancy.simulations import VehicleSimulation
from quadpi_core.discrepancy.study import discover
from quadpi_core.errors import DiscrepancyError
from quadpi_core.report.discrepancy_evidence import write_formulas
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.simulation.applied_effects import effect_wrench, read_effects
from quadpi_core.simulation.flying import SimulatedVehicle
from quadpi_core.simulation.state_records import STATE, VEHICLE
from quadpi_core.vehicle import Vehicle

# Few, so that searches are quick.
NAMES = ("inflow_damping", "cg_offset", "weak_rotor", "sensor_delay")
HIDDEN = ("inflow_damping:damping_n_s_m=0.2",)


@pytest.fixture(scope="module")
def discovery(flown):
    return discover(load_simulation("bebop2"), flown(*HIDDEN), names=NAMES)


def left(simulation, flights):
    residual = [measured_wrench(f, simulation.vehicle) - simulation.wrench(f) for f in flights]
    return np.sqrt(np.mean(np.square(np.concatenate(residual)), axis=0))


def test_what_the_estimator_took_for_a_bias_is_not_added(flown):
    """A turned accelerometer shows a share of gravity, whose slow part the estimator takes away."""
    hidden, simulation = ("imu_misalignment:x_deg=2,y_deg=-1.5,z_deg=1",), load_simulation("bebop2")
    found = discover(simulation, flown(*hidden), names=("imu_misalignment", "cg_offset"))
    assert [effect.name for effect in found.effects] == ["imu_misalignment"]
    values = [parameter.value for parameter in found.effects[0].parameters]
    np.testing.assert_allclose(values, [2.0, -1.5, 1.0], atol=0.1)
    floor, before = left(simulation, flown()), left(simulation, flown(*hidden))
    after = left(augmented(found), flown(*hidden))
    # Where the vehicle pitches steeply motion capture sees it half of the time only.
    assert np.all((after**2 - floor**2)[:2] < 0.08 * (before**2 - floor**2)[:2])


def test_the_vehicle_file_flies_with_the_effect(discovery, flown, tmp_path):
    assert [effect.name for effect in discovery.effects] == ["inflow_damping"]
    path = write_addition(discovery, tmp_path)
    text, code = write_formulas(discovery.effects, tmp_path)
    assert path == tmp_path / "bebop2.yaml"
    simulation = load_simulation(str(path))
    assert simulation.effects["inflow_damping"]["damping_n_s_m"] == pytest.approx(0.2, rel=0.1)
    before, after = left(load_simulation("bebop2"), flown(*HIDDEN)), left(simulation, flown(*HIDDEN))
    assert after[2] < 0.2 * before[2]
    assert np.all(after < 1.2 * before)
    vehicle = SimulatedVehicle.load(path)
    assert vehicle.effects == simulation.effects
    # It is the same vehicle to what was identified for it.
    assert vehicle.vehicle.fingerprint == Vehicle.load("bebop2").fingerprint
    assert "$$ F_{z,i}" in text.read_text()
    namespace = {}
    exec(code.read_text(), namespace)
    assert namespace["INFLOW_DAMPING_PARAMETERS"][0] == discovery.effects[0].parameters[0].value


def test_a_law_that_flights_shape(flown, tmp_path):
    """Another law than that of the library is hidden: what is added is as the flights have it."""
    hidden = ("inflow_damping:damping_n_s_m=0.2,shape_speed=-0.25,shape_load=0.4,shape_fz=-0.1",)
    plain = load_simulation("bebop2")
    found = discover(plain, flown(*hidden), names=NAMES)
    (effect,) = found.effects
    assert effect.name == "inflow_damping"
    assert effect.shape["shape_speed"] < -0.1
    assert discovery_json(found)["effects"][0]["shape"] == effect.shape
    path, (text, code) = write_addition(found, tmp_path), write_formulas(found.effects, tmp_path)
    simulation = load_simulation(str(path))
    bare = {p.name: p.value for p in effect.parameters}
    before, lawful, after, floor = (
        left(simulation, flights)[2]
        for simulation, flights in (
            (plain, flown(*hidden)),
            (AugmentedSimulation(plain, read_effects({effect.name: bare}, "test")), flown(*hidden)),
            (simulation, flown(*hidden)),
            (plain, flown()),
        )
    )
    assert after**2 - floor**2 < 0.1 * (lawful**2 - floor**2)
    assert after**2 - floor**2 < 0.01 * (before**2 - floor**2)
    # One number is in the file, in the formula and in Python.
    assert simulation.effects[effect.name] == pytest.approx({**bare, **effect.shape})
    assert f"$s_V = {effect.shape['shape_speed']:.3g}$" in text.read_text()
    namespace = {}
    exec(code.read_text(), namespace)
    flight = flown(*hidden)[0].slice(slice(0, 2000, 100))
    states, record = plain.states(flight), plain.record()
    exported = namespace["wrench_of"](
        namespace["inflow_damping"],
        namespace["INFLOW_DAMPING_PARAMETERS"],
        {name: states[name] for name in STATE.names},
        {name: record[name][0] for name in VEHICLE.names},
        namespace["INFLOW_DAMPING_SHAPE"],
    )
    expected = effect_wrench(effect.name, simulation.effects[effect.name], states, record)
    np.testing.assert_allclose(exported, expected, rtol=1e-9, atol=1e-12)


def test_nothing_more_is_found_in_what_was_written(discovery, flown, tmp_path):
    path = write_addition(discovery, tmp_path)
    again = discover(load_simulation(str(path)), flown(*HIDDEN), names=NAMES)
    assert again.verdict == "none"
    assert write_addition(again, tmp_path / "nowhere") is None


def test_a_flight_left_out_has_no_say(discovery):
    everything = augmented(discovery).effects["inflow_damping"]["damping_n_s_m"]
    others = [
        augmented(discovery, without=place).effects["inflow_damping"]["damping_n_s_m"] for place in range(4)
    ]
    assert len({everything, *others}) == 5
    np.testing.assert_allclose(others, everything, rtol=0.2)


def test_coefficients_move_within_their_tolerances(flown):
    """A simulation whose coefficients are off as its tolerances say, and that lacks an effect as well."""
    off = {"thrust": 1.0, "rotor_force_along": -1.0, "torque": 0.8}
    simulation = load_simulation("bebop2").with_coefficients(off)
    found = discover(simulation, flown(*HIDDEN), names=NAMES)
    assert [effect.name for effect in found.effects] == ["inflow_damping"]
    added = augmented(found)
    assert isinstance(added.base, VehicleSimulation)
    true, now = load_simulation("bebop2").model.coefficients, added.base.model.coefficients
    assert now.rotor_force_along == pytest.approx(true.rotor_force_along, rel=0.03)
    assert now.torque[0] == pytest.approx(true.torque[0], rel=0.03)


def test_an_addition_to_a_function(flown, tmp_path, monkeypatch):
    (tmp_path / "outside.py").write_text(
        "from quadpi_core.discrepancy.simulations import VehicleSimulation\n"
        "wrench = VehicleSimulation.load('bebop2').wrench\n"
    )
    monkeypatch.chdir(tmp_path)
    simulation = load_simulation("outside:wrench", "bebop2")
    found = discover(simulation, flown(*HIDDEN), names=NAMES)
    assert [effect.name for effect in found.effects] == ["inflow_damping"]
    path = write_addition(found, tmp_path)
    assert path.name == "addition.json"
    assert json.loads(path.read_text())["simulation"] == "outside:wrench"
    with pytest.raises(
        DiscrepancyError, match="names code to run, the function outside:wrench: --allow-code"
    ):
        load_simulation(str(path))
    added = load_simulation(str(path), allow_code=True)
    assert isinstance(added.base, CallableSimulation)
    assert added.code == f"outside:wrench of {tmp_path / 'outside.py'}, named by {path}"
    expected = augmented(found)
    flight = flown(*HIDDEN)[0]
    np.testing.assert_allclose(added.wrench(flight), expected.wrench(flight), rtol=1e-9, atol=1e-12)
    assert left(added, flown(*HIDDEN))[2] < 0.2 * left(simulation, flown(*HIDDEN))[2]


def drag(newtons, **shape):
    return {"rotor_drag": {"drag_n_s_m": newtons, **shape}}


def inertia(x, y):
    return {"inertia": {"x_change": x, "y_change": y, "z_change": 0.0}}


@pytest.mark.parametrize(
    ("one", "other", "both"),
    [
        # What only one has is as it is, in the order in which effects act.
        (
            {"wind": {"north_m_s": 1.0}, "weak_rotor": {"rotor": 2, "loss": 0.1, "torque_change": 0.0}},
            {"wind": {"north_m_s": 0.5, "east_m_s": 1.0}},
            {
                "weak_rotor": {"rotor": 2.0, "loss": 0.1, "torque_change": 0.0},
                "wind": {"north_m_s": 1.5, "east_m_s": 1.0, "down_m_s": 0.0},
            },
        ),
        # The sum stays within bounds.
        (
            {"weak_rotor": {"rotor": 2, "loss": 0.1, "torque_change": -0.1}},
            {"weak_rotor": {"rotor": 2, "loss": 0.95, "torque_change": -0.1}},
            {"weak_rotor": {"rotor": 2.0, "loss": 1.0, "torque_change": -0.2}},
        ),
        # Shapes of one law add up by their sizes.
        (drag(0.1, shape_u=0.4), drag(0.3), drag(0.4, shape_u=0.1)),
        (drag(0.1, shape_u=0.4), drag(-0.05), drag(0.05, shape_u=0.8)),
        (drag(0.1, shape_u=0.4), drag(-0.1), drag(0.0)),
        # Changes of inertia multiply.
        (inertia(0.2, -0.1), inertia(0.2, -0.1), inertia(0.44, -0.19)),
    ],
)
def test_effects_add_up(one, other, both):
    found = merged(read_effects(one, "test"), read_effects(other, "test"))
    assert list(found) == list(both)
    assert all(found[name] == pytest.approx(values) for name, values in both.items())


@pytest.mark.parametrize(("shared", "flown"), [(0.034, 0.025), (0.005, 0.0), (None, 0.0)])
def test_a_flight_may_have_less_than_what_all_share_but_not_less_than_nothing(shared, flown):
    """A delay of 9 ms less than that of the others."""
    (delay,) = candidates(load_simulation("bebop2").vehicle, ["sensor_delay"])
    own = np.array([-0.009, 0.0])
    regression = SimpleNamespace(
        conditions=[SimpleNamespace(index=0)], candidates=[delay], of_condition=lambda *_: (own, own)
    )
    effects = {"sensor_delay": {"rotor_speeds_s": shared, "mocap_s": 0.0}} if shared else {}
    found = _with_own(effects, regression, 0, None)
    assert found["sensor_delay"] == {"rotor_speeds_s": pytest.approx(flown), "mocap_s": 0.0}


def test_an_effect_on_another_rotor_does_not_add_up():
    one, other = (read_effects({"weak_rotor": {"rotor": rotor}}, "test") for rotor in (2, 3))
    with pytest.raises(DiscrepancyError, match="effect `weak_rotor`: the simulation has one already"):
        merged(one, other)


def test_an_effect_of_nothing_on_sensors_changes_nothing(flown):
    """Though the simulation and the flights lie apart."""
    simulation, flight = load_simulation("bebop2"), flown(*HIDDEN)[0]
    nothing = read_effects({"imu_lever_arm": {"x_m": 0.0, "y_m": 0.0, "z_m": 0.0}}, "test")
    added = AugmentedSimulation(simulation, nothing)
    np.testing.assert_allclose(added.wrench(flight), simulation.wrench(flight), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "reads"),
    [("payload", False), ("rotor_drag", False), ("slung_load", True), ("imu_misalignment", True)],
)
def test_who_reads_the_measured_accelerations_says_so(flight, name, reads):
    simulation = AugmentedSimulation(load_simulation("bebop2"), read_effects({name: None}, "test"))
    shaken = replace(
        flight,
        specific_force=1.1 * flight.specific_force,
        angular_acceleration=1.1 * flight.angular_acceleration + 1.0,
    )
    assert simulation.reads_accelerations == reads
    assert np.array_equal(simulation.wrench(flight), simulation.wrench(shaken)) != reads


def test_every_flight_has_the_same_tolerances(flown):
    """Of an addition, too: an axis that one flight does not feel has a column all the same."""
    effects = read_effects(
        {"ground_effect": None, "imu_lever_arm": {"x_m": 1e-4, "y_m": 0.0, "z_m": 0.0}}, "test"
    )
    added = AugmentedSimulation(load_simulation("bebop2"), effects)
    low, *_ = flown(*HIDDEN)
    high = replace(low, position=low.position - [0.0, 0.0, 1000.0])
    names = [[column.name for column in added.uncertain(flight)] for flight in (low, high)]
    assert names[0] == names[1]
    assert "Fz of ground_effect" in names[0]
