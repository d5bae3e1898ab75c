# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What counts as flight, by whatever the log holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.errors import LogError
from quadpi_core.field.airborne import Stretch, flown, pieces, velocity_of
from quadpi_core.field.field_log import FieldLog, Series

from .field_examples import AIRBORNE, example

GONE = dict.fromkeys(
    ("imu", "attitude", "velocity", "position", "commands", "rotor_speeds", "battery", "landed")
)


def only(**kept: Series) -> FieldLog:
    return replace(example(), **{**GONE, **kept})


@pytest.mark.parametrize("name", ["commands", "rotor_speeds", "velocity", "imu"])
def test_each_signal_tells_the_flight_alone(name):
    (stretch,) = flown(only(**{name: getattr(example(), name)})).stretches
    assert (stretch.begin, stretch.end) == pytest.approx(AIRBORNE, abs=1.5)


def test_speeds_attitude_and_manoeuvres():
    found = flown(example())
    assert found.told_by == "commands"
    assert found.airborne_s == pytest.approx(50.0, abs=0.5)
    assert found.speed_m_s[1] == pytest.approx(4.0 * 2.0**0.5, rel=0.1)
    assert found.tilt_deg[1] == pytest.approx(0.0, abs=0.1)
    assert found.shares["fast (above 3 m/s)"] > 0.3


def test_the_land_detector_counts_where_there_is_one():
    time = np.arange(0.0, 60.0, 1.0)
    landed = Series(time, ((time < 10.0) | (time > 40.0))[:, np.newaxis] * 1.0)
    (stretch,) = flown(example(landed=landed)).stretches
    assert (stretch.begin, stretch.end) == pytest.approx((10.0, 41.0), abs=0.2)


@pytest.mark.parametrize("alone", [False, True])
def test_a_detector_that_speaks_when_it_changes_holds_for_a_minute(alone):
    """With motors at hover throttle while it stands, as on a tether, the detector alone knows."""
    time, words = np.array([0.0, 5.0, 20.0, 80.0, 95.0]), np.array([[1.0], [0.0], [1.0], [0.0], [1.0]])
    clock = np.arange(0.0, 100.0, 0.01)
    commands = Series(clock, np.full((len(clock), 4), 0.4))
    voltage = Series(clock[::100], np.full((100, 1), 15.0))
    log = only(landed=Series(time, words), **({"battery": voltage} if alone else {"commands": commands}))
    found = flown(log)
    assert [(one.begin, one.end) for one in found.stretches] == [
        pytest.approx((5.0, 20.0), abs=0.2),
        pytest.approx((80.0, 95.0), abs=0.2),
    ]
    assert found.told_by == "the land detector"


def test_idling_for_a_quarter_of_an_hour_is_no_flight():
    """Fifteen minutes at a tenth of command, then a minute of flight: most commands are those of idling."""
    log = example()
    late = {name: Series(own.time + 900.0, own.values) for name, own in log.series().items()}
    before = np.arange(0.0, 900.0, 0.02)
    ground = {"commands": np.full((len(before), 4), 0.1), "velocity": np.zeros((len(before), 3))}
    joined = {
        name: Series(np.append(before, late[name].time), np.vstack([values, late[name].values]))
        for name, values in ground.items()
    }
    (stretch,) = flown(replace(log, **(late | joined | {"rotor_speeds": None}))).stretches
    assert (stretch.begin, stretch.end) == pytest.approx((905.0, 955.0), abs=0.5)


def test_a_crashed_vehicle_that_is_not_held_to_have_landed_does_not_fly():
    time = np.arange(0.0, 60.0, 1.0)
    landed = Series(time, (time < 5.0)[:, np.newaxis] * 1.0)
    (stretch,) = flown(example(landed=landed)).stretches
    assert stretch.end == pytest.approx(AIRBORNE[1], abs=0.5)


def test_motors_that_idle_on_the_ground_are_no_flight():
    time = np.arange(0.0, 30.0, 0.01)
    idle = Series(time, np.full((len(time), 4), 0.1))
    still = Series(time, np.zeros((len(time), 3)))
    with pytest.raises(LogError, match="no flight in it: by commands the vehicle never left the ground"):
        flown(only(commands=idle, position=still, velocity=still))


def test_a_battery_alone_is_no_flight():
    with pytest.raises(LogError, match="neither commands nor rotor speeds, state or gyro"):
        flown(only(battery=example().battery))


def test_velocity_is_the_slope_of_frequent_positions_alone():
    time = np.arange(0.0, 10.0, 0.01)
    path = np.stack([np.sin(time), 2.0 * time, 0.0 * time], axis=1)
    noisy = path + np.random.default_rng(0).normal(0.0, 1e-3, path.shape)
    slope = velocity_of(only(position=Series(time, noisy)))
    inside = slope.during(1.0, 9.0)
    truth = np.stack([np.cos(inside.time), 2.0 + 0.0 * inside.time], axis=1)
    assert np.abs(inside.values[:, :2] - truth).max() < 0.03
    assert velocity_of(only(position=Series(time[::10], noisy[::10]))) is None


def test_pieces_are_a_tenth_of_the_flight_within_limits():
    cut = pieces((Stretch(0.0, 30.0), Stretch(40.0, 50.0)), 5.0)
    assert len(cut) == 10
    assert [one.duration_s for one in cut] == pytest.approx([30.0 / 8] * 8 + [5.0] * 2)
    assert len(pieces((Stretch(0.0, 600.0),), 5.0)) == 120
    assert len(pieces((Stretch(0.0, 6.0),), 5.0)) == 4
