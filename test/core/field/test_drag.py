# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Drag over mass and wind: exact flights, simulated windy ones, and flights that do not tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.field.airborne import flown
from quadpi_core.field.drag import DragResult, drag_samples, identify_drag, piece_lengths_s
from quadpi_core.field.field_log import FieldLog, Series

from .field_examples import DRAG, example
from .windy_flights import windy_flight


def identified(*logs: FieldLog) -> DragResult:
    flights = [flown(log) for log in logs]
    lengths = piece_lengths_s([flight.airborne_s for flight in flights])
    return identify_drag([drag_samples(*own) for own in zip(logs, flights, lengths, strict=True)])


def slower(log: FieldLog, factor: float) -> FieldLog:
    velocity = replace(log.velocity, values=factor * log.velocity.values)
    values = log.imu.values.copy()
    values[:, 3:5] *= factor
    values[:, 3:5] += np.random.default_rng(round(100 * factor)).normal(0.0, 0.3, (len(values), 2))
    return replace(log, velocity=velocity, imu=replace(log.imu, values=values))


def test_drag_of_a_flight_in_still_air():
    result = identified(example())
    for estimate, true in zip(result.per_mass, DRAG, strict=True):
        assert estimate.value == pytest.approx(true, rel=0.02)
        assert estimate.low < true < estimate.high
    assert min(result.fitted) > 0.9
    assert not result.by_flight
    assert result.speed[1] == pytest.approx(5.5, abs=0.5)


@pytest.mark.parametrize("density", [None, 0.9])
def test_momentum_and_bluff_body_drag_are_told_apart_by_speed(density):
    """Coefficients are those at standard density, whatever the air was."""
    log, ratio = example(), (density or 1.225) / 1.225
    if density is not None:
        log = replace(log, density=Series(log.imu.time[[0, -1]], np.full((2, 1), density)))
    velocity = 4.0 * log.velocity.values
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    force = -(0.15 + 0.5 * 1.225 / np.array([30.0, 20.0]) * speed) * velocity[:, :2]
    values = log.imu.values.copy()
    values[:, 3:5] = Series(log.velocity.time, force).at(log.imu.time)
    values[~np.isfinite(values)] = 0.0
    result = identified(
        replace(log, imu=replace(log.imu, values=values), velocity=replace(log.velocity, values=velocity))
    )
    assert result.momentum.value == pytest.approx(0.15 / ratio**0.5, rel=0.1)
    values = [one.value for one in result.ballistic]
    assert values == pytest.approx([30.0 * ratio, 20.0 * ratio], rel=0.1)
    assert result.ballistic[0].low < 30.0 * ratio < result.ballistic[0].high


def test_air_that_the_log_does_not_tell_widens_coefficients():
    log = example()
    velocity = 4.0 * log.velocity.values
    drag = -(0.15 + 0.02 * np.linalg.norm(velocity, axis=1, keepdims=True)) * velocity[:, :2]
    values = log.imu.values.copy()
    values[:, 3:5] = np.nan_to_num(Series(log.velocity.time, drag).at(log.imu.time))
    fast = replace(log, imu=replace(log.imu, values=values), velocity=Series(log.velocity.time, velocity))
    told = identified(replace(fast, density=Series(log.imu.time[[0, -1]], np.full((2, 1), 1.225))))
    untold = identified(fast)
    assert untold.ballistic[0].value == told.ballistic[0].value
    assert untold.ballistic[0].low < 0.92 * untold.ballistic[0].value < told.ballistic[0].low
    assert "-38 to +15 % for the density of the air" in untold.ballistic[0].reason
    assert untold.per_mass == told.per_mass


def test_coefficients_without_a_square_are_of_momentum_alone():
    """A square of no known size would take part of linear drag from it."""
    log = example()
    values = log.imu.values.copy()
    values[:, 4] *= DRAG[0] / DRAG[1]
    air = Series(log.imu.time[[0, -1]], np.full((2, 1), 1.225))
    result = identified(replace(log, imu=replace(log.imu, values=values), density=air))
    assert all(one.value is None and "MCOEF is without it" in one.reason for one in result.ballistic)
    assert result.momentum.low < DRAG[0] < result.momentum.high
    assert result.momentum.half_width < 0.01 * DRAG[0]


def test_one_fast_pass_gives_no_coefficients():
    log = example()
    fast = np.where(np.abs(log.velocity.time[:, np.newaxis] - 12.0) < 1.5, 30.0, 1.0)
    velocity = fast * log.velocity.values
    force = -0.02 * np.linalg.norm(velocity, axis=1, keepdims=True) * velocity[:, :2]
    values = log.imu.values.copy()
    values[:, 3:5] += np.nan_to_num(Series(log.velocity.time, force).at(log.imu.time))
    changed = replace(log, imu=replace(log.imu, values=values), velocity=Series(log.velocity.time, velocity))
    result = identified(changed)
    assert all(one.value is None for one in result.ballistic)


def test_a_slow_flight_is_told_to_fly_faster():
    result = identified(slower(example(), 0.1))
    assert all("too slow, " in one.reason and one.value is None for one in result.per_mass)
    assert result.usable < 50
    assert "5 m/s or more" in result.advice


def test_a_short_flight_is_told_so():
    log = example()
    cut = {name: series.during(5.0, 12.0) for name, series in log.series().items()}
    assert "too short, 7 s in the air" in identified(replace(log, **cut)).per_mass[0].reason


def test_no_drag_is_not_identified():
    log = example()
    values = log.imu.values.copy()
    values[:, 3:5] = np.random.default_rng(0).normal(0.0, 1.0, (len(values), 2))
    result = identified(replace(log, imu=replace(log.imu, values=values)))
    assert all("holds 0" in one.reason and one.low < 0.0 < one.high for one in result.per_mass)
    assert result.advice.startswith("fly ")


def test_five_flights_are_clusters_of_their_own():
    logs = [slower(example(), factor) for factor in (0.8, 0.9, 1.0, 1.1, 1.2)]
    result = identified(*logs)
    assert result.by_flight
    assert len(result.wind) == 5
    assert result.per_mass[0].low < DRAG[0] < result.per_mass[0].high


@pytest.mark.slow
def test_intervals_cover_drag_and_wind_of_windy_flights_one_by_one_and_by_five(tmp_path):
    """Seeds from 1000 on were never looked at while the constants were set (0 to 59 were)."""
    flights = [windy_flight(tmp_path, seed) for seed in range(1000, 1050)]
    for together in (1, 5):
        inside, widths, winds = [], [], []
        for first in range(0, len(flights), together):
            some = flights[first : first + together]
            result = identified(*(one.log for one in some))
            for axis in range(2):
                # The best drag for the airspeeds flown differs a little from flight to flight.
                true, drag = np.mean([one.drag[axis] for one in some]), result.per_mass[axis]
                inside.append(drag.low <= true <= drag.high)
                widths.append(drag.half_width / true)
                for one, wind in zip(some, result.wind, strict=True):
                    if wind[axis].value is not None:
                        winds.append(wind[axis].low <= one.wind[axis] <= wind[axis].high)
        assert np.mean(inside) >= 0.9
        assert np.median(widths) < 0.2
        assert len(winds) >= 80
        assert np.mean(winds) >= 0.93
