# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Levels and rows of the alarm, raised by extrapolation and by data that cannot be used."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from quadpi_core.errors import QuadpiError
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.monitor.alarm import Alarm, MonitorSettings
from quadpi_core.monitor.alarm_log import reasons
from quadpi_core.results import BAD_DATA, CAUSES, EXTRAPOLATION, LEVEL_ALARM, LEVEL_OK, LEVEL_WARNING, Alarms
from test.core.monitor.alarm_samples import FX, FZ, LIMITS, MY, RATE_HZ, SETTINGS, Q, Samples, U, changes


def test_step_out_and_back_is_raised_cleared_and_named(envelope):
    samples = Samples(3.0)
    samples.inputs[samples.between(1.0, 2.0), U] = 1.8
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))

    # The sample at 1.0 s stands for the 2 ms before it: 50 samples make the persistence.
    assert changes(rows) == [(0.0, LEVEL_OK, 0), (1.098, LEVEL_ALARM, EXTRAPOLATION), (2.498, LEVEL_OK, 0)]
    raised = int(np.argmax(rows.level == LEVEL_ALARM))
    assert np.flatnonzero(rows.input_excess[raised]).tolist() == [U]
    assert rows.input_excess[raised, U] == pytest.approx(0.4)


def test_leaving_what_was_flown_is_a_warning_and_straying_further_than_ever_an_alarm(calibrated):
    samples = Samples(5.0)
    samples.inputs[samples.between(1.0, 4.0), U] = 1.4
    samples.inputs[samples.between(2.0, 3.0), U] = 2.1
    rows = samples.run(Alarm(calibrated, LIMITS, SETTINGS))
    assert changes(rows) == [
        (0.0, LEVEL_OK, 0),
        (1.098, LEVEL_WARNING, EXTRAPOLATION),
        (2.098, LEVEL_ALARM, EXTRAPOLATION),
        (3.498, LEVEL_WARNING, EXTRAPOLATION),
        (4.498, LEVEL_OK, 0),
    ]
    warned = int(np.argmax(rows.level == LEVEL_WARNING))
    assert reasons(rows, warned) == ("forward or backward speed 1.4 x the training range",)
    assert rows.cause_evidence[warned, 0] == pytest.approx(1.4 / 2.0)


@pytest.mark.parametrize(
    ("evidence", "value", "words"),
    [
        ("leverage", 0.03, "pitch moment: leverage 3.0 x its peak in training"),
        ("width", 1.8, "pitch moment: interval 1.5 x its widest"),
    ],
)
def test_leverage_and_width_warn_and_are_named_before_they_alarm(calibrated, evidence, value, words):
    samples = Samples(2.0)
    getattr(samples, evidence)[samples.between(1.0, 2.0), MY] = value
    rows = samples.run(Alarm(calibrated, LIMITS, SETTINGS))
    assert changes(rows) == [(0.0, LEVEL_OK, 0), (1.098, LEVEL_WARNING, EXTRAPOLATION)]
    assert len(reasons(rows, len(rows) - 1)) == 1
    assert reasons(rows, len(rows) - 1)[0].startswith(words)


@pytest.mark.parametrize("nearer", [0.02, 0.1, 0.5])
@pytest.mark.parametrize("seed", range(3))
def test_a_warning_stands_where_an_alarm_by_the_near_limits_would(envelope, nearer, seed):
    rng = np.random.default_rng(seed)
    samples = Samples(20.0)
    samples.inputs[:, U] = np.repeat(rng.uniform(0.8, 2.5, 100), len(samples.inputs) // 100)
    limits = replace(envelope, margin=np.full(len(INPUT_NAMES), nearer))
    settings = MonitorSettings(alarm_rate_hz=RATE_HZ)
    level = samples.run(Alarm(limits, LIMITS, settings)).level
    warning = samples.run(Alarm(limits.near, LIMITS, settings)).level
    assert LEVEL_ALARM in level
    assert np.all((level == LEVEL_OK) == (warning == LEVEL_OK))


@pytest.mark.parametrize(
    ("limits", "noise", "level"), [("calibrated", 0.2, LEVEL_WARNING), ("envelope", 0.3, LEVEL_ALARM)]
)
def test_noise_about_a_limit_does_not_chatter(request, limits, noise, level):
    rng = np.random.default_rng(3)
    samples = Samples(60.0)
    samples.inputs[:, U] = 1.2 + noise * rng.standard_normal(len(samples.inputs))
    rows = samples.run(Alarm(request.getfixturevalue(limits), LIMITS, SETTINGS))
    assert [own for _, own, _ in changes(rows)] == [LEVEL_OK, level]


@pytest.mark.parametrize("evidence", ["leverage", "width"])
def test_one_axis_is_enough(envelope, evidence):
    samples = Samples(1.0)
    beyond = {"leverage": 0.03, "width": 1.8}[evidence]
    getattr(samples, evidence)[samples.between(0.5, 1.0), MY] = beyond
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    assert rows.level[-1] == LEVEL_ALARM
    limit = {"leverage": 0.02, "width": 1.5}[evidence]
    assert getattr(rows, evidence)[-1, MY] == pytest.approx(beyond / limit)
    assert getattr(rows, evidence)[-1, FX] < 1.0


@pytest.mark.parametrize(("measured", "level"), [(-10.0, LEVEL_ALARM), (-2.5, LEVEL_OK)])
def test_rotors_that_turn_fast_for_a_load_are_no_extrapolation(envelope, measured, level):
    """Where they give less thrust than they should, the vehicle is heavier and flies as in training."""
    samples = Samples(1.0)
    samples.inputs[:, INPUT_NAMES.index("omega_avg")] = 1.8
    samples.predicted[:, FZ], samples.measured[:, FZ] = -10.0, measured
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    assert rows.cause_level[-1, CAUSES.index(EXTRAPOLATION)] == level


def test_inside_the_margin_is_no_evidence_but_is_shown(envelope):
    samples = Samples(1.0)
    samples.inputs[:, U] = 1.15
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    assert np.all(rows.level == LEVEL_OK)
    np.testing.assert_allclose(rows.input_excess[:, U], 0.075)


def test_single_samples_change_nothing(envelope):
    samples = Samples(4.0)
    samples.inputs[samples.between(0.0, 1.0), U][::20] = 1.8
    samples.inputs[samples.between(1.0, 4.0), U] = 1.8
    samples.inputs[samples.between(2.0, 4.0), U][::20] = 0.0
    samples.inputs[:100:20, U] = 1.8
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    assert [level for _, level, _ in changes(rows)] == [LEVEL_OK, LEVEL_ALARM]


def test_rows_come_at_the_steady_rate(envelope):
    rows = Samples(10.0).run(Alarm(envelope, LIMITS, SETTINGS))
    assert len(rows.time_ns) == 100
    assert np.all(np.diff(rows.time_ns) == 100_000_000)


def test_rows_stay_few_whatever_happens(envelope):
    rng = np.random.default_rng(4)
    samples = Samples(20.0)
    samples.inputs[:] = rng.normal(0.0, 2.0, samples.inputs.shape)
    samples.usable = rng.random(len(samples.usable)) > 0.1
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    assert len(changes(rows)) < 6
    assert len(rows.time_ns) <= 20 * SETTINGS.alarm_rate_hz + len(changes(rows)) + len(INPUT_NAMES)


def test_an_input_that_joins_is_told_at_once(envelope):
    samples = Samples(2.0)
    samples.inputs[samples.between(0.5, 2.0), U] = 1.8
    samples.inputs[samples.between(1.35, 2.0), Q] = -3.0
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    told = np.flatnonzero(rows.input_excess[:, Q] > 0.0)
    assert rows.time_ns[told[0]] - 1_000_000_000 == 1_350_000_000
    assert np.all(rows.input_excess[told, Q] == 1.0)


def test_short_evidence_between_two_rows_is_not_lost(envelope):
    samples = Samples(1.0)
    samples.inputs[samples.between(0.51, 0.52), Q] = 2.0
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    assert np.count_nonzero(rows.input_excess[:, Q]) == 1


def test_samples_that_cannot_be_judged(envelope):
    samples = Samples(3.0)
    samples.usable[samples.between(1.0, 1.002)] = False
    samples.usable[samples.between(2.0, 2.3)] = False
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
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
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    assert rows.causes[-1] == EXTRAPOLATION | BAD_DATA


def test_a_gap_is_not_counted_as_evidence(envelope):
    samples = Samples(1.0)
    samples.inputs[samples.between(0.5, 0.52), U] = 1.8
    samples.time_ns[samples.between(0.504, 1.0)] += 5_000_000_000
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    assert LEVEL_ALARM not in rows.level


def test_stamps_that_run_backward_do_no_harm(envelope):
    samples = Samples(2.0)
    samples.time_ns[samples.between(1.0, 2.0)] -= 900_000_000
    samples.inputs[samples.between(1.0, 2.0), U] = 1.8
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    assert rows.level[-1] == LEVEL_ALARM


@pytest.mark.parametrize("seed", range(5))
def test_blocks_give_the_same_rows(calibrated, seed):
    rng = np.random.default_rng(seed)
    samples = Samples(3.0)
    outside = np.repeat(rng.random(60) < 0.4, len(samples.inputs) // 60)
    samples.inputs[:] = rng.normal(0.0, 0.3, samples.inputs.shape) + 1.5 * outside[:, None]
    samples.usable = rng.random(len(samples.usable)) > 0.01
    whole = samples.run(Alarm(calibrated, LIMITS, SETTINGS))
    assert LEVEL_ALARM in whole.level
    for block in (1, 7, 100):
        parts = samples.run(Alarm(calibrated, LIMITS, SETTINGS), block)
        for field in fields(Alarms):
            np.testing.assert_array_equal(getattr(parts, field.name), getattr(whole, field.name))


@pytest.mark.parametrize("seed", range(5))
def test_more_evidence_never_lowers_the_level(calibrated, seed):
    rng = np.random.default_rng(seed)
    less, more = Samples(4.0), Samples(4.0)
    less.inputs[:, U] = np.repeat(rng.uniform(0.0, 2.5, 20), len(less.inputs) // 20)
    more.inputs[:, U] = less.inputs[:, U] + np.repeat(rng.uniform(0.0, 0.6, 20), len(less.inputs) // 20)
    levels = []
    for samples in (less, more):
        alarm = Alarm(calibrated, LIMITS, MonitorSettings(alarm_rate_hz=RATE_HZ))
        levels.append(samples.run(alarm).level)
    assert set(levels[0]) == {LEVEL_OK, LEVEL_WARNING, LEVEL_ALARM}
    assert np.all(levels[0] <= levels[1])


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_settings_must_be_positive(value):
    with pytest.raises(QuadpiError, match="release_s: expected a positive number"):
        MonitorSettings(release_s=value)
