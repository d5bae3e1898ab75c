# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The page and tables of `quadpi report`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from quadpi_core.field import field_report
from quadpi_core.field.estimates import not_identified
from quadpi_core.field.field_log import FieldLog, Setting
from quadpi_core.field.field_report import FieldReport, report_on
from quadpi_core.reading_options import ReadingOptions
from quadpi_core.report.field_page import (
    drag_table,
    flight_table,
    motor_sentence,
    report_summary,
    settings_table,
    time_figure,
    topic_table,
    write_field_page,
)

from ..field.field_examples import example


@pytest.fixture
def report_of(monkeypatch: pytest.MonkeyPatch):
    """report_of(log, mass=…) → the report of a field log, without a file."""

    def report(log: FieldLog, mass: float | None = None) -> FieldReport:
        monkeypatch.setattr(field_report, "read_field_log", lambda *_: log)
        return report_on([Path("flight.log")], ReadingOptions(), mass=mass)

    return report


def text(table) -> str:
    return " | ".join(str(cell.value) for row in table.cells for cell in row)


def test_the_page_is_whole_and_self_contained(report_of, tmp_path):
    report = report_of(example(notes=("a <b> note",), settings=(Setting("A_B", "0", "set it to 1", "x"),)))
    write_field_page(tmp_path / "report.html", report)
    page = (tmp_path / "report.html").read_text()
    for part in (
        report.verdict(),
        "a &lt;b&gt; note",
        "A_B",
        "hover (below 0.5 m/s)",
        "BCOEF",
        "vibration along x",
        "5 to 100 Hz; not judged",
        "looked at: motor commands",
    ):
        assert part in page
    # How a log was read is no finding.
    assert "Findings in the data" not in page


def test_a_page_of_a_log_that_holds_hardly_anything(report_of, tmp_path):
    log = example()
    bare = replace(
        log, **dict.fromkeys(("imu", "attitude", "velocity", "position", "rotor_speeds", "battery"))
    )
    report = report_of(bare)
    write_field_page(tmp_path / "report.html", report)
    assert "the log has no specific force and no attitude" in (tmp_path / "report.html").read_text()
    assert "not in the log" in text(topic_table(report.flights[0]))


def test_drag_in_newtons_where_the_mass_is_given(report_of):
    without, given = (report_of(example(), mass) for mass in (None, 2.0))
    assert "N/(m/s)" not in text(drag_table(without.vehicles[0], without.mass))
    rows = {row[0].value: row[1].value for row in drag_table(given.vehicles[0], given.mass).cells}
    assert rows["drag, along the nose"] == pytest.approx(2.0 * rows["drag over mass, along the nose"])
    assert rows["drag, along the nose"] == pytest.approx(0.6, rel=0.05)


def test_flights_that_tell_no_drag_say_so_once(report_of):
    still = replace(example().velocity, values=0.01 * example().velocity.values)
    table = drag_table(report_of(example(velocity=still)).vehicles[0], 2.0)
    assert len(table.cells) == 1
    assert "too slow, " in text(table)
    assert "5 m/s or more" in table.note


def test_a_lag_that_is_not_told_has_no_number(report_of):
    vehicle = report_of(example()).vehicles[0]
    assert "late by about 12 ms and with a lag of 47 ms (42 to 52)" in motor_sentence(vehicle)
    untold = replace(vehicle, motor_model=replace(vehicle.motor_model, lag=not_identified("s", "flat")))
    assert "with a lag of a time that is not told (not identified: flat" in motor_sentence(untold)


def test_drag_parameters_have_the_names_of_the_stack(report_of):
    names = [
        row[0].value
        for row in drag_table(report_of(example(drag_prefix="EK3_DRAG_")).vehicles[0], None).cells
    ]
    assert names[2:5] == ["EK3_DRAG_MCOEF", "EK3_DRAG_BCOEF_X", "EK3_DRAG_BCOEF_Y"]


def test_settings_are_named_once_with_their_values(report_of):
    one = Setting("SDLOG_PROFILE", "1", "set it to 25", "more")
    assert (
        text(settings_table(report_of(example(settings=(one, one)))))
        == "SDLOG_PROFILE | 1 | set it to 25 | more"
    )
    assert "the logs hold all" in text(settings_table(report_of(example())))


def test_the_summary_has_a_row_for_each_flight(report_of):
    report = report_of(example())
    assert len(flight_table(report).cells) == 1
    assert [table.title for table in report_summary(report)] == [
        *("flown", "drag · PX4 quadcopter", "to log more", "findings")
    ]


def test_the_figure_shows_what_is_there(report_of):
    figure = time_figure(report_of(example()).flights[0])
    assert [panel.y.title for panel in figure.panels] == [
        *("speed [m/s]", "height [m]", "command [%]", "rotors [rad/s]", "battery [V]")
    ]
