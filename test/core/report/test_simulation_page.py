# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The page of simulated flights, on synthetic truths whose numbers are known."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from quadpi_core.report.simulation_page import (
    effects_text,
    faults_text,
    flight_table,
    summarise,
    write_simulation_page,
)
from quadpi_core.report.table import terminal_table

from .circling import PITCH, RADIUS, TURN_RATE, circle


def planned(name="circle", effects=None, faults=()):
    data = {"effects": effects or {}, "faults": list(faults)}
    return SimpleNamespace(
        name=name, scenario="tests", noise="paper", seed=7, head_wind_m_s=None, as_dict=lambda: data
    )


@pytest.fixture
def flights():
    fault = {"kind": "frozen", "topic": "imu", "at_s": 2.0, "for_s": 0.5}
    return [
        (planned("plain"), circle("plain")),
        (planned("odd<b>", {"payload": {"mass_kg": 0.05}}, [fault]), circle("odd<b>")),
    ]


@pytest.fixture
def page(flights, read_page, tmp_path):
    path = tmp_path / "flights.html"
    write_simulation_page(path, flights)
    return read_page(path)


class TestSummary:
    def test_numbers_are_those_of_the_flight(self):
        summary = summarise(planned(), circle())
        assert summary.duration_s == pytest.approx(9.99)
        assert summary.airspeed_max_m_s == pytest.approx(RADIUS * TURN_RATE)
        assert summary.tracking_rms_m == pytest.approx(0.5)
        assert summary.tracking_max_m == pytest.approx(0.5)
        assert summary.tilt_max_deg == pytest.approx(np.degrees(PITCH))
        assert summary.rotor_speed_range_rad_s == [900.0, 1200.0]
        assert summary.saturated_fraction == 0.1

    def test_a_rotor_that_stands_still_is_at_its_limit(self):
        truth = circle()
        speeds = truth.rotor_speeds.copy()
        speeds[-1, 0] = 0.0
        assert summarise(planned(), replace(truth, rotor_speeds=speeds)).saturated_fraction == 0.101

    def test_long_names_do_not_cut_the_numbers_in_a_narrow_terminal(self, rendered, tmp_path):
        bag = tmp_path / f"{60 * 'n'}.mcap"
        bag.write_bytes(bytes(1_230_000))
        text = rendered(terminal_table(flight_table([summarise(planned(), circle())], [bag])), width=80)
        assert "…" not in text
        assert text.count("n") >= 60
        assert all(number in text for number in ("9.99", "6.00", "0.500", "1.23"))

    def test_airspeed_counts_the_wind(self):
        truth = replace(circle(), wind=np.tile([-8.0, 0.0, 0.0], (1000, 1)))
        fastest = summarise(planned(), truth).airspeed_max_m_s
        assert fastest == pytest.approx(RADIUS * TURN_RATE + 8.0, rel=1e-3)

    def test_texts(self):
        effects = {"payload": {"mass_kg": 0.05}, "wind": {"north_m_s": 2.0, "east_m_s": -1.0}}
        assert effects_text(effects) == "payload mass_kg 0.05; wind north_m_s 2, east_m_s -1"
        faults = [{"kind": "frozen", "topic": "imu", "at_s": 2.0, "for_s": 0.5}]
        assert faults_text(faults) == "frozen imu 2–2.5 s"


def test_every_flight_can_be_chosen(page):
    page.assert_needs_nothing_from_outside()
    flights = {attributes["value"] for tag, attributes in page.tags if tag == "option"}
    buttons = {own["data-flight"] for tag, own in page.tags if tag == "button" and "data-flight" in own}
    kinds = {attributes["data-kind"] for _, attributes in page.tags if "data-kind" in attributes}
    assert flights == buttons == {"plain", "odd<b>"}
    for flight in flights:
        assert set(page.figures(flight)) == kinds == {"trajectory", "tracking", "effort"}


def test_table_says_what_flew(page):
    for text in ("odd<b>", "payload mass_kg 0.05", "frozen imu 2–2.5 s", "900–1200", "0.500", "10.0 %"):
        assert text in page.text
    assert "wind [m/s]" not in page.text
    assert "2 simulated flights, 20.0\u00a0s, at up to 6.00\u00a0m/s" in page.text


def test_what_alters_all_flights_alike_is_said_once(read_page, tmp_path):
    effects = {"payload": {"mass_kg": 0.05}}
    path = tmp_path / "page.html"
    write_simulation_page(path, [(planned(name, effects), circle(name)) for name in ("a", "b")])
    page = read_page(path)
    assert page.text.count("payload mass_kg 0.05") == 1
    assert "faults" not in page.text


def test_a_page_of_twenty_long_flights_is_three_megabytes_at_most(tmp_path):
    path = tmp_path / "page.html"
    truth = circle(samples=3000)
    write_simulation_page(path, [(planned(str(k)), truth) for k in range(20)])
    assert path.stat().st_size < 3e6
