# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.frames import rotate_body_to_world
from quadpi_core.models.physical_rollout import RATES, STATES, AxisDisturbance, Disturbance
from quadpi_core.models.physical_terms import TERM_NAMES, TERMS, physical_vehicle
from quadpi_core.models.rollout_model import RolloutFlight, RolloutModel, StoredBody, horizon_steps
from quadpi_core.models.tubes import HORIZONS_S, QUANTITIES, TubeCalibration
from quadpi_core.vehicle import Vehicle
from test.core.models.flights_ahead import ahead, true_model
from test.core.models.physical_flights import REFERENCE, STEP_S, VEHICLE, known_parameters

HORIZONS = np.array([10, 50])
SLOW = Disturbance(STEP_S, (AxisDisturbance(1e-3, 3.2, 0.1),) * 6)


@pytest.fixture(scope="module")
def model() -> RolloutModel:
    ones = np.ones((4, len(HORIZONS_S), len(QUANTITIES)))
    sizes = TubeCalibration.of_flights([ones, ones], [ones, ones])
    return replace(true_model(SLOW), calibration=sizes)


def test_a_moment_that_the_model_lacks_is_held(model: RolloutModel) -> None:
    flight = ahead(5.0, 1)
    # The vehicle that flew had a moment that the model lacks: its measured wrench does, and its motion.
    missing = np.zeros(6)
    missing[4] = 2e-3
    starts = flight.starts(50, 10)[20:]
    pushed = replace(flight, wrench=flight.wrench + missing)
    plain = model.roll(flight, starts, HORIZONS).errors[:, -1, RATES]
    held = model.roll(pushed, starts, HORIZONS).errors[:, -1, RATES]
    gained = 0.5 * missing[4] / model.inertia[1, 1]
    assert np.median(held[:, 1] - plain[:, 1]) == pytest.approx(gained, rel=0.4)


def test_no_sample_after_the_start_is_used(model: RolloutModel) -> None:
    flight = ahead(5.0, 1)
    wrench = flight.wrench.copy()
    wrench[200:] += 1.0
    starts = np.array([200, 190])
    for before, after in zip(
        model.roll(flight, starts, HORIZONS),
        model.roll(replace(flight, wrench=wrench), starts, HORIZONS),
        strict=True,
    ):
        np.testing.assert_array_equal(before, after)


def test_the_tube_holds_what_a_disturbance_does(model: RolloutModel) -> None:
    rolled = model.roll(ahead(5.0, 1), np.array([100, 200]), HORIZONS)
    assert rolled.covariance.shape == (2, 2, STATES, STATES)
    assert np.all(np.linalg.eigvalsh(rolled.covariance) > 0.0)
    quiet = replace(model, disturbance=Disturbance.nothing(STEP_S))
    still = quiet.roll(ahead(5.0, 1), np.array([100, 200]), HORIZONS).covariance
    assert np.all(rolled.covariance[:, -1, 10, 10] > 10.0 * still[:, -1, 10, 10])


def test_errors_of_position_are_against_a_measured_one(model: RolloutModel) -> None:
    flight, horizons = ahead(3.0, 5), np.array([1, 20])
    starts = flight.starts(20, 10)
    bare = model.roll(flight, starts, horizons)
    world = rotate_body_to_world(flight.attitude, flight.motion["velocity"])
    way = np.vstack((np.zeros(3), np.cumsum(0.5 * flight.step * (world[1:] + world[:-1]), axis=0)))
    # Positions that move a tenth further than the velocity says, from another origin.
    known = model.roll(replace(flight, position=1.1 * way + 5.0), starts, horizons)
    moved = way[starts[:, np.newaxis] + horizons] - way[starts][:, np.newaxis]
    np.testing.assert_allclose(known.errors[..., :3], bare.errors[..., :3] - 0.1 * moved, atol=1e-9)
    np.testing.assert_array_equal(known.errors[..., 3:], bare.errors[..., 3:])


def test_a_stored_model_predicts_the_same_and_damage_is_refused(model: RolloutModel) -> None:
    data, arrays = model.to_json(), model.arrays()
    read = RolloutModel.stored(data, arrays)
    flight = ahead(3.0, 1)
    for before, after in zip(
        model.roll(flight, np.array([50]), HORIZONS), read.roll(flight, np.array([50]), HORIZONS), strict=True
    ):
        np.testing.assert_array_equal(before, after)
    for name, wrong, words in (
        ("covariance", arrays["covariance"][:3], "roll-outs: covariance of shape"),
        ("measured_variance", -arrays["measured_variance"], "measured_variance is not positive"),
        ("vehicle", 0.0 * arrays["vehicle"], "mass"),
        ("inertia", 0.0 * arrays["inertia"], "inertia"),
    ):
        with pytest.raises(ModelError, match=words):
            RolloutModel.stored(data, {**arrays, name: wrong})
    with pytest.raises(ModelError, match="'lift'"):
        RolloutModel.stored({**data, "parameters": ["lift", *data["parameters"][1:]]}, arrays)
    process = data["disturbance"]
    for changes, words in (
        ({"rotor_delay_s": -1.0}, "rotor_delay_s"),
        ({"disturbance": {**process, "axes": process["axes"][:5]}}, "axes"),
        ({"disturbance": {**process, "axes": [{**process["axes"][0], "gain": 2.0}] * 6}}, "gain"),
    ):
        with pytest.raises(ModelError, match=words):
            RolloutModel.stored({**data, **changes}, arrays)


def test_of_a_fused_flight(flights) -> None:
    fused = flights[0]
    own = RolloutFlight.from_flight(fused, Vehicle.load("bebop2"))
    assert 80.0 < 1.0 / own.step < 130.0
    k = len(own.time) // 2
    where = int(np.searchsorted(fused.time, own.time[k]))
    np.testing.assert_array_equal(own.attitude[k], fused.attitude[where])
    np.testing.assert_array_equal(own.motion["rotor_speeds"][k], fused.rotor_speeds[where])
    np.testing.assert_allclose(
        rotate_body_to_world(own.attitude[k : k + 1], own.motion["velocity"][k : k + 1]),
        rotate_body_to_world(fused.attitude[where : where + 1], fused.velocity[where : where + 1])
        - fused.wind[where],
    )


def test_a_measured_position_is_relative_to_the_air(flights) -> None:
    fused, vehicle = flights[0], Vehicle.load("bebop2")
    windy = replace(fused, wind=np.tile([1.0, -2.0, 0.5], (len(fused), 1)))
    still, moving = (
        RolloutFlight.from_flight(own, vehicle) for own in (replace(fused, wind=0.0 * fused.wind), windy)
    )
    assert still.position is not None
    assert moving.position is not None
    np.testing.assert_array_equal(still.position[:2], fused.position[:: len(fused) // len(still.time)][:2])
    drift = np.outer(still.time - still.time[0], [1.0, -2.0, 0.5])
    np.testing.assert_allclose(still.position - moving.position, drift, atol=1e-9)
    assert RolloutFlight.from_flight(replace(fused, position_measured=False), vehicle).position is None


def test_delayed_rotor_speeds_are_those_of_before() -> None:
    flight = ahead(3.0, 1)
    late = flight.delayed(0.02)
    np.testing.assert_allclose(late.motion["rotor_speeds"][2:], flight.motion["rotor_speeds"][:-2], rtol=1e-9)
    np.testing.assert_array_equal(late.motion["rates"], flight.motion["rates"])
    assert flight.delayed(0.0) is flight


def test_starts_leave_out_windows_without_a_rotor_and_across_gaps() -> None:
    flight = ahead(3.0, 1)
    np.testing.assert_array_equal(flight.starts(50, 10), np.arange(0, 250, 10))
    motion = flight.motion.copy()
    motion["rotor_speeds"][120, 2] = 0.0
    kept = replace(flight, motion=motion).starts(50, 10)
    assert not np.any((kept <= 120) & (kept >= 70))
    assert {60, 130} <= set(kept.tolist())
    late = replace(flight, time=flight.time + np.where(np.arange(len(flight.time)) < 120, 0.0, 0.5))
    assert not np.any((late.starts(50, 10) < 120) & (late.starts(50, 10) >= 70))


def test_horizons_in_samples() -> None:
    np.testing.assert_array_equal(horizon_steps([0.001, 0.01, 0.5], 0.00986), [1, 1, 51])


BODY = StoredBody(
    known_parameters(), np.eye(len(TERMS)), physical_vehicle(VEHICLE, REFERENCE), VEHICLE.inertia
)


def test_what_was_stored_is_read_whatever_the_order_of_its_terms() -> None:
    arrays, order = BODY.arrays("values"), np.arange(len(TERMS))[::-1]
    turned = {
        **arrays,
        "values": arrays["values"][order],
        "covariance": arrays["covariance"][order][:, order],
    }
    for names, own in ((TERM_NAMES, arrays), (TERM_NAMES[::-1], turned)):
        for before, after in zip(BODY, StoredBody.read(names, own, "values"), strict=True):
            np.testing.assert_array_equal(after, before)


def test_parameters_of_another_version_are_refused() -> None:
    with pytest.raises(ModelError, match="parameter 'warp' is not known to this version"):
        StoredBody.read(["warp", *TERM_NAMES[1:]], BODY.arrays("values"), "values")
    with pytest.raises(ModelError, match="inertia is missing"):
        StoredBody.read(TERM_NAMES, {"values": BODY.values, "covariance": BODY.covariance}, "values")
