# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

from quadpi_core.report.evaluation_figures import alarm_figure


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
