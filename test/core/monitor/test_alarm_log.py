# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The log of alarms, and the words for them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.monitor.alarm import Alarm
from quadpi_core.monitor.alarm_log import INPUT_WORDS, EventLog, reasons
from quadpi_core.results import EVENTS_KEPT, EXTRAPOLATION, LEVEL_OK, MISCOVERAGE
from test.core.monitor.alarm_samples import FX, LIMITS, MY, SETTINGS, Samples, U, missing_shares


def test_reasons_are_plain_words(envelope):
    samples = Samples(1.0)
    samples.inputs[:, U] = 1.4
    samples.leverage[:, FX] = 0.062
    samples.width[:, MY] = 1.8
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    assert reasons(rows, len(rows) - 1) == (
        "forward or backward speed 1.4 x the training range",
        "forward force: leverage 6.2 x its peak in training",
        "pitch moment: interval 1.5 x its widest in training",
    )
    assert reasons(rows, 0) == ()


def test_three_inputs_are_named_from_a_twentieth_beyond_their_range_on(envelope):
    samples = Samples(1.0)
    for k, ratio in enumerate((1.06, 1.09, 1.04, 1.08, 1.07)):
        samples.inputs[:, k] = ratio
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    words = [f"{INPUT_WORDS[INPUT_NAMES[k]].name} 1.1 x the training range" for k in (1, 3, 4)]
    assert reasons(rows, 0, EXTRAPOLATION) == tuple(words)
    samples.inputs[:, [1, 3, 4]] = 0.0
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    assert reasons(rows, 0, EXTRAPOLATION) == ("forward or backward speed 1.1 x the training range",)


def test_no_row_is_without_a_reason_and_none_says_what_is_over(envelope):
    samples = Samples(14.0)
    samples.inputs[samples.between(1.0, 2.0), U] = 1.8
    missing_shares(samples, MY, 0.9, 2.0, 5.0)
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    words = [reasons(rows, row) for row in range(len(rows))]
    assert [bool(one) for one in words] == [level != LEVEL_OK for level in rows.level.tolist()]
    said = [text for one in words for text in one]
    assert "inside what was flown in training again: ends if that lasts" in said
    assert "pitch moment was outside its interval too often a moment ago" in said
    assert not any(" interval 0 %" in text for text in said)


@pytest.mark.parametrize(
    ("share", "words"), [(0.09, "was outside its interval"), (0.11, "outside its interval 11 %")]
)
def test_an_axis_is_said_to_be_outside_now_from_a_tenth_of_misses_on(envelope, share, words):
    samples = Samples(5.0)
    missing_shares(samples, MY, 0.9, 2.0, 5.0)
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    rows = replace(rows, miss_share=np.full_like(rows.miss_share, share))
    (reason,) = reasons(rows, len(rows) - 1, MISCOVERAGE)
    assert reason.startswith(f"pitch moment {words}")


def test_an_alarm_that_nothing_has_been_judged_of_since_does_not_say_inside(envelope):
    samples = Samples(3.0)
    samples.inputs[samples.between(1.0, 3.0), U] = 1.8
    rows = samples.run(Alarm(envelope, LIMITS, SETTINGS))
    unjudged = replace(rows, cause_evidence=0.0 * rows.cause_evidence, input_excess=0.0 * rows.input_excess)
    assert reasons(unjudged, len(rows) - 1) == ("extrapolation when last judged",)


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
    assert closed.reasons == ("forward or backward speed 3.6 x the training range",)


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
    assert len(log.events) == EVENTS_KEPT
    assert [event.number for event in log.events] == list(range(75 - EVENTS_KEPT + 1, 76))


def test_blocks_give_the_same_events(envelope):
    samples = Samples(6.0)
    samples.inputs[samples.between(1.0, 2.0), U] = 1.8
    missing_shares(samples, MY, 0.9, 2.0, 6.0)
    whole = EventLog().take(samples.run(Alarm(envelope, LIMITS, SETTINGS)))
    log, alarm = EventLog(), Alarm(envelope, LIMITS, SETTINGS)
    parts = [event for rows in samples.parts(alarm, 7) for event in log.take(rows)]
    assert len(whole) == 3
    assert parts == whole
