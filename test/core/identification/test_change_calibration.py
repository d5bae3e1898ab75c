# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.identification.alarm_calibration import LeftOut, LiveErrors
from quadpi_core.identification.change_calibration import calibrate_change, evidence
from quadpi_core.identification.prepared_flights import LiveSamples
from quadpi_core.inputs import DERIVATIVES, INPUT_INDEX, INPUT_NAMES, aerodynamic_inputs
from quadpi_core.models.alarm_limits import CHANGE_AXES, ChangeLimits
from quadpi_core.models.envelope import MARGIN, Envelope
from quadpi_core.models.interval_rules import FlightErrors
from quadpi_core.models.model_kind import Evaluation
from quadpi_core.records import Records
from quadpi_core.vehicle import Vehicle
from test.core.monitor.sound_flights_of_blocks import limits_of, sound_blocks, weaken, weight

RATE_HZ = 50
VEHICLE = Vehicle.load("crazyflie_rpm")


@dataclass
class Flown:
    """A flight, all that the calibration asks for."""

    time: Array
    inputs: Array
    derivatives: Records
    wrench: Array
    judged: LiveSamples


def flown(seed: int, seconds: float = 30.0) -> tuple[Flown, LiveErrors]:
    """A flight in hover whose errors are those of sound blocks, the same all over each block."""
    rng = np.random.default_rng(seed)
    blocks = sound_blocks(VEHICLE, seconds, rng)
    count = round(seconds * RATE_HZ)
    time = np.arange(count) / RATE_HZ + 0.5 / RATE_HZ
    moving = np.zeros(count, DERIVATIVES)
    moving["rotor_speeds"] = rng.uniform(1400.0, 1600.0, (count, 4))
    level = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    speed = rng.normal(size=(count, 3))
    inputs = aerodynamic_inputs(speed, level, 0.0 * speed, moving["rotor_speeds"], VEHICLE)
    wrench = np.zeros((count, 6))
    error = np.repeat(blocks["residual"], RATE_HZ // 10, axis=0)
    wrench[:, 2] = error[:, 2] - weight(VEHICLE)
    judged = LiveSamples(inputs, moving, wrench, np.ones(count, bool))
    inside = np.ones(count, bool)
    errors = {axis: FlightErrors(error[:, AXES.index(axis)], np.ones(count), inside) for axis in CHANGE_AXES}
    return Flown(time, inputs, moving, wrench, judged), LiveErrors(np.arange(count), errors)


def evaluate(inputs: Array, moving: Records) -> Evaluation:
    """Thrust goes with squared rotor speeds; moments with 0.8 of the arms."""
    squares = np.square(moving["rotor_speeds"][:, :4])
    thrust = weight(VEHICLE) * squares / (4.0 * 1500.0**2)
    x, y = VEHICLE.rotor_positions[:, 0], VEHICLE.rotor_positions[:, 1]
    wrench = np.zeros((len(inputs), 6))
    wrench[:, 2], wrench[:, 3], wrench[:, 4] = -thrust.sum(axis=1), -0.8 * thrust @ y, 0.8 * thrust @ x
    return Evaluation(wrench, wrench - 1.0, wrench + 1.0, np.zeros_like(wrench), np.ones_like(wrench))


def calibrated(flown_ones: Sequence[Flown], live: Sequence[LiveErrors]) -> ChangeLimits | None:
    """What the calibration makes of flights."""
    nothing = np.zeros((0, 6))
    signals = [
        LeftOut(one.time, one.judged.inputs, *Envelope.flight_range(one.inputs), *3 * [nothing])
        for one in flown_ones
    ]
    margin = np.full(len(INPUT_NAMES), MARGIN)
    return calibrate_change(flown_ones, live, signals, margin, VEHICLE, evaluate)


@pytest.fixture(scope="module")
def flights() -> list[tuple[Flown, LiveErrors]]:
    return [flown(seed) for seed in range(10)]


def test_what_flights_leave_is_found_again(flights: list[tuple[Flown, LiveErrors]]) -> None:
    found = calibrated(*zip(*flights, strict=True))
    truth = limits_of(VEHICLE)
    assert found.flights == 10
    assert found.hours == pytest.approx(10 * 30.0 / 3600.0)
    for axis, left in found.axes.items():
        own = truth.axes[axis]
        assert left.process + left.white == pytest.approx(own.process + own.white, rel=0.35)
        assert left.keep == pytest.approx(own.keep, abs=0.15)
        # Upper ends of 50 %.
        assert 0.3 * own.walk < left.walk < 5.0 * own.walk
        assert left.between < 10.0 * own.between
        assert 0.5 < left.scale < 0.9
    ratios = [left.between / truth.axes[axis].between for axis, left in found.axes.items()]
    assert np.mean(ratios) > 0.5
    for (thrust, roll, pitch), (x, y, _) in zip(found.levers, VEHICLE.rotor_positions, strict=True):
        assert thrust == pytest.approx(1.0, abs=0.01)
        assert (roll, pitch) == (pytest.approx(0.8 * y, rel=0.02), pytest.approx(-0.8 * x, rel=0.02))


@pytest.mark.slow
def test_the_limits_hold_on_other_flights_and_find_a_weak_rotor(
    flights: list[tuple[Flown, LiveErrors]],
) -> None:
    found = calibrated(*zip(*flights, strict=True))
    rng = np.random.default_rng(77)
    others = [sound_blocks(VEHICLE, 30.0, rng) for _ in range(40)]
    assert sum(evidence(found, VEHICLE, blocks).max() >= found.evidence for blocks in others) <= 4
    for blocks in others[:10]:
        weaken(blocks, VEHICLE, 1, 0.06, 100)
        assert evidence(found, VEHICLE, blocks).max() >= found.evidence


def test_few_flights_and_models_without_fz_tell_nothing(flights: list[tuple[Flown, LiveErrors]]) -> None:
    flown_ones, live = zip(*flights, strict=True)
    assert calibrated(flown_ones[:7], live[:7]) is None
    assert calibrated([], []) is None
    without = [LiveErrors(one.rows, {"Fx": one.errors["Fx"]}) for one in live]
    assert calibrated(flown_ones, without) is None


@pytest.mark.slow
def test_samples_count_as_they_do_in_flight(flights: list[tuple[Flown, LiveErrors]]) -> None:
    flown_ones, live = zip(*flights, strict=True)
    hours = calibrated(flown_ones, live).hours
    for name, counts in (("omega_avg", True), ("u", False)):
        # The first third of a flight is farther out than any other flight.
        far = [
            replace(one, judged=one.judged._replace(inputs=one.judged.inputs.copy())) for one in flown_ones
        ]
        far[0].judged.inputs[: len(far[0].time) // 3, INPUT_INDEX[name]] *= 10.0
        of_all = calibrated(far, live).hours
        assert of_all == pytest.approx(hours if counts else hours - 10.0 / 3600.0, rel=0.01)
