# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights of the physical model itself with their attitude, and models that predict them ahead."""

from __future__ import annotations

import numpy as np

from quadpi_core.frames import from_rotation_vector, product
from quadpi_core.models.physical_fit import PhysicalFlight
from quadpi_core.models.physical_rollout import STATES, Disturbance
from quadpi_core.models.physical_terms import TERMS, physical_vehicle
from quadpi_core.models.rollout_model import RolloutFlight, RolloutModel
from test.core.models.physical_flights import REFERENCE, STEP_S, VEHICLE, flown, known_parameters


def with_attitude(flight: PhysicalFlight) -> RolloutFlight:
    """A flight of `flown` with the attitude that it had."""
    attitudes = np.zeros((len(flight.time), 4))
    attitude = np.array([1.0, 0.0, 0.0, 0.0])
    for k, motion in enumerate(flight.motion):
        attitudes[k] = attitude
        half = motion["rates"] + 0.5 * STEP_S * motion["angular_acceleration"]
        attitude = np.array(product(attitude, from_rotation_vector(STEP_S * half)))
    return RolloutFlight(flight.name, flight.time, attitudes, flight.motion, flight.wrench)


def ahead(seconds: float, seed: int, *, noise: float = 0.0, speed: float = 4.0) -> RolloutFlight:
    """A flight of `flown` to predict."""
    return with_attitude(flown(seconds, seed, noise=noise, speed=speed))


def true_model(disturbance: Disturbance | None = None) -> RolloutModel:
    """The model that flew, its tubes not calibrated."""
    return RolloutModel(
        parameters=known_parameters(),
        covariance=np.zeros((len(TERMS), len(TERMS))),
        vehicle=physical_vehicle(VEHICLE, REFERENCE),
        inertia=VEHICLE.inertia,
        gravity=VEHICLE.gravity_m_s2,
        rotor_delay_s=0.0,
        disturbance=disturbance or Disturbance.nothing(STEP_S),
        measured_variance=np.full(STATES, 1e-8),
    )
