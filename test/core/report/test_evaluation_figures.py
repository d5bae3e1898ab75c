# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest

from quadpi_core.flight import AXES
from quadpi_core.report.evaluation_figures import (
    ENVELOPE_INPUTS,
    coverage_figure,
    envelope_figure,
    residual_figure,
    time_history_figure,
)


def groups(case):
    return {"known": case.results[:2], "new & fast": case.results[2:]}


def test_each_axis_of_a_time_history_has_its_band_between_the_bounds(case):
    result = case.results[2]
    figure = time_history_figure(result, case.evaluation.flights[result.name].axes, "#0072B2", 500)
    assert len(figure.data) == 4 * len(AXES)
    for k, axis in enumerate(AXES):
        lower, upper, measured, predicted = figure.data[4 * k : 4 * k + 4]
        # A band is only right where both bounds are of this type, on one subplot, and drawn in this order.
        assert lower.type == upper.type == "scatter"
        assert (lower.fill, upper.fill) == (None, "tonexty")
        assert {trace.yaxis for trace in (lower, upper, measured, predicted)} == {lower.yaxis}
        assert np.all(lower.y < predicted.y)
        assert np.all(predicted.y < upper.y)
        assert measured.fill is None
        assert measured.y.max() == np.float32(result.column("measured", axis).max())
        assert lower.y.min() == np.float32(result.column("lower", axis).min())
        assert upper.y.max() == np.float32(result.column("upper", axis).max())


def test_coverage_figure_shows_coverage_and_interval_in_percent(case):
    figure = coverage_figure(case.evaluation)
    metrics = case.evaluation.groups["new & fast"].axes["Fz"]
    trace = figure.data[1]
    k = AXES.index("Fz")
    assert trace.x[k] == pytest.approx(100 * metrics.picp)
    assert trace.x[k] + trace.error_x.array[k] == pytest.approx(100 * metrics.picp_ci[1])
    assert trace.x[k] - trace.error_x.arrayminus[k] == pytest.approx(100 * metrics.picp_ci[0])


def test_envelope_figure_marks_the_training_range_of_every_input(case):
    figure = envelope_figure(groups(case), case.model.envelope, ["slow", "mid"])
    assert len(figure.data) == 2 * len(ENVELOPE_INPUTS)
    assert len(figure.layout.shapes) == len(ENVELOPE_INPUTS)
    speed = figure.layout.shapes[ENVELOPE_INPUTS.index("speed")]
    assert speed.x1 == pytest.approx(case.results[1].speed.max())
    outside = np.mean(case.results[2].speed > speed.x1)
    notes = [note.text for note in figure.layout.annotations if "outside" in note.text]
    assert any(f"{100 * outside:.0f} % outside" in note for note in notes)


def test_airspeed_has_no_range_without_training_flights(case):
    figure = envelope_figure({"new": case.results[2:]}, case.model.envelope, ["slow", "mid"])
    assert len(figure.layout.shapes) == len(ENVELOPE_INPUTS) - 1


def test_residual_bands_hold_the_residuals_and_lie_between_their_bounds(case):
    figure = residual_figure(groups(case), AXES, 0.95)
    assert len(figure.data) == 4 * 2 * len(AXES)
    for k in range(0, len(figure.data), 4):
        low, high, below, above = figure.data[k : k + 4]
        assert low.type == high.type == "scatter"
        assert (low.fill, high.fill) == (None, "tonexty")
        assert np.all(low.y < high.y)
        assert np.all(below.y < 0)
        assert np.all(above.y > 0)
    # σ = 0.75 for the fast flight and 0.25 for the others.
    assert np.median(figure.data[5].y) == pytest.approx(1.96 * 0.75, rel=0.15)
    assert np.median(figure.data[1].y) == pytest.approx(1.96 * 0.25, rel=0.15)
