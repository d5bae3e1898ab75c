# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

from quadpi_core.report.live_figure import alarm_figure


def spans(trace):
    return [tuple(trace.x[i : i + 2]) for i in range(0, len(trace.x), 3)]


def test_alarm_timeline_holds_each_level_until_the_next_message(case):
    traces = {trace.name: trace for trace in alarm_figure(case.live, case.results[2]).data}
    assert spans(traces["ok"]) == [(0, 2), (5, 5)]
    assert spans(traces["warning"]) == [(2, 3)]
    assert spans(traces["alarm"]) == [(3, 5)]
    assert spans(traces["u"]) == [(2, 4)]
    assert spans(traces["mu_x"]) == [(1, 4)]
    assert traces["leverage, worst axis"].y[3] == 2.5


def test_alarm_timeline_without_airspeed_and_without_inputs(case):
    quiet = replace(case.live, inputs_outside=[()] * 6)
    assert [t.name for t in alarm_figure(quiet, None).data] == [
        *("alarm", "warning", "ok", "leverage, worst axis", "width, worst axis")
    ]
