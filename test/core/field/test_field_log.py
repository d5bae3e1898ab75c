# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Series on their own clocks: what is left out, and what is between samples."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.field.field_log import FieldLog, Series, Setting, series_of


def test_stale_first_records_are_left_out():
    time_ns = np.array([0, 60, 61, 62, 63, 64, 65, 66], dtype=np.int64) * 10**9
    series = series_of(time_ns, np.arange(8.0), 0)
    assert series.time[0] == pytest.approx(60.0)
    assert series.values[:, 0].tolist() == list(range(1, 8))


def test_a_pause_in_the_middle_is_no_stale_beginning():
    time_ns = np.array([0, 1, 2, 3, 4, 60, 61, 62], dtype=np.int64) * 10**9
    assert len(series_of(time_ns, np.arange(8.0), 0)) == 8


def test_samples_that_are_not_finite_or_do_not_rise_are_left_out():
    time_ns = np.array([0, 1, 2, 2, 1, 3], dtype=np.int64) * 10**9
    series = series_of(time_ns, np.array([0.0, np.nan, 2.0, 9.0, 9.0, 3.0]), 0)
    assert series.time.tolist() == [0.0, 2.0, 3.0]
    assert series.values[:, 0].tolist() == [0.0, 2.0, 3.0]


def test_fewer_than_two_samples_are_no_series():
    assert series_of(np.array([5], dtype=np.int64), np.array([1.0]), 0) is None


def test_nothing_is_told_outside_and_in_pauses():
    series = Series(np.array([0.0, 0.1, 0.2, 5.0, 5.1]), np.arange(5.0)[:, np.newaxis])
    told = series.at(np.array([-1.0, 0.05, 2.0, 5.05, 6.0]))[:, 0]
    assert np.isnan(told[[0, 2, 4]]).all()
    assert told[[1, 3]] == pytest.approx([0.5, 3.5])


def test_means_between_edges_and_lines_where_no_sample_is():
    series = Series(np.array([0.0, 0.1, 0.2, 1.0]), np.array([[0.0], [1.0], [2.0], [10.0]]))
    edges = np.array([0.0, 0.25, 0.5])
    assert series.means(edges)[0, 0] == pytest.approx(1.0)
    assert np.isnan(series.means(edges)[1, 0])
    assert series.filled_means(edges)[1, 0] == pytest.approx(2.0 + 8.0 * 0.175 / 0.8)


def test_motors_are_named_by_their_corners_where_these_are_known():
    log = FieldLog(
        "a", "a.log", "PX4", places=np.array([[1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
    )
    names = [log.motor(number) for number in (1, 2, 3)]
    assert names == ["motor 1 (front right)", "motor 2 (rear left)", "motor 3"]
    assert FieldLog("a", "a.log", "PX4").motor(2) == "motor 2"


def test_a_setting_names_its_present_value():
    assert "SDLOG_PROFILE is 1: set it to 25" in Setting("SDLOG_PROFILE", "1", "set it to 25", "x").sentence()
