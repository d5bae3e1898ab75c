# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.evaluation.alarm_assessment import Constant, differences, flight_constants
from quadpi_core.frames import Array
from quadpi_core.vehicle import Vehicle

from ..monitor.sound_flights_of_blocks import limits_of, sound_blocks, weight

VEHICLE = Vehicle.load("crazyflie_rpm")
LIMITS = limits_of(VEHICLE)


def constants_of(seed: int, push: float) -> dict[str, Constant]:
    """Of a flight with a constant force to the right, N."""
    blocks = sound_blocks(VEHICLE, 20.0, np.random.default_rng(seed))
    errors: Array = np.repeat(blocks["residual"], 10, axis=0)
    errors[:, 1] += push
    return flight_constants(LIMITS, 0.01 * np.arange(len(errors)) + 0.005, errors)


def test_constants_are_found_within_their_deviations() -> None:
    push, own = 0.03 * weight(VEHICLE), LIMITS.axes["Fy"]
    found = [constants_of(seed, push)["Fy"] for seed in range(40)]
    unsure = [np.sqrt(one.deviation**2 + own.between) for one in found]
    assert 0.5 < np.std([(one.value - push) / of for one, of in zip(found, unsure, strict=True)]) < 1.6


def test_flights_that_differ_are_named() -> None:
    push = 0.1 * weight(VEHICLE)
    flights = {f"flight{seed}": constants_of(seed, push if seed in {2, 5} else 0.0) for seed in range(7)}
    (told,) = differences(flights)
    assert told.startswith("flight2, flight5: ")
    assert told.endswith("mN more force to the right than the others")
    assert 1e-3 * float(told.split()[2]) == pytest.approx(push, rel=0.2)
    assert not list(differences({name: flights[name] for name in ("flight0", "flight2")}))


@pytest.mark.parametrize(
    ("push", "deviation", "said"),
    [(0.1234, 0.01, "123 ± 5 mN"), (1.234, 0.1, "1230 ± 50 mN"), (0.0123, 0.0, "12.3 ± 0.001 mN")],
)
def test_sizes_are_told_to_the_first_digit_that_is_not_sure(push: float, deviation: float, said: str) -> None:
    deviations = {"a": deviation, "b": deviation, "c": 0.0, "d": 0.0}
    flights = {name: {"Fy": Constant(push if name == "c" else 0.0, one)} for name, one in deviations.items()}
    (told,) = differences(flights)
    assert told == f"c: {said} more force to the right than the others"


def test_flights_alike_and_short_ones_tell_nothing() -> None:
    assert not list(differences({f"flight{seed}": constants_of(seed, 0.0) for seed in range(7)}))
    assert flight_constants(LIMITS, np.arange(5.0) / 100, np.zeros((5, 6))) == {}
