# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Tachometers judged by commands: half-reading and silent ones, and rotors that stand."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.monitor.health import TachometerWatch

COMMANDED = np.array([1500.0, 1520.0, 1480.0, 1500.0])


def watched(scales, seconds=3.0, commanded=COMMANDED):
    watch = TachometerWatch()
    for time_ns in range(10**9, round((1.0 + seconds) * 1e9), 10**7):
        watch.take(time_ns, commanded * np.array(scales), commanded)
    return watch


@pytest.mark.parametrize(
    ("scales", "said"),
    [
        ([1.0, 1.02, 0.97, 1.0], []),
        ([1.0, 1.0, 0.5, 1.0], ["the tachometer of rotor 3 reads 0.50 of what its command gives"]),
        # All by the same: the pairs of poles, or the scale of the motors.
        ([0.5, 0.5, 0.5, 0.5], []),
        (
            [1.0, 0.0, 1.0, 1.0],
            ["the tachometer of rotor 2 reads nothing: it is silent, the vehicle flies as commanded"],
        ),
    ],
)
def test_what_reads_otherwise_than_the_others_is_said(scales, said):
    assert list(watched(scales).found(alarm=False)) == said


def test_with_an_alarm_a_rotor_that_reads_nothing_stands():
    (said,) = watched([1.0, 0.0, 1.0, 1.0]).found(alarm=True)
    assert said == "the tachometer of rotor 2 reads nothing: it stands, the alarm is raised"


def test_nothing_is_said_in_the_first_second_and_of_motors_that_are_not_commanded():
    assert watched([1.0, 1.0, 0.5, 1.0], seconds=0.9).found(alarm=False) == ()
    assert watched([1.0, 1.0, 0.5, 1.0], commanded=np.zeros(4)).found(alarm=False) == ()


def test_readings_that_are_no_numbers_do_not_count():
    watch = watched([1.0] * 4)
    watch.take(4 * 10**9, COMMANDED * np.nan, COMMANDED)
    assert watch.found(alarm=False) == ()


def test_a_tachometer_that_begins_to_read_half_is_found_within_two_seconds():
    watch = watched([1.0] * 4)
    for time_ns in range(4 * 10**9, 6 * 10**9, 10**7):
        watch.take(time_ns, COMMANDED * np.array([0.5, 1.0, 1.0, 1.0]), COMMANDED)
    (said,) = watch.found(alarm=False)
    assert "rotor 1 reads 0.5" in said
