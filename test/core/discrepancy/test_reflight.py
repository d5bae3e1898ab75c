# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The gap in flight: roll-outs, references flown again, coverage of intervals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.discrepancy.augmented_simulation import AugmentedSimulation
from quadpi_core.discrepancy.discrepancy_result import reflights_json
from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.loading import load_simulation
from quadpi_core.discrepancy.reflight import (
    coverages,
    fly_again,
    reflights,
    rollout,
    rollout_floor,
    rollouts,
    squared_distances,
)
from quadpi_core.discrepancy.simulations import Margins, VehicleSimulation
from quadpi_core.discrepancy.study import discover
from quadpi_core.errors import DiscrepancyError
from quadpi_core.estimator.fusion import fuse_airborne
from quadpi_core.logs import read_recording
from quadpi_core.simulation.applied_effects import read_effects
from quadpi_core.simulation.flying import SimulatedVehicle, simulate_flight
from quadpi_core.simulation.truth import STEP_HZ
from quadpi_core.vehicle import Vehicle


@pytest.fixture(scope="module")
def truth(plans):
    """A flight without sensors: what truly happened."""
    plan = plans["forward"]
    return simulate_flight(
        plan.name, SimulatedVehicle.load("bebop2"), plan.reference(STEP_HZ), seed=1
    ).flight()


def rms(squares):
    """Errors of velocity, attitude and rates."""
    return np.sqrt(squares.mean(axis=0))[1:]


def test_a_flight_rolls_out_along_itself_by_the_true_simulation_and_by_its_wrench(truth):
    simulation = load_simulation("bebop2")
    squares = rollout(truth, simulation)
    assert len(squares) == pytest.approx(4 * (truth.time[-1] - 0.5), abs=1)
    assert np.all(rms(squares)[:2] < [0.01, 0.3])
    assert np.all(rms(rollout_floor(truth, simulation.vehicle)) < [0.01, 0.1, 0.01])


def test_a_simulation_that_lacks_thrust_falls(truth):
    """Without a share of the thrust the vehicle gains that share of g downward."""
    simulation = load_simulation("bebop2")
    weaker = replace(simulation, model=simulation.with_coefficients({"thrust": -5.0}).model)
    hover = truth.slice(slice(0, int(1.2 * truth.rate_hz)))
    assert rms(rollout(hover, weaker, horizon_s=0.1))[0] == pytest.approx(0.05 * 9.81 * 0.1, rel=0.1)


def test_rotors_that_change_their_speed_turn_the_body_by_their_momentum(plans):
    plan, vehicle = plans["turns"], SimulatedVehicle.load("bebop2")
    flight = simulate_flight(plan.name, vehicle, plan.reference(STEP_HZ), seed=1).flight()
    inertia = 8e-6
    effects = read_effects({"spin_up": {"rotor_inertia_kg_m2": inertia}}, "test")
    simulation = AugmentedSimulation(load_simulation("bebop2"), effects)
    horizon_s = 0.1
    momentum = inertia * flight.rotor_speeds @ vehicle.vehicle.rotor_spins
    starts = np.arange(0.0, flight.time[-1] - horizon_s, 0.25)
    gained = np.interp(starts + horizon_s, flight.time, momentum) - np.interp(starts, flight.time, momentum)
    expected = np.sqrt(np.mean(np.square(gained))) / vehicle.vehicle.inertia[2, 2]
    assert rms(rollout(flight, simulation, horizon_s))[2] == pytest.approx(expected, rel=0.05)
    assert expected > 0.01


def test_too_short_a_flight(truth):
    with pytest.raises(DiscrepancyError, match=r"shorter than the 0\.5 s of a roll-out"):
        rollout(truth.slice(slice(0, 100)), load_simulation("bebop2"))


def test_tracks_are_compared_where_both_are(plans):
    plan, vehicle = plans["forward"], SimulatedVehicle.load("bebop2")
    track = fly_again(plan, vehicle)
    moved = replace(track, position=track.position + np.array([3.0, 4.0, 0.0]))
    squares = squared_distances(track.flight(), moved)
    assert squares.mean(axis=0) == pytest.approx([25.0, 0.0, 0.0, 0.0], abs=1e-6)
    later = replace(track, time_ns=track.time_ns + 10**9)
    assert len(squared_distances(track.flight(), later)) == len(track) - 500 == len(squares) - 500


def test_an_effect_shows_in_the_closed_loop(plans):
    plan, vehicle = plans["forward"], SimulatedVehicle.load("bebop2")
    effects = read_effects({"rotor_drag": None}, "test")
    flown = simulate_flight(
        plan.name, vehicle, plan.reference(STEP_HZ), effects=effects, seed=plan.seed
    ).flight()
    draggy = fly_again(plan, replace(vehicle, effects=effects))
    np.testing.assert_allclose(squared_distances(flown, draggy), 0.0, atol=1e-9)
    assert np.all(squared_distances(flown, fly_again(plan, vehicle)).mean(axis=0) > 1e-5)


@pytest.mark.slow
def test_flights_of_bags_are_flown_again(quadpi, tmp_path):
    names = ("forward", "climb", "turns")
    chosen = [argument for name in names for argument in ("--flight", name)]
    effect = "inflow_damping:damping_n_s_m=0.2"
    assert quadpi("simulate", "discovery", *chosen, "-o", tmp_path, "--effect", effect).status == 0
    vehicle = Vehicle.load("bebop2")
    flights = [
        fuse_airborne(read_recording(tmp_path / f"{name}.mcap", vehicle), vehicle, 30.0) for name in names
    ]
    found = discover(load_simulation("bebop2"), flights, names=("inflow_damping", "cg_offset"))
    result = reflights_json(reflights(found))
    loop = result["closed_loop"]
    assert loop["flights"] == 3
    assert loop["lost"] == []
    assert loop["reduction"] > 0.8
    # The floor is the error of the estimator alone, to which another may add or not.
    assert loop["position_m"]["after"] < 1.2 * loop["position_m"]["floor"] < loop["position_m"]["before"]
    for name in ("velocity_m_s", "attitude_deg"):
        assert result["rollout"][name]["after"] < 0.5 * result["rollout"][name]["before"]
    assert "coverage" not in result


def test_flights_without_a_reference_are_not_flown_again(flown):
    hidden = flown("inflow_damping:damping_n_s_m=0.2")
    found = discover(load_simulation("bebop2"), hidden, names=("inflow_damping",))
    assert reflights_json(reflights(found))["closed_loop"] == {
        "flights": 0,
        "missing": "the bags hold no reference that the simulation could fly again",
    }


def test_coverage_before_and_after(truth):
    """Intervals about a simulation that is off by twice their width hold nothing; corrected, everything."""
    good = load_simulation("bebop2")

    class Interval:
        def wrench(self, flight):
            return good.wrench(flight) + 0.2

        def recorded(self, flight, wrench):
            return good.recorded(flight, wrench)

        def margins(self, flight):
            bounds = np.full((len(flight), 6), 0.1)
            return Margins(-bounds, bounds, 0.95)

        vehicle, memoryless = good.vehicle, True

    found = coverages([Compared(truth, Interval())], [good])
    assert set(found) == {"Fx", "Fy", "Fz", "Mx", "My", "Mz"}
    for axis in found.values():
        assert axis.before == 0.0
        assert axis.after > 0.95


class Runaway(VehicleSimulation):
    """A simulation that pushes ever harder beyond the speeds of a flight, as a polynomial may."""

    def wrench(self, flight):
        speed = np.linalg.norm(flight.velocity, axis=1)
        assert np.all(np.isfinite(speed))
        push = np.zeros((len(flight), 6))
        push[:, 0] = np.where(speed > self.limit, 1e3, 0.0) * self.vehicle.mass_kg
        return super().wrench(flight) + push


def test_roll_outs_that_diverge_are_left_out_and_counted(truth):
    """Where every one is lost, there are no errors."""
    simulation = Runaway.load("bebop2")
    median = float(np.median(np.linalg.norm(truth.velocity, axis=1)))
    for limit, least, most in ((100.0, 0.0, 0.0), (median, 0.3, 0.9), (-1.0, 1.0, 1.0)):
        object.__setattr__(simulation, "limit", limit)
        nominal = load_simulation("bebop2")
        floor = rollout_floor(truth, nominal.vehicle)
        found = rollouts([rollout(truth, simulation)], [rollout(truth, nominal)], [floor])
        assert least <= found.lost["before"] / (found.starts + found.lost["before"]) <= most
        assert found.lost["after"] == 0
        assert np.all(np.isfinite(list(found.errors.values())))
        assert list(found.errors) == (["velocity_m_s", "attitude_deg", "rates_rad_s"] if most < 1.0 else [])
