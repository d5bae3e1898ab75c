# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Density of the air by what logs and topics tell, and what is left open where they tell nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.flight import AirStream, ImuStream, Recording, TemperatureStream
from quadpi_core.inputs import (
    ASSUMED,
    BOARD,
    MEASURED,
    NOTICED,
    STANDARD_DENSITY,
    Air,
    density_of,
    density_range,
    flown_in,
)

IMU = ImuStream(np.arange(10) * 10**7, np.zeros((10, 3)), np.zeros((10, 3)))
PLAIN = Recording("flight", "bebop2", "flight.mcap", IMU)


def air(*rows: tuple[int, float, float]) -> AirStream:
    time_ns, pressure, celsius = zip(*rows, strict=True)
    return AirStream(np.array(time_ns) * 10**7, np.array(pressure), np.array(celsius))


def test_density_of_the_standard_atmosphere() -> None:
    assert density_of(np.array([101325.0]), np.array([15.0])) == pytest.approx(STANDARD_DENSITY, abs=1e-3)


def test_a_flight_has_the_median_of_both_and_none_of_one_alone() -> None:
    assert flown_in(PLAIN) is None
    pressure = air((0, 90000.0, np.nan), (1, 90000.0, np.nan), (2, 5.0, np.nan))
    assert flown_in(replace(PLAIN, pressure=pressure)) is None
    warm = TemperatureStream(np.array([0]), np.array([np.nan]), np.array([25.0]))
    density, told_by = flown_in(replace(PLAIN, pressure=pressure, temperature=warm))
    assert density == pytest.approx(90000.0 / (287.053 * 298.15))
    assert told_by == MEASURED
    both = air((0, 90000.0, 25.0))
    assert flown_in(replace(PLAIN, pressure=both, board_air=True)) == (density, BOARD)
    # In hPa, in K, or of a dead sensor.
    for wrong in ((900.0, 25.0), (90000.0, 298.15), (0.0, -300.0)):
        assert flown_in(replace(PLAIN, pressure=air((0, *wrong)))) is None


def test_density_follows_both_in_steps() -> None:
    now = Air()
    assert not now.hear(101325.0, np.nan)
    assert now.density == 0.0
    assert now.hear(np.nan, 15.0)
    assert now.density == pytest.approx(STANDARD_DENSITY, abs=1e-3)
    before = now.density
    assert not now.hear(101325.0 * (1.0 + 0.9 * NOTICED.value), np.nan)
    assert now.density == before
    assert now.hear(101325.0 * (1.0 + 1.1 * NOTICED.value), np.nan)
    for nonsense in (0.0, -5.0, 1e9):
        assert not now.hear(nonsense, np.nan)
    for nonsense in (-300.0, 293.15):
        assert not now.hear(np.nan, nonsense)
    # One wrong number does not keep the sensor from being heard.
    assert now.hear(90000.0, np.nan)
    assert now.density == pytest.approx(float(density_of(np.array(90000.0), np.array(15.0))))


def test_changes_are_told_by_the_imu_samples_that_arrived_before() -> None:
    block = replace(PLAIN, pressure=air((2, 101325.0, 15.0), (5, 101330.0, 15.0), (8, 90000.0, 15.0)))
    changes = list(Air().changes(block))
    assert [count for count, _ in changes] == [3, 9]
    assert changes[1][1] / changes[0][1] == pytest.approx(90000.0 / 101325.0)


@pytest.mark.parametrize(
    ("told_by", "file_density", "expected"),
    [
        (MEASURED, STANDARD_DENSITY, (1.0, 1.0)),
        (BOARD, STANDARD_DENSITY, (1.0, 1.1)),
        (ASSUMED, STANDARD_DENSITY, (0.62, 1.15)),
        (ASSUMED, 1.1, (0.95, 1.05)),
    ],
)
def test_what_is_left_open(told_by: str, file_density: float, expected: tuple[float, float]) -> None:
    assert density_range(told_by, file_density) == expected


def test_a_temperature_told_alone_counts_before_that_of_a_barometer() -> None:
    board, outside = (
        air((0, 95000.0, 45.0)),
        TemperatureStream(np.array([5]), np.array([np.nan]), np.array([15.0])),
    )
    density, _ = flown_in(replace(PLAIN, pressure=board, temperature=outside))
    assert density == pytest.approx(density_of(95000.0, 15.0))
    now = Air()
    assert now.hear(95000.0, 45.0)
    assert now.hear(np.nan, 15.0)
    assert now.density == pytest.approx(density)
    assert not now.hear(95000.0, 45.0)
    assert now.density == pytest.approx(density)
