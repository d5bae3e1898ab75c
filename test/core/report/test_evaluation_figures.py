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
from quadpi_core.report.page import Boxes, Line


def training_range(panel):
    return [layer for layer in panel.layers if isinstance(layer, Boxes)]


def groups(case):
    return {"known": case.results[:2], "new & fast": case.results[2:]}


def test_each_axis_of_a_time_history_has_its_band_between_the_bounds(case):
    result = case.results[2]
    figure = time_history_figure(result, case.evaluation.flights[result.name].axes, "#0072B2")
    for panel, axis in zip(figure.panels, AXES, strict=True):
        band, measured, predicted = panel.layers
        assert panel.y.title.startswith(axis)
        assert [layer.name for layer in panel.layers] == ["prediction interval", "measured", "predicted"]
        for values, quantity in (
            (band.low, "lower"),
            (band.high, "upper"),
            (measured.y, "measured"),
            (predicted.y, "predicted"),
        ):
            np.testing.assert_array_equal(values, result.column(quantity, axis))


def test_coverage_figure_shows_coverage_and_interval_in_percent(case):
    figure = coverage_figure(case.evaluation)
    metrics = case.evaluation.groups["new & fast"].axes["Fz"]
    nominal, _, fast = figure.panels[0].layers
    k = AXES.index("Fz")
    assert nominal.at == pytest.approx(95.0)
    assert fast.x[k] == pytest.approx(100 * metrics.picp)
    assert fast.error[k] == pytest.approx(100 * np.array(metrics.picp_ci))
    assert figure.panels[0].x.low < fast.error.min()


def test_envelope_figure_marks_the_training_range_of_every_input(case):
    figure = envelope_figure(groups(case), case.model.envelope)
    assert len(figure.panels) == len(ENVELOPE_INPUTS)
    assert all(training_range(panel) for panel in figure.panels)
    panel = figure.panels[ENVELOPE_INPUTS.index("speed")]
    (speed,) = training_range(panel)
    assert speed.right == pytest.approx([case.results[1].speed.max()])
    outside = np.mean(case.results[2].speed > speed.right[0])
    assert panel.notes == [f"new & fast: {100 * outside:.0f} % outside"]
    # Groups differ in print.
    assert {layer.dash for layer in panel.layers if isinstance(layer, Line)} == {"", "dashed"}


def test_airspeed_has_no_range_without_training_flights(case):
    figure = envelope_figure({"new": case.results[2:]}, case.model.envelope)
    assert [bool(training_range(panel)) for panel in figure.panels] == [
        name != "speed" for name in ENVELOPE_INPUTS
    ]


def test_residual_bands_hold_the_residuals_and_lie_between_their_bounds(case):
    figure = residual_figure(groups(case), AXES, 0.95)
    assert len(figure.panels) == len(AXES)
    for panel in figure.panels:
        for band, below, above in (panel.layers[:3], panel.layers[3:6]):
            assert np.all(band.low < band.high)
            assert np.all(below.y < 0)
            assert np.all(above.y > 0)
    # σ = 0.75 for the fast flight and 0.25 for the others.
    known, fast = figure.panels[0].layers[0], figure.panels[0].layers[3]
    assert np.median(fast.high) == pytest.approx(1.96 * 0.75, rel=0.15)
    assert np.median(known.high) == pytest.approx(1.96 * 0.25, rel=0.15)
    assert known.pattern != fast.pattern
