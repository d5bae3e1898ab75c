# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.evaluation.evaluation_result import Comparison
from quadpi_core.flight import AXES
from quadpi_core.report.comparison_page import comparison_verdict
from quadpi_core.report.evaluation_figures import (
    ENVELOPE_INPUTS,
    Coverage,
    Holding,
    alarm_figure,
    count_verdicts,
    coverage_figure,
    envelope_figure,
    joint_verdict,
    residual_figure,
    time_history_figure,
)
from quadpi_core.report.evaluation_page import evaluation_verdict
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


def layers(figure):
    return {layer.name: layer for panel in figure.panels for layer in panel.layers if layer.name}


def spans(boxes):
    return list(zip(boxes.left, boxes.right, strict=True))


def test_alarm_timeline_holds_each_level_until_the_next_message(case):
    traces = layers(alarm_figure(case.live, case.results[2]))
    assert spans(traces["ok"]) == [(0, 2), (5, 5)]
    assert spans(traces["warning"]) == [(2, 3)]
    assert spans(traces["alarm"]) == [(3, 5)]
    assert spans(traces["u"]) == [(2, 4)]
    assert spans(traces["mu_x"]) == [(1, 4)]
    assert traces["leverage, worst axis"].y[3] == 2.5


def test_alarm_timeline_without_airspeed_and_without_inputs(case):
    quiet = replace(case.live, inputs_outside=[()] * 6)
    assert list(layers(alarm_figure(quiet, None))) == [
        *("alarm", "warning", "ok", "leverage, worst axis", "width, worst axis")
    ]


def test_airspeed_is_drawn_at_the_time_of_the_live_nodes(case):
    figure = alarm_figure(replace(case.live, begins_s=1.0), case.results[2])
    speed = layers(figure)["airspeed"]
    assert speed.x[0] >= 1.0
    assert (figure.flight, figure.begins_s) == ("fast<b>", 1.0)


# Of which coverage a sentence may say that intervals hold.


@pytest.mark.parametrize(
    ("estimate", "interval", "expected"),
    [
        (0.97, (0.95, 0.99), Holding.HOLDS),
        (0.931, (0.90, 0.96), Holding.HOLDS),
        # Within two points: beyond chance, but nobody would decide otherwise.
        (0.94, (0.935, 0.945), Holding.HOLDS),
        (0.929, (0.90, 0.96), Holding.NOT_SHOWN),
        (0.999, (0.89, 1.0), Holding.NOT_SHOWN),
        (0.834, (0.619, 0.955), Holding.NOT_SHOWN),
        (0.92, (0.90, 0.945), Holding.FAILS),
        (0.60, (0.30, 0.94), Holding.FAILS),
        (0.99, None, Holding.NOT_SHOWN),
    ],
)
def test_what_may_be_said_of_a_coverage(estimate, interval, expected):
    assert Coverage("Fx", estimate, interval).holding(0.95) is expected


def test_of_several_the_worst_counts_and_the_lowest_comes_first():
    good, unknown = Coverage("Fx", 0.96, (0.95, 0.97)), Coverage("Fy", 0.8, (0.6, 0.96))
    bad, worse = Coverage("Fz", 0.7, (0.6, 0.8)), Coverage("Mx", 0.5, (0.4, 0.6))
    assert joint_verdict([good], 0.95) == (Holding.HOLDS, [good])
    assert joint_verdict([good, unknown], 0.95) == (Holding.NOT_SHOWN, [unknown])
    assert joint_verdict([bad, good, unknown, worse], 0.95) == (Holding.FAILS, [worse, bad])


def test_cells_are_counted_and_what_does_not_hold_is_named():
    cells = {"a": [Coverage("m Fx", 0.96, (0.95, 0.97)), Coverage("m Fy", 0.834, (0.619, 0.955))]}
    assert count_verdicts(cells, 0.95) == (
        "hold in 1 of 2 on a; are not shown to hold in 1 on a "
        "(m Fy 83.4 %, 95 % confidence interval 61.9 % to 95.5 %)"
    )


def test_headlines_of_page_and_comparison_go_by_the_same_rule(case, with_coverage):
    few = with_coverage(case.evaluation.groups["known"], "Mz", 0.834, [0.619, 0.955])
    evaluation = replace(case.evaluation, groups={"few": few})
    assert evaluation_verdict(evaluation) == (
        "95\u00a0% prediction intervals are not shown to hold on few "
        "(in sample; 1 of 6 axes; Mz 83.4 %, 95 % confidence interval 61.9 % to 95.5 %)."
    )
    compared = Comparison("0", "v", 0.95, False, {"few": []}, {"m": evaluation})
    assert comparison_verdict(compared) == (
        "Over the axes of all models, 95\u00a0% prediction intervals hold in 5 of 6 on few; are not shown to "
        "hold in 1 on few (m Mz 83.4 %, 95 % confidence interval 61.9 % to 95.5 %)."
    )
