# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The table of a replay says for each flight when and how long the alarm stood."""

from __future__ import annotations

from dataclasses import replace

from quadpi_core.cli.flight_commands import not_judged_sentences, replay_table
from quadpi_core.monitor.alarm import NotJudgedReason
from quadpi_core.monitor.replay import ReplaySummary

QUIET = ReplaySummary(
    samples_in=6000,
    predictions_out=5990,
    dropped=0,
    alarm_fraction=0.0,
    alarm_first_s=None,
    warning_first_s=2.5,
    events=0,
    not_judged_fraction=0.1,
    not_judged_reasons=(NotJudgedReason("on the ground", 0.08), NotJudgedReason("the state settles", 0.02)),
)


def test_each_flight_with_its_alarm(markdown_cells):
    loud = replace(QUIET, alarm_fraction=0.254, alarm_first_s=3.25, events=2, dropped=4)
    head, *rows = markdown_cells(replay_table({"calm": QUIET, "fast": loud}))
    calm, fast = (dict(zip(head, row, strict=True)) for row in rows)
    assert (calm["flight"], calm["alarm"], calm["first s"]) == ("calm", "0.0 %", "none")
    assert (calm["warned s"], calm["predicted"]) == ("2.50", "99.8 %")
    assert (fast["first s"], fast["events"], fast["dropped"]) == ("3.25", "2", "**4**")
    assert "25.4 %" in fast["alarm"]
    assert calm["not judged"] == "10.0 %"


def test_what_was_not_judged_says_why():
    judged = replace(QUIET, not_judged_fraction=0.0, not_judged_reasons=())
    assert list(not_judged_sentences({"calm": QUIET, "all": judged})) == [
        "calm: not judged 10.0 % of the flight: on the ground 8.0 %, the state settles 2.0 %"
    ]
