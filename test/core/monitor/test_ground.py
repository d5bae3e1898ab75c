# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What is taken for flying: rotors, motion and specific force together, and flying where they disagree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.monitor import alarm_kernel
from quadpi_core.monitor.alarm import Alarm
from quadpi_core.monitor.alarm_log import reasons
from quadpi_core.monitor.preparation import ROTOR_ZERO
from quadpi_core.records import Threshold
from quadpi_core.results import (
    BAD_DATA,
    CARRIED,
    IDLES,
    JUDGED,
    LANDS,
    LEVEL_ALARM,
    LEVEL_OK,
    LEVEL_WARNING,
    MOVED,
    PARKED,
    Alarms,
)
from test.core.monitor.alarm_samples import FX, LIMITS, RATE_HZ, SETTINGS, Samples

HOVER_RAD_S = 1000.0
GRAVITY = 9.80665


def vehicle_at(share: float, seconds: float = 3.0) -> Samples:
    """At rest, its rotors at a share of the squared speed of hover; every sample is a miss of Fx."""
    samples = Samples(seconds)
    samples.rotor_speeds[:] = HOVER_RAD_S * np.sqrt(share)
    samples.measured[:, FX] = 2.0
    return samples


def swaying(samples: Samples) -> Samples:
    """On a ship at 6 m/s in a swell of 8 s: it heaves by a metre and rolls by ten degrees."""
    phase = 2.0 * np.pi / 8.0 * np.arange(len(samples.time_ns)) / RATE_HZ
    samples.velocity[:, 0] = 6.0
    samples.velocity[:, 2] = 0.8 * np.sin(phase)
    samples.rates[:, 0] = 0.14 * np.cos(phase)
    samples.specific_force[:, 2] = -GRAVITY - 0.6 * np.cos(phase)
    return samples


def watched(envelope, samples: Samples, block: int | None = None) -> Alarms:
    return samples.run(Alarm(envelope, replace(LIMITS, hover_rotor_speed=HOVER_RAD_S), SETTINGS), block)


@pytest.mark.parametrize(
    ("samples", "level", "why"),
    [
        (vehicle_at(0.0), LEVEL_OK, PARKED),
        (vehicle_at(0.17), LEVEL_OK, IDLES),
        (swaying(vehicle_at(0.17, 20.0)), LEVEL_OK, MOVED),
        (swaying(vehicle_at(0.0, 20.0)), LEVEL_WARNING, CARRIED),
    ],
)
def test_parked_and_carried_vehicles_raise_no_alarm_and_say_why(envelope, samples, level, why):
    rows = watched(envelope, samples)
    assert max(rows.level) == level
    assert rows.why_not_judged[-1] == why
    assert rows.not_judged_share[-1] == 1.0
    assert reasons(rows, len(rows) - 1)[-1].endswith("(100 % of the time so far)")


def test_a_vehicle_carried_by_hand_warns_of_lost_telemetry(envelope):
    samples = vehicle_at(0.0)
    samples.velocity[:, 1] = 1.0
    rows = watched(envelope, samples)
    assert (rows.level[-1], rows.causes[-1]) == (LEVEL_WARNING, BAD_DATA)
    assert "carried, or no telemetry" in reasons(rows, len(rows) - 1)[-1]


def moving(quantity: str, value: float) -> Samples:
    """Slower rotors than in hover, and one sign of motion."""
    samples = vehicle_at(0.6)
    seconds = np.arange(len(samples.time_ns)) / RATE_HZ
    if quantity == "speed":
        samples.velocity[:, 1] = np.where(seconds % 0.2 < 0.1, value, -value)
    elif quantity == "way":
        samples.velocity[:, 2] = -value / 5.0 / (1.0 - np.exp(-3.0 / 5.0))
    elif quantity == "rate":
        samples.rates[:, 2] = value
    else:
        samples.specific_force[:, 2] = -GRAVITY * (1.0 + value)
    return samples


@pytest.mark.parametrize(
    ("quantity", "threshold"),
    [
        ("speed", alarm_kernel.MOVES_M_S),
        ("way", alarm_kernel.GONE_M),
        ("rate", alarm_kernel.MOVES_RAD_S),
        ("force", alarm_kernel.MOVES_G),
    ],
)
def test_slow_rotors_fly_once_the_vehicle_moves(envelope, quantity: str, threshold: Threshold):
    for factor, flies in ((0.98, False), (1.02, True)):
        rows = watched(envelope, moving(quantity, factor * threshold.value))
        assert (rows.why_not_judged[-1] == JUDGED) == flies
        assert (LEVEL_ALARM in rows.level) == (flies and quantity != "way")


def test_speeds_that_all_read_half_fly(envelope):
    """As with a wrong number of poles: specific force and rates are those of a calm flight."""
    samples = vehicle_at(0.25 * 0.9)
    samples.velocity[:, 0] = 0.5
    assert watched(envelope, samples).level[-1] == LEVEL_ALARM


@pytest.mark.parametrize("moves", [False, True])
def test_rotors_tell_alone_at_the_ends_only(envelope, moves: bool):
    threshold = alarm_kernel.TURNING.value if moves else alarm_kernel.LIFTED.value
    for factor, flies in ((0.98, False), (1.02, True)):
        samples = vehicle_at(factor * threshold)
        samples.velocity[:, 0] = 0.5 * moves
        assert np.all((watched(envelope, samples).why_not_judged == JUDGED) == flies)


@pytest.mark.parametrize(
    ("share", "force_g", "seconds", "lands"),
    [
        (0.19, 0.62, 0.31, True),
        (0.21, 0.62, 0.31, False),
        (0.19, 0.58, 0.31, False),
        (0.19, 0.62, 0.29, False),
    ],
)
def test_it_has_landed_once_something_else_carries_it(envelope, share, force_g, seconds, lands):
    samples = vehicle_at(1.0)
    slow = samples.between(1.0, 1.0 + seconds)
    samples.rotor_speeds[slow] = HOVER_RAD_S * np.sqrt(share)
    samples.specific_force[slow, 2] = -GRAVITY * force_g
    rows = watched(envelope, samples)
    assert np.any(np.isin(rows.why_not_judged[rows.time_ns > rows.time_ns[0]], (IDLES, MOVED))) == lands


def test_no_landing_is_an_alarm_and_the_next_flight_is_judged_at_once(envelope):
    """The rotors leave the training range at every landing, and the wrench its intervals."""
    samples = vehicle_at(1.0, 9.0)
    samples.measured[samples.between(0.0, 6.0)] = 0.0
    for start_s, end_s in ((2.0, 4.0), (5.0, 6.0)):
        parked = samples.between(start_s, end_s)
        samples.rotor_speeds[parked] = HOVER_RAD_S * np.sqrt(0.1)
        samples.inputs[parked] = 50.0
        samples.measured[parked, FX] = 2.0
    rows = watched(envelope, samples)
    seconds = 1e-9 * (rows.time_ns - samples.time_ns[0])
    raised = seconds[rows.level != LEVEL_OK]
    assert len(raised)
    assert 6.0 < raised[0] < 8.0
    assert set(rows.why_not_judged[(seconds > 2.4) & (seconds < 4.0)]) == {IDLES}


def test_a_hover_with_rotors_of_two_thirds_is_no_landing(envelope):
    """As with the model of a loaded vehicle: what slows down in the air still flies."""
    samples = vehicle_at(1.0, 10.0)
    samples.rotor_speeds[samples.between(1.0, 10.0)] = HOVER_RAD_S * np.sqrt(0.6)
    assert np.all(watched(envelope, samples).why_not_judged == JUDGED)


@pytest.mark.parametrize("reading", [0.0, 3.0])
def test_one_sensor_decides_nothing(envelope, reading: float):
    for share, flies in ((0.17, False), (1.0, True)):
        samples = vehicle_at(share)
        samples.rotor_speeds[:, 1] *= reading
        assert np.all((watched(envelope, samples).why_not_judged == JUDGED) == flies)


def test_a_rotor_that_reads_0_is_bad_data_within_a_quarter_of_a_second_of_lift_off(envelope):
    samples = vehicle_at(1.0)
    samples.measured[:] = 0.0
    samples.rotor_speeds[:, 2] = 0.0
    samples.faults[:] = ROTOR_ZERO << 2
    samples.rotor_speeds[samples.between(0.0, 1.0)] = 0.0
    rows = watched(envelope, samples)
    raised = int(np.argmax(rows.level == LEVEL_ALARM))
    assert 1e-9 * (rows.time_ns[raised] - samples.time_ns[0]) == pytest.approx(1.25, abs=0.01)
    assert reasons(rows, raised) == ("rotor 3 reads 0",)


def test_landing_and_take_off_are_the_same_for_blocks_of_any_length(envelope):
    samples = swaying(vehicle_at(0.1, 6.0))
    samples.rotor_speeds[samples.between(2.0, 4.0)] = HOVER_RAD_S
    whole = watched(envelope, samples)
    assert set(whole.why_not_judged) == {IDLES, MOVED, LANDS, JUDGED}
    for block in (1, 7, 500):
        parts = watched(envelope, samples, block)
        for name in ("time_ns", "level", "why_not_judged", "not_judged_share"):
            np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
    assert whole.not_judged_share[-1] == pytest.approx(1.0 - 2.0 / 5.9, abs=1e-3)
