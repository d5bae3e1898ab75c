# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from quadpi_core.errors import QuadpiError
from quadpi_core.inputs import INPUT_INDEX, INPUT_NAMES
from quadpi_core.monitor.alarm import (
    BAD_DATA,
    EXTRAPOLATION,
    LEVEL_ALARM,
    LEVEL_OK,
    LEVEL_WARNING,
    Alarm,
    MonitorSettings,
)
from quadpi_core.monitor.envelope import Envelope
from quadpi_core.monitor.output import Alarms

RATE_HZ = 500
STEP_NS = 1_000_000_000 // RATE_HZ
SETTINGS = MonitorSettings(persistence_s=0.1, release_s=0.5, alarm_rate_hz=10.0)
U, Q = INPUT_INDEX["u"], INPUT_INDEX["q"]
FX, MY = 0, 4


@pytest.fixture
def envelope() -> Envelope:
    inputs = len(INPUT_NAMES)
    return Envelope(
        lower=np.full(inputs, -1.0),
        upper=np.full(inputs, 1.0),
        margin=np.full(inputs, 0.1),
        leverage_limit=np.full(6, 0.02),
        width_limit=np.full(6, 1.5),
    )


class Samples:
    """Samples well inside the envelope, to be disturbed by a test."""

    def __init__(self, seconds: float) -> None:
        count = round(seconds * RATE_HZ)
        self.time_ns = 1_000_000_000 + STEP_NS * np.arange(count, dtype=np.int64)
        self.usable = np.ones(count, dtype=np.bool_)
        self.inputs = np.zeros((count, len(INPUT_NAMES)))
        self.leverage = np.full((count, 6), 0.005)
        self.width = np.ones((count, 6))

    def between(self, start_s: float, stop_s: float) -> slice:
        return slice(round(start_s * RATE_HZ), round(stop_s * RATE_HZ))

    def run(self, alarm: Alarm, block: int | None = None) -> Alarms:
        block = block or len(self.time_ns)
        parts = []
        for start in range(0, len(self.time_ns), block):
            keep = slice(start, start + block)
            used = self.usable[keep]
            parts.append(
                alarm.step(
                    self.time_ns[keep],
                    used,
                    self.inputs[keep][used],
                    self.leverage[keep][used],
                    self.width[keep][used],
                )
            )
        return Alarms(
            **{
                field.name: np.concatenate([getattr(part, field.name) for part in parts])
                for field in fields(Alarms)
            }
        )


def changes(rows: Alarms) -> list[tuple[float, int, int]]:
    """(seconds since the first sample, level, causes) where the published state changes."""
    state = np.stack((rows.level, rows.causes), axis=1)
    new = np.r_[True, np.any(np.diff(state.astype(int), axis=0) != 0, axis=1)]
    seconds = (rows.time_ns - 1_000_000_000) * 1e-9
    return [
        (round(float(seconds[i]), 6), int(rows.level[i]), int(rows.causes[i])) for i in np.flatnonzero(new)
    ]


def test_step_out_and_back_is_raised_cleared_and_named(envelope):
    samples = Samples(3.0)
    samples.inputs[samples.between(1.0, 2.0), U] = 1.8
    rows = samples.run(Alarm(envelope, SETTINGS))

    # The sample at 1.0 s stands for the 2 ms before it: 25 samples make half of the persistence, 50 all.
    assert changes(rows) == [
        (0.0, LEVEL_OK, 0),
        (1.048, LEVEL_WARNING, EXTRAPOLATION),
        (1.098, LEVEL_ALARM, EXTRAPOLATION),
        (2.498, LEVEL_OK, 0),
    ]
    raised = int(np.argmax(rows.level == LEVEL_ALARM))
    assert np.flatnonzero(rows.input_excess[raised]).tolist() == [U]
    assert rows.input_excess[raised, U] == pytest.approx(0.4)


@pytest.mark.parametrize("evidence", ["leverage", "width"])
def test_one_axis_is_enough(envelope, evidence):
    samples = Samples(1.0)
    beyond = {"leverage": 0.03, "width": 1.8}[evidence]
    getattr(samples, evidence)[samples.between(0.5, 1.0), MY] = beyond
    rows = samples.run(Alarm(envelope, SETTINGS))
    assert rows.level[-1] == LEVEL_ALARM
    limit = {"leverage": 0.02, "width": 1.5}[evidence]
    assert getattr(rows, evidence)[-1, MY] == pytest.approx(beyond / limit)
    assert getattr(rows, evidence)[-1, FX] < 1.0


def test_inside_the_margin_is_no_evidence_but_is_shown(envelope):
    samples = Samples(1.0)
    samples.inputs[:, U] = 1.15
    rows = samples.run(Alarm(envelope, SETTINGS))
    assert np.all(rows.level == LEVEL_OK)
    np.testing.assert_allclose(rows.input_excess[:, U], 0.075)


def test_single_samples_change_nothing(envelope):
    samples = Samples(4.0)
    samples.inputs[samples.between(0.0, 1.0), U][::20] = 1.8
    samples.inputs[samples.between(1.0, 4.0), U] = 1.8
    samples.inputs[samples.between(2.0, 4.0), U][::20] = 0.0
    samples.inputs[:100:20, U] = 1.8
    rows = samples.run(Alarm(envelope, SETTINGS))
    assert [level for _, level, _ in changes(rows)] == [LEVEL_OK, LEVEL_WARNING, LEVEL_ALARM]


def test_noise_about_the_limit_does_not_chatter(envelope):
    rng = np.random.default_rng(3)
    samples = Samples(60.0)
    samples.inputs[:, U] = 1.2 + 0.3 * rng.standard_normal(len(samples.inputs))
    rows = samples.run(Alarm(envelope, SETTINGS))
    assert [level for _, level, _ in changes(rows)] == [LEVEL_OK, LEVEL_WARNING, LEVEL_ALARM]


def test_rows_come_at_the_steady_rate(envelope):
    rows = Samples(10.0).run(Alarm(envelope, SETTINGS))
    assert len(rows.time_ns) == 100
    assert np.all(np.diff(rows.time_ns) == 100_000_000)


def test_rows_stay_few_whatever_happens(envelope):
    rng = np.random.default_rng(4)
    samples = Samples(20.0)
    samples.inputs[:] = rng.normal(0.0, 2.0, samples.inputs.shape)
    samples.usable = rng.random(len(samples.usable)) > 0.1
    rows = samples.run(Alarm(envelope, SETTINGS))
    assert len(changes(rows)) < 6
    assert len(rows.time_ns) <= 20 * SETTINGS.alarm_rate_hz + len(changes(rows)) + len(INPUT_NAMES)


def test_an_input_that_joins_is_told_at_once(envelope):
    samples = Samples(2.0)
    samples.inputs[samples.between(0.5, 2.0), U] = 1.8
    samples.inputs[samples.between(1.35, 2.0), Q] = -3.0
    rows = samples.run(Alarm(envelope, SETTINGS))
    told = np.flatnonzero(rows.input_excess[:, Q] > 0.0)
    assert rows.time_ns[told[0]] - 1_000_000_000 == 1_350_000_000
    assert np.all(rows.input_excess[told, Q] == 1.0)


def test_short_evidence_between_two_rows_is_not_lost(envelope):
    samples = Samples(1.0)
    samples.inputs[samples.between(0.51, 0.52), Q] = 2.0
    rows = samples.run(Alarm(envelope, SETTINGS))
    assert np.count_nonzero(rows.input_excess[:, Q]) == 1


def test_samples_that_cannot_be_judged(envelope):
    samples = Samples(3.0)
    samples.usable[samples.between(1.0, 1.002)] = False
    samples.usable[samples.between(2.0, 2.3)] = False
    rows = samples.run(Alarm(envelope, SETTINGS))
    assert changes(rows) == [
        (0.0, LEVEL_OK, 0),
        (1.0, LEVEL_WARNING, BAD_DATA),
        (1.26, LEVEL_OK, 0),
        (2.0, LEVEL_WARNING, BAD_DATA),
        (2.048, LEVEL_ALARM, BAD_DATA),
        (2.798, LEVEL_OK, 0),
    ]


def test_bad_data_does_not_clear_extrapolation(envelope):
    samples = Samples(2.0)
    samples.inputs[samples.between(0.5, 1.0), U] = 1.8
    samples.usable[samples.between(1.0, 2.0)] = False
    rows = samples.run(Alarm(envelope, SETTINGS))
    assert rows.causes[-1] == EXTRAPOLATION | BAD_DATA


def test_a_gap_is_not_counted_as_evidence(envelope):
    samples = Samples(1.0)
    samples.inputs[samples.between(0.5, 0.52), U] = 1.8
    samples.time_ns[samples.between(0.504, 1.0)] += 5_000_000_000
    rows = samples.run(Alarm(envelope, SETTINGS))
    assert LEVEL_ALARM not in rows.level


def test_stamps_that_run_backward_do_no_harm(envelope):
    samples = Samples(2.0)
    samples.time_ns[samples.between(1.0, 2.0)] -= 900_000_000
    samples.inputs[samples.between(1.0, 2.0), U] = 1.8
    rows = samples.run(Alarm(envelope, SETTINGS))
    assert rows.level[-1] == LEVEL_ALARM


@pytest.mark.parametrize("seed", range(5))
def test_blocks_give_the_same_rows(envelope, seed):
    rng = np.random.default_rng(seed)
    samples = Samples(3.0)
    outside = np.repeat(rng.random(60) < 0.4, len(samples.inputs) // 60)
    samples.inputs[:] = rng.normal(0.0, 0.3, samples.inputs.shape) + 1.5 * outside[:, None]
    samples.usable = rng.random(len(samples.usable)) > 0.01
    whole = samples.run(Alarm(envelope, SETTINGS))
    assert LEVEL_ALARM in whole.level
    for block in (1, 7, 100):
        parts = samples.run(Alarm(envelope, SETTINGS), block)
        for field in fields(Alarms):
            np.testing.assert_array_equal(getattr(parts, field.name), getattr(whole, field.name))


@pytest.mark.parametrize("seed", range(5))
def test_more_evidence_never_lowers_the_level(envelope, seed):
    rng = np.random.default_rng(seed)
    less, more = Samples(4.0), Samples(4.0)
    outside = np.repeat(rng.random(200) < 0.2, len(less.inputs) // 200)
    less.inputs[outside, U] = 2.0
    outside |= np.repeat(rng.random(200) < 0.2, len(less.inputs) // 200)
    more.inputs[outside, U] = 2.0
    levels = []
    for samples in (less, more):
        alarm = Alarm(envelope, MonitorSettings(alarm_rate_hz=RATE_HZ))
        levels.append(samples.run(alarm).level)
    # A warning needs half a charge on the way up only, so alarms alone are ordered.
    assert np.all((levels[0] != LEVEL_ALARM) | (levels[1] == LEVEL_ALARM))


def test_reset_forgets(envelope):
    samples = Samples(1.0)
    samples.inputs[:, U] = 1.8
    alarm = Alarm(envelope, SETTINGS)
    first = samples.run(alarm)
    alarm.reset()
    again = samples.run(alarm)
    for field in fields(Alarms):
        np.testing.assert_array_equal(getattr(again, field.name), getattr(first, field.name))


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_settings_must_be_positive(value):
    with pytest.raises(QuadpiError, match="release_s must be positive"):
        MonitorSettings(release_s=value)
