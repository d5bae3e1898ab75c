# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A truth with exact derivatives, without a simulation; a vehicle, and states of it, for effects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from quadpi_core.frames import Array, quaternion_from_roll_pitch_yaw, rotate_world_to_body
from quadpi_core.simulation.applied_effects import effect_wrench, read_effects
from quadpi_core.simulation.rotor_local import RotorLocalModel
from quadpi_core.simulation.truth import Reference, Truth
from quadpi_core.vehicle import Vehicle

START_NS = 1_700_000_000_000_000_000


def swing(seconds: float = 4.0, *, wind: bool = True, roll: float = 0.7, pitch: float = 0.4) -> Truth:
    """Truth at 500 Hz with largest roll and pitch [rad]; yaw, path and rotor speeds vary as well."""
    vehicle = Vehicle.load("bebop2")
    time = np.arange(round(seconds * 500) + 1) / 500.0

    def sines(amplitude: list[float], frequency: list[float], order: int) -> Array:
        rate = np.array(frequency)
        return np.array(amplitude) * rate**order * np.sin(np.outer(time, rate) + order * np.pi / 2)

    angles, turning, turning_rate = (sines([roll, pitch, 1.5], [3.0, 2.2, 0.9], order) for order in range(3))
    path = [sines([2.0, 1.0, 0.5], [1.1, 1.7, 0.8], order) for order in range(3)]
    attitude = quaternion_from_roll_pitch_yaw(angles)
    rates, angular_acceleration = _body_rates(angles, turning, turning_rate)
    gravity = np.array([0.0, 0.0, vehicle.gravity_m_s2])
    momentum = rates @ vehicle.inertia
    force = vehicle.mass_kg * rotate_world_to_body(attitude, path[2] - gravity)
    moment = angular_acceleration @ vehicle.inertia + np.cross(rates, momentum)
    air = np.tile([-8.0, 0.0, 0.0], (len(time), 1))
    return Truth(
        name="swing",
        vehicle=vehicle,
        time_ns=START_NS + np.arange(len(time)) * 2_000_000,
        position=path[0],
        attitude=attitude,
        velocity=rotate_world_to_body(attitude, path[1]),
        rates=rates,
        acceleration=path[2],
        angular_acceleration=angular_acceleration,
        rotor_speeds=600.0 + sines([90.0, 70.0, 50.0, 80.0], [5.0, 4.0, 6.0, 3.0], 0),
        rotor_accelerations=sines([90.0, 70.0, 50.0, 80.0], [5.0, 4.0, 6.0, 3.0], 1),
        wrench=np.concatenate((force, moment), axis=1),
        wind=air + sines([0.3, 0.2, 0.1], [7.0, 9.0, 8.0], 0) if wind else np.zeros_like(air),
        known_wind=air if wind else None,
        reference=Reference(
            *path, angles[:, 2], turning[:, 2], np.zeros((len(time), 2)), np.zeros(len(time))
        ),
    )


def _body_rates(angles: Array, turning: Array, turning_rate: Array) -> tuple[Array, Array]:
    """Body rates and their derivative of roll, pitch and yaw, their first and second derivatives (N, 3)."""
    (sr, sp, _), (cr, cp, _) = np.sin(angles).T, np.cos(angles).T
    (dr, dp, dy), (ddr, ddp, ddy) = turning.T, turning_rate.T
    rates = np.stack((dr - dy * sp, dp * cr + dy * cp * sr, dy * cp * cr - dp * sr), axis=1)
    derivative = np.stack(
        (
            ddr - ddy * sp - dy * dp * cp,
            ddp * cr - dp * dr * sr + ddy * cp * sr + dy * (dr * cp * cr - dp * sp * sr),
            ddy * cp * cr - dy * (dp * sp * cr + dr * cp * sr) - ddp * sr - dp * dr * cr,
        ),
        axis=1,
    )
    return rates, derivative


@pytest.fixture(scope="session", name="swing")
def swing_fixture() -> Callable[..., Truth]:
    """swing(seconds, …) → Truth, see :func:`swing`."""
    return swing


@pytest.fixture(scope="session")
def model():
    """The Bebop 2 with its rotors 3 cm above the centre of gravity."""
    model = RotorLocalModel.load("bebop2")
    above = model.vehicle.rotor_positions + np.array([0.0, 0.0, -0.03])
    return replace(model, vehicle=replace(model.vehicle, rotor_positions=above))


@pytest.fixture(scope="session")
def record(model):
    return model.record()


@pytest.fixture(scope="session")
def states(model, random_states):
    return random_states(model, 300, seed=1)


@pytest.fixture(scope="session")
def degenerate_states(model):
    """Nothing moves, rotors stand, ground and ceiling touched or passed, straight climb and descent."""
    heights = (0.0, 1e-9, -0.1, -3.0, 0.01875, 0.1, 4.0, 1e4)
    speeds = (
        (0.0,) * 3,
        (0.0, 0.0, 5.0),
        (0.0, 0.0, -5.0),
        (1e-300, 0.0, 0.0),
        (30.0, 0.0, 0.0),
        (0.0, 1e3, 1e3),
    )
    rotors = ((0.0,) * 4, (700.0,) * 4, (0.0, 0.0, 700.0, 1200.0))
    rows = list(product(heights, speeds, rotors, (0.0, 40.0)))
    return model.states(
        np.array([speed for _, speed, _, _ in rows]),
        np.array([[rate] * 3 for *_, rate in rows]),
        np.array([rotor for _, _, rotor, _ in rows]),
        position=np.array([[0.0, 0.0, -height] for height, *_ in rows]),
    )


@pytest.fixture(scope="session")
def hover(model):
    """One level state at a height, with rotors at hover speed; call with what differs."""

    def build(velocity=(0.0, 0.0, 0.0), rates=(0.0, 0.0, 0.0), height=3.0, **rest):
        speeds = np.full((1, 4), model.hover_rotor_speed)
        position = np.array([[0.0, 0.0, -height]])
        rest = {name: np.array([values], dtype=float) for name, values in rest.items()}
        return model.states(
            np.array([velocity], dtype=float),
            np.array([rates], dtype=float),
            speeds,
            position=position,
            **rest,
        )

    return build


@pytest.fixture(scope="session")
def added(record):
    """added(effect, states, parameter=value, …) → wrench (N, 6); parameters left out are of typical size."""

    def wrench(name, states, **parameters):
        return effect_wrench(name, read_effects({name: parameters}, "test")[name], states, record)

    return wrench
