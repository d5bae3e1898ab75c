# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""From paired samples to inputs and measured wrench, against scipy and the equations themselves."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from quadpi_core.errors import SignalError
from quadpi_core.estimator.filter_state import ImuRate
from quadpi_core.frames import rotate_body_to_world, rotate_world_to_body
from quadpi_core.inputs import aerodynamic_inputs
from quadpi_core.monitor.preparation import RATE_DIFFERS, RATE_LOW, RATE_UNKNOWN, Preparation, Prepared
from test.core.monitor.conftest import CUTOFF_HZ, RATE_HZ
from test.core.monitor.test_monitor import changed, cut


def low_passed(values):
    """(N, C) through scipy's Butterworth filter, settled at the first sample."""
    sections = signal.butter(4, CUTOFF_HZ, fs=RATE_HZ, output="sos")
    settled = signal.sosfilt_zi(sections)[:, :, None] * values[0]
    return signal.sosfilt(sections, values, axis=0, zi=settled)[0]


def slope(values):
    """The derivative (N, C) whose trapezoidal integral is the signal; zero at first."""
    slopes = np.zeros_like(values)
    for k in range(1, len(values)):
        slopes[k] = 2.0 * RATE_HZ * (values[k] - values[k - 1]) - slopes[k - 1]
    return slopes


def assert_same(left: Prepared, right: Prepared):
    for one, other in zip(left, right, strict=True):
        np.testing.assert_array_equal(one, other)


def test_inputs_and_wrench_are_those_of_the_filtered_samples(vehicle, samples):
    flown = changed(cut(samples, slice(0, 1000)), wind=np.array([4.0, -2.0, 1.0]))
    either_sign = flown.attitude * np.where(np.arange(1000) % 7 < 3, 1.0, -1.0)[:, None]
    prepared = Preparation(vehicle, RATE_HZ, CUTOFF_HZ).step(*changed(flown, attitude=either_sign))
    assert prepared.usable.all()
    np.testing.assert_array_equal(prepared.usable_ns, flown.time_ns)

    velocity, attitude, rates, force, rotors, wind = (
        low_passed(getattr(flown, name))
        for name in ("velocity", "attitude", "rates", "specific_force", "rotor_speeds", "wind")
    )
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    airspeed = velocity - rotate_world_to_body(attitude, wind)
    expected = aerodynamic_inputs(airspeed, attitude, rates, rotors, vehicle)
    np.testing.assert_allclose(prepared.inputs, expected, rtol=1e-9, atol=1e-9)
    in_world = rotate_body_to_world(attitude, velocity)
    np.testing.assert_allclose(prepared.verdicts["velocity"], in_world, rtol=1e-9, atol=1e-12)
    moment = slope(rates) @ vehicle.inertia + np.cross(rates, rates @ vehicle.inertia)
    measured = np.hstack((vehicle.mass_kg * force, moment))
    np.testing.assert_allclose(prepared.measured, measured, rtol=1e-7, atol=1e-9)
    moving = prepared.derivatives
    np.testing.assert_allclose(moving["angular_acceleration"], slope(rates), rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(moving["rotor_accelerations"], slope(rotors), rtol=1e-7, atol=1e-5)
    np.testing.assert_allclose(moving["rotor_jerks"], slope(slope(rotors)), rtol=1e-6, atol=1e-2)


@pytest.mark.parametrize(
    ("topics", "missing_s", "settles_s"),
    [
        (("velocity", "attitude"), 0.08, 0.0),
        (("velocity", "attitude"), 0.2, 1.0),
        # Without rotor speeds the state goes on, and only the low-pass begins again.
        (("rotor_speeds",), 0.2, 6.0 / CUTOFF_HZ),
        (("rotor_speeds",), 3.0, 6.0 / CUTOFF_HZ),
    ],
)
def test_a_state_settles_for_a_second_after_its_start_and_after_an_interruption(
    vehicle, samples, topics, missing_s, settles_s
):
    seconds = 1e-9 * (samples.time_ns - samples.time_ns[0])
    missing = (seconds >= 4.0) & (seconds < 4.0 + missing_s)
    without = {topic: getattr(samples, topic).copy() for topic in topics}
    for values in without.values():
        values[missing] = np.nan
    prepared = Preparation(vehicle, RATE_HZ, CUTOFF_HZ).step(*changed(samples, **without))
    used = seconds[prepared.usable]
    expected = (used >= 1.0) & ((used < 4.0) | (used >= 4.0 + missing_s + settles_s))
    np.testing.assert_array_equal(prepared.usable, ~missing)
    np.testing.assert_array_equal(prepared.settled, expected)


def test_after_a_gap_the_low_pass_begins_with_the_next_sample(vehicle, samples):
    time_ns = samples.time_ns.copy()
    time_ns[2000:] += 150_000_000
    gappy = Preparation(vehicle, RATE_HZ, CUTOFF_HZ).step(*changed(samples, time_ns=time_ns))
    after = Preparation(vehicle, RATE_HZ, CUTOFF_HZ).step(*cut(samples, slice(2000, None)))
    np.testing.assert_array_equal(gappy.inputs[2000:], after.inputs)
    np.testing.assert_array_equal(gappy.measured[2000:], after.measured)


def test_reset_forgets_and_another_rate_is_another_low_pass(vehicle, samples):
    preparation = Preparation(vehicle, RATE_HZ, CUTOFF_HZ)
    first = preparation.step(*samples)
    preparation.reset()
    assert_same(preparation.step(*samples), first)
    preparation.reset()
    preparation.retune(ImuRate(250.0))
    thinned = cut(samples, np.arange(0, len(samples.time_ns), 2))
    assert_same(preparation.step(*thinned), Preparation(vehicle, 250.0, CUTOFF_HZ).step(*thinned))


@pytest.mark.parametrize(
    ("rate", "fault"),
    [
        (ImuRate(), RATE_UNKNOWN),
        (ImuRate(500.0, 400.0), RATE_DIFFERS),
        (ImuRate(500.0, lost=True), 0),
        (ImuRate(23.0), RATE_LOW),
    ],
)
def test_no_sample_is_used_without_a_rate_that_fits(vehicle, samples, rate, fault):
    preparation = Preparation(vehicle, None, CUTOFF_HZ)
    few = cut(samples, slice(0, 10))
    if fault == RATE_LOW:
        with pytest.raises(SignalError, match="half the sample rate"):
            preparation.retune(rate)
    else:
        preparation.retune(rate)
    prepared = preparation.step(*few)
    assert np.all(prepared.verdicts["faults"] == fault)
    assert prepared.usable.any() == (fault == 0)
    assert len(prepared.inputs) == len(prepared.measured) == prepared.usable.sum()
