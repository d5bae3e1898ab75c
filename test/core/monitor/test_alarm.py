# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from quadpi_core.errors import QuadpiError
from quadpi_core.inputs import INPUT_INDEX, INPUT_NAMES
from quadpi_core.models.alarm_limits import AlarmLimits
from quadpi_core.models.envelope import Envelope
from quadpi_core.monitor.alarm import (
    BAD_DATA,
    EXTRAPOLATION,
    LEVEL_ALARM,
    LEVEL_OK,
    LEVEL_WARNING,
    MISCOVERAGE,
    UNAVAILABLE,
    UNCALIBRATED,
    WAITING,
    Alarm,
    Judged,
    MonitorSettings,
)
from quadpi_core.monitor.events import KEPT, EventLog
from quadpi_core.monitor.faults import GYRO_FROZEN, ROTOR_HALF, STAMP_REPEATED
from quadpi_core.monitor.output import Alarms
from quadpi_core.monitor.reasons import reasons

RATE_HZ = 500
STEP_NS = 1_000_000_000 // RATE_HZ
SETTINGS = MonitorSettings(persistence_s=0.1, release_s=0.5, alarm_rate_hz=10.0)
U, Q, OMEGA = INPUT_INDEX["u"], INPUT_INDEX["q"], INPUT_INDEX["omega_avg"]
ALLOWANCE = 0.128
LIMITS = AlarmLimits(ALLOWANCE, np.full(6, 1.0), flights=20, hours=0.5)
FX, MY = 0, 4


@pytest.fixture
def envelope() -> Envelope:
    inputs = len(INPUT_NAMES)
    return Envelope(
        lower=np.full(inputs, -1.0),
        upper=np.full(inputs, 1.0),
        margin=np.full(inputs, 0.1),
        leverage_peak=np.full(6, 0.01),
        width_peak=np.full(6, 1.2),
        leverage_limit=np.full(6, 0.02),
        width_limit=np.full(6, 1.5),
    )


@pytest.fixture
def calibrated(envelope: Envelope) -> Envelope:
    """Limits of the alarm at twice the range, 8 times the leverage and 2 times the width of training."""
    return replace(
        envelope,
        margin=np.full(len(INPUT_NAMES), 0.5),
        leverage_limit=8.0 * envelope.leverage_peak,
        width_limit=2.0 * envelope.width_peak,
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
        self.velocity = np.zeros((count, 3))
        self.measured = np.zeros((count, 6))
        self.faults = np.zeros(count, dtype=np.int64)

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
                    self.faults[keep],
                    Judged(
                        self.inputs[keep][used],
                        self.velocity[keep][used],
                        self.leverage[keep][used],
                        self.width[keep][used],
                        self.measured[keep][used],
                        np.full((np.count_nonzero(used), 6), -1.0),
                        np.full((np.count_nonzero(used), 6), 1.0),
                    ),
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
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))

    # The sample at 1.0 s stands for the 2 ms before it: 50 samples make the persistence.
    assert changes(rows) == [
        (0.0, LEVEL_OK, 0),
        (1.098, LEVEL_ALARM, EXTRAPOLATION),
        (2.498, LEVEL_OK, 0),
    ]
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
    assert reasons(rows, warned) == ("u 1.4 x the training range",)
    assert rows.cause_evidence[warned, 0] == pytest.approx(1.4 / 2.0)


@pytest.mark.parametrize(
    ("evidence", "value", "words"),
    [("leverage", 0.03, "My leverage 3.0 x its peak in training"), ("width", 1.8, "My width 1.5 x its peak")],
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


def test_noise_about_the_limit_of_the_warning_does_not_chatter(calibrated):
    rng = np.random.default_rng(3)
    samples = Samples(60.0)
    samples.inputs[:, U] = 1.2 + 0.2 * rng.standard_normal(len(samples.inputs))
    rows = samples.run(Alarm(calibrated, LIMITS, SETTINGS))
    assert [level for _, level, _ in changes(rows)] == [LEVEL_OK, LEVEL_WARNING]


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


def test_noise_about_the_limit_does_not_chatter(envelope):
    rng = np.random.default_rng(3)
    samples = Samples(60.0)
    samples.inputs[:, U] = 1.2 + 0.3 * rng.standard_normal(len(samples.inputs))
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


def test_reset_forgets(envelope):
    samples = Samples(1.0)
    samples.inputs[:, U] = 1.8
    alarm = Alarm(envelope, LIMITS, SETTINGS)
    first = samples.run(alarm)
    alarm.reset()
    again = samples.run(alarm)
    for field in fields(Alarms):
        np.testing.assert_array_equal(getattr(again, field.name), getattr(first, field.name))


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_settings_must_be_positive(value):
    with pytest.raises(QuadpiError, match="release_s must be positive"):
        MonitorSettings(release_s=value)


def missing_shares(samples: Samples, axis: int, share: float, start_s: float, stop_s: float) -> None:
    """Misses of one axis, evenly spread, between two instants."""
    keep = samples.between(start_s, stop_s)
    count = len(samples.time_ns[keep])
    missed = np.floor(share * np.arange(1, count + 1)) > np.floor(share * np.arange(count))
    samples.measured[keep, axis] = np.where(missed, 2.0, 0.0)


def test_misses_beyond_the_allowance_raise_the_axis_when_their_sum_reaches_its_limit(envelope):
    samples = Samples(10.0)
    missing_shares(samples, MY, 0.5, 2.0, 10.0)
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    raised = int(np.argmax(rows.level == LEVEL_ALARM))
    seconds = 1e-9 * (rows.time_ns[raised] - samples.time_ns[0])
    assert seconds == pytest.approx(2.0 + 1.0 / (0.5 - ALLOWANCE), abs=0.02)
    assert rows.causes[raised] == MISCOVERAGE
    assert np.argmax(rows.miscoverage[raised]) == MY
    assert rows.miss_share[-1, MY] == pytest.approx(0.5, abs=0.05)
    assert "My outside its interval" in reasons(rows, raised)[0]


def test_allowed_misses_raise_nothing_however_long(envelope):
    samples = Samples(120.0)
    missing_shares(samples, FX, 0.1, 0.0, 120.0)
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    assert not np.any(rows.causes)


def test_miscoverage_clears_within_bounded_time(envelope):
    samples = Samples(60.0)
    samples.measured[samples.between(1.0, 41.0), FX] = 2.0
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    # From one and a half limits down to a quarter, at the allowance.
    cleared = 41.0 + 1.25 / ALLOWANCE
    assert changes(rows)[-1][0] == pytest.approx(cleared, abs=0.05)
    assert changes(rows)[-1][1] == LEVEL_OK


def test_axes_that_the_model_does_not_hold_are_not_tested(envelope):
    samples = Samples(5.0)
    samples.measured[:, MY] = 2.0
    held = np.arange(6) != MY
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS, held))
    assert not np.any(rows.causes)


def test_the_interval_of_the_calibration_counts_not_the_one_that_goes_out(envelope):
    samples = Samples(5.0)
    samples.measured[:, FX] = 1.5
    assert MISCOVERAGE in samples.run(Alarm(envelope, LIMITS, SETTINGS)).causes
    wider = Alarm(envelope, LIMITS, SETTINGS, interval_ratio=np.full(6, 2.0))
    assert MISCOVERAGE not in samples.run(wider).causes


def take_off_and_land() -> Samples:
    """On the ground until 2 s with idling rotors, in the air until 6 s, down again; misfits all the time."""
    samples = Samples(9.0)
    samples.inputs[:, OMEGA] = 300.0
    samples.inputs[samples.between(2.0, 6.0), OMEGA] = 1000.0
    samples.inputs[:, U] = 1.8
    samples.measured[:, FX] = 2.0
    return samples


def wide(envelope: Envelope) -> Envelope:
    upper = envelope.upper.copy()
    upper[OMEGA] = 2000.0
    return replace(envelope, upper=upper)


def test_on_the_ground_the_model_is_not_judged(envelope):
    limits = replace(LIMITS, hover_rotor_speed=1000.0)
    rows = take_off_and_land().run(Alarm(wide(envelope), limits, SETTINGS))
    seconds = 1e-9 * (rows.time_ns - rows.time_ns[0])
    on_ground = (seconds < 2.0) | (seconds > 6.31)
    assert not np.any(rows.causes[on_ground])
    assert np.all(rows.cause_health[on_ground, :2] == WAITING)
    in_flight = (seconds > 3.3) & (seconds < 6.0)
    assert np.all(rows.causes[in_flight] == EXTRAPOLATION | MISCOVERAGE)
    assert np.all(rows.cause_health[in_flight] == 0)


def test_slow_rotors_in_a_fast_descent_are_no_landing(envelope):
    limits = replace(LIMITS, hover_rotor_speed=1000.0)
    samples = take_off_and_land()
    samples.velocity[:, 2] = 4.0
    rows = samples.run(Alarm(wide(envelope), limits, SETTINGS))
    assert rows.causes[-1] == EXTRAPOLATION | MISCOVERAGE


def test_health_without_samples_and_without_calibration(envelope):
    samples = Samples(2.0)
    samples.usable[samples.between(1.0, 1.5)] = False
    rows = samples.run(Alarm(envelope, AlarmLimits(), SETTINGS))
    seconds = 1e-9 * (rows.time_ns - rows.time_ns[0])
    silent = (seconds > 1.1) & (seconds < 1.499)
    assert np.all(rows.cause_health[silent, :2] == UNAVAILABLE)
    assert np.all(rows.cause_health[(seconds < 0.99) | (seconds > 1.51), :2] == UNCALIBRATED)
    assert np.all(rows.cause_health[:, 2] == 0)


def test_faults_of_samples_that_are_used_raise_bad_data_in_flight_only(envelope):
    for fault, on_ground in ((STAMP_REPEATED, True), (GYRO_FROZEN, False), (ROTOR_HALF << 2, False)):
        samples = Samples(2.0)
        samples.faults[samples.between(1.0, 2.0)] = fault
        flying = samples.run(Alarm(envelope, LIMITS, SETTINGS))
        assert flying.causes[-1] == BAD_DATA
        standing = samples.run(Alarm(envelope, replace(LIMITS, hover_rotor_speed=1e3), SETTINGS))
        assert (standing.causes[-1] == BAD_DATA) == on_ground
    assert reasons(flying, len(flying) - 1) == ("rotor 3 reads half",)


def test_reasons_are_plain_words(envelope):
    samples = Samples(1.0)
    samples.inputs[:, U] = 1.4
    samples.leverage[:, FX] = 0.062
    samples.width[:, MY] = 1.8
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    assert reasons(rows, len(rows) - 1) == (
        "u 1.4 x the training range",
        "Fx leverage 6.2 x its peak in training",
        "My width 1.5 x its peak in training",
    )
    assert reasons(rows, 0) == ()


def test_the_log_holds_start_end_peak_and_reasons(envelope):
    samples = Samples(4.0)
    samples.inputs[samples.between(1.0, 2.0), U] = 1.8
    samples.inputs[samples.between(1.5, 1.6), U] = 3.6
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    opened, closed = EventLog().take(rows)
    assert (opened.number, opened.cause, opened.end_ns) == (1, EXTRAPOLATION, 0)
    assert opened.start_ns == closed.start_ns == samples.time_ns[0] + 1_098_000_000
    assert closed.end_ns == closed.time_ns == samples.time_ns[0] + 2_498_000_000
    assert closed.peak_evidence == pytest.approx(3.6 / 1.2)
    assert closed.reasons == ("u 3.6 x the training range",)


def test_the_log_holds_alarms_and_no_warnings(calibrated):
    samples = Samples(5.0)
    samples.inputs[samples.between(1.0, 4.0), U] = 1.4
    samples.inputs[samples.between(2.0, 3.0), U] = 2.1
    opened, closed = EventLog().take(samples.run(Alarm(calibrated, LIMITS, SETTINGS)))
    assert opened.start_ns == samples.time_ns[0] + 2_098_000_000
    assert closed.end_ns == samples.time_ns[0] + 3_498_000_000


def test_the_log_is_bounded_and_forgets_the_oldest(envelope):
    samples = Samples(120.0)
    on = (np.arange(len(samples.inputs)) // 400) % 2 == 1
    samples.inputs[on, U] = 1.8
    log = EventLog()
    log.take(samples.run(Alarm(envelope, LIMITS, SETTINGS)))
    assert len(log.events) == KEPT
    assert [event.number for event in log.events] == list(range(75 - KEPT + 1, 76))


def test_blocks_give_the_same_events(envelope):
    samples = Samples(6.0)
    samples.inputs[samples.between(1.0, 2.0), U] = 1.8
    missing_shares(samples, MY, 0.9, 2.0, 6.0)
    whole = EventLog().take(samples.run(Alarm(envelope, LIMITS, SETTINGS)))
    log, alarm, parts = EventLog(), Alarm(envelope, LIMITS, SETTINGS), []
    for start in range(0, 3000, 7):
        keep = slice(start, start + 7)
        count = len(samples.time_ns[keep])
        parts += log.take(
            alarm.step(
                samples.time_ns[keep],
                samples.usable[keep],
                samples.faults[keep],
                Judged(
                    samples.inputs[keep],
                    samples.velocity[keep],
                    samples.leverage[keep],
                    samples.width[keep],
                    samples.measured[keep],
                    np.full((count, 6), -1.0),
                    np.full((count, 6), 1.0),
                ),
            )
        )
    assert len(whole) == 3
    assert parts == whole
