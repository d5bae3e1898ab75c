# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The exponent of thrust over command, and the thrust of hover, of flights by a formula."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from quadpi_core.field.airborne import flown
from quadpi_core.field.estimates import Estimate
from quadpi_core.field.field_log import FieldLog, Series
from quadpi_core.field.motor_use import MotorUse, ThrustCurve, motor_use, thrust_curve

from .field_examples import HOVER, example


def curve_of(*logs: FieldLog) -> ThrustCurve:
    return thrust_curve([(log, motor_use(log, flown(log))) for log in logs])


def with_exponent(exponent: float, **changes: Any) -> FieldLog:
    """The example with thrust by another curve through the same hover, which it stands in at times."""
    log = example(**changes)
    u = log.commands.at(log.imu.time)

    def curve(command: Any) -> Any:
        return exponent * command**2 + (1.0 - exponent) * command

    values = log.imu.values.copy()
    aloft = u.mean(axis=1) > 0.2
    values[aloft, 5] = -9.80665 * curve(u[aloft]).mean(axis=1) / curve(HOVER)
    values[:, 5] += np.random.default_rng(0).normal(0.0, 0.1, len(values))
    return replace(log, imu=Series(log.imu.time, values))


@pytest.mark.parametrize("exponent", [0.3, 0.65, 1.0])
def test_the_exponent_of_a_curve(exponent: float) -> None:
    found = curve_of(with_exponent(exponent))
    assert found.exponent.low - 0.05 <= exponent <= found.exponent.high + 0.05
    assert found.exponent.value == pytest.approx(exponent, abs=0.1)
    hover = exponent * HOVER**2 + (1.0 - exponent) * HOVER
    assert found.hover.value == pytest.approx(hover, rel=0.1)
    assert found.hover.low < hover * 1.02
    assert found.hover.high > hover * 0.98


def test_flights_are_held_together_by_an_interval_of_all() -> None:
    logs = [with_exponent(0.6, seed=seed) for seed in (1, 2)]
    together, apart = curve_of(*logs).exponent, [curve_of(log).exponent for log in logs]
    assert (together.low, together.high) == (min(one.low for one in apart), max(one.high for one in apart))


def test_spin_limits_of_ardupilot_are_the_range_of_the_curve() -> None:
    log = with_exponent(1.0)
    limits = {"MOT_SPIN_MIN": 0.1, "MOT_SPIN_MAX": 0.9, "MOT_THST_EXPO": 0.5}
    found = curve_of(replace(log, parameters=limits))
    u = (HOVER - 0.1) / 0.8
    slope = 2.0 * u * 0.8 / HOVER
    assert found.exponent.value == pytest.approx((slope - 1.0) / (slope * (1.0 - u) + 2.0 * u - 1.0), abs=0.1)


def test_commands_before_a_curve_of_px4_tell_none() -> None:
    found = curve_of(replace(with_exponent(0.6), parameters={"THR_MDL_FAC": 0.3}))
    assert found.exponent.value is None
    assert "before the present THR_MDL_FAC, 0.3" in found.exponent.reason
    assert found.hover.value is not None
    assert found.hover.reason == "with THR_MDL_FAC 0.3 as it is"


def test_no_commands_and_impossible_slopes_tell_nothing() -> None:
    assert "no hover" in curve_of(example(commands=None)).exponent.reason
    hover = Estimate(0.5, 0.49, 0.51)
    steep = MotorUse(hover=hover, thrust_gain=Estimate(0.1, 0.05, 0.15))
    assert "disturbance" in thrust_curve([(example(), steep)]).exponent.reason
    wide = MotorUse(hover=hover, thrust_gain=Estimate(3.0, 2.0, 4.0))
    assert "too wide" in thrust_curve([(example(), wide)]).exponent.reason
