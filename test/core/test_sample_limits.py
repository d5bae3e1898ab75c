# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Limits beyond which no sample of a flight lies: each decides at its value, and NaN is beyond all."""

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core import records
from quadpi_core.core import compiled
from quadpi_core.estimator.filter_state import MEASUREMENT, POSE, WORLD_VELOCITY
from quadpi_core.monitor.preparation import Preparation
from quadpi_core.signals.chain import ATTITUDE, ROTOR_SPEEDS, VELOCITY, channels
from quadpi_core.vehicle import Vehicle

VEHICLE = Vehicle.load("bebop2")
ZERO, LEVEL = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])


def second(value):
    return np.array([0.0, value, 0.0])


def usable_state(**values):
    """Whether a sample is plausible that has other values than at rest; rotors turn at 900 rad/s at most."""
    speed_max = 900.0 * VEHICLE.rotor_speed_max_rad_s / VEHICLE.rotor_speed_spike_rad_s
    preparation = Preparation(replace(VEHICLE, rotor_speed_max_rad_s=speed_max), 500.0, 40.0)
    columns = {"velocity": VELOCITY, "attitude": ATTITUDE, "rotor_speeds": ROTOR_SPEEDS}
    sample = np.zeros((1, channels(4)))
    sample[:, ATTITUDE] = LEVEL
    for name, value in values.items():
        sample[:, columns[name]] = value
    return bool(preparation.step(np.array([0]), sample).usable[0])


def usable(kind, vector, attitude=0.0):
    """Whether a measurement can be one."""
    measurement = np.zeros(1, MEASUREMENT)
    measurement["kind"], measurement["vector"], measurement["attitude"] = kind, vector, attitude
    return compiled.usable_measurement(measurement)


LIMITS = {
    "rates, rad/s: twice 2000 deg/s": (70.0, lambda x: compiled.usable_imu(second(x), ZERO)),
    "specific force, m/s²: 32 g and a little": (320.0, lambda x: compiled.usable_imu(ZERO, second(x))),
    "position, m": (10_000.0, lambda x: usable(POSE, second(x), LEVEL)),
    "speed that a sensor gives, m/s": (300.0, lambda x: usable(WORLD_VELOCITY, second(x))),
    "speed of a vehicle, m/s": (100.0, lambda x: usable_state(velocity=second(x))),
    "rotor speed that its sensor reads, rad/s": (900.0, lambda x: usable_state(rotor_speeds=x)),
    "norm of an attitude that is normalised": (1e6, lambda x: usable(POSE, ZERO, x * LEVEL)),
    "norm of an attitude of a state": (1.1, lambda x: usable_state(attitude=x * LEVEL)),
}


@pytest.mark.parametrize("name", LIMITS)
def test_each_limit_decides_at_its_value(name):
    value, usable = LIMITS[name]
    assert usable(0.999 * value)
    assert not usable(1.001 * value)
    assert not usable(np.nan)


def test_magnitudes_count_but_rotors_never_turn_backward():
    for name in list(LIMITS)[:5]:
        value, usable = LIMITS[name]
        assert usable(-0.999 * value)
        assert not usable(-1.001 * value)
    assert usable_state(rotor_speeds=0.0)
    assert not usable_state(rotor_speeds=np.array([0.0, 0.0, 0.0, -1e-9]))


def test_norms_have_a_least_one_too():
    assert usable(POSE, ZERO, 0.501 * LEVEL)
    assert not usable(POSE, ZERO, 0.499 * LEVEL)
    assert usable_state(attitude=0.901 * LEVEL)
    assert not usable_state(attitude=0.899 * LEVEL)


def test_gravity_is_the_standard_one():
    """CGPM 1901."""
    assert records.STANDARD_GRAVITY == 9.80665
