# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadpi_core.models.rollout_flight import RolloutFlight, horizon_steps
from quadpi_core.rotations import rotate_body_to_world
from quadpi_core.vehicle import Vehicle
from test.core.models.flights_ahead import ahead


def test_of_a_fused_flight(flights) -> None:
    fused = flights[0]
    own = RolloutFlight.of(fused, Vehicle.load("bebop2"))
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
    still, moving = (RolloutFlight.of(own, vehicle) for own in (replace(fused, wind=0.0 * fused.wind), windy))
    assert still.position is not None
    assert moving.position is not None
    np.testing.assert_array_equal(still.position[:2], fused.position[:: len(fused) // len(still.time)][:2])
    drift = np.outer(still.time - still.time[0], [1.0, -2.0, 0.5])
    np.testing.assert_allclose(still.position - moving.position, drift, atol=1e-9)
    assert RolloutFlight.of(replace(fused, position_measured=False), vehicle).position is None


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
