# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The page of simulated flights, on synthetic truths whose numbers are known."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from quadpi_core.report.simulation_page import (
    effects_text,
    effort_figure,
    faults_text,
    flight_table,
    rotor_names,
    summarise,
    tracking_figure,
    trajectory_figure,
    write_simulation_page,
)
from quadpi_core.report.table import terminal_table
from quadpi_core.simulation.truth import Reference
from quadpi_core.vehicle import Vehicle

from .circling import HEIGHT, PITCH, RADIUS, TURN_RATE, circle


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


def line(figure, name):
    (found,) = (line.points for line in figure.lines if line.name == name)
    return found


def layers(figure, name):
    return [layer for panel in figure.panels for layer in panel.layers if layer.name == name]


class TestTrajectory:
    def test_axes_are_east_north_height_at_equal_scale(self):
        figure = trajectory_figure(circle())
        (path,) = (line.points for line in figure.lines if line.values is not None)
        np.testing.assert_allclose(path[0], [0.0, RADIUS, HEIGHT], atol=1e-6)
        np.testing.assert_allclose(line(figure, "reference")[0], [0.0, RADIUS + 0.3, HEIGHT + 0.4], rtol=1e-6)
        assert np.all(figure.low <= path.min(axis=0))
        assert np.all(figure.high >= path.max(axis=0))

    def test_noses_point_along_the_flight_and_up(self):
        nose = line(trajectory_figure(circle()), "nose").reshape(-1, 3, 3)
        assert len(nose) > 10
        assert np.isnan(nose[:, 2]).all()
        directions = nose[:, 1] - nose[:, 0]
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        np.testing.assert_allclose(directions[:, 2], np.sin(PITCH), rtol=1e-4)
        # Clockwise seen from above: east of the circle it flies south.
        east = np.argmax(nose[:, 0, 0])
        assert directions[east, 1] < -0.9

    def test_a_hover_has_one_vehicle_and_a_space_around_it(self):
        truth = circle()
        still = replace(truth, position=np.tile([1.0, 2.0, -3.0], (1000, 1)))
        figure = trajectory_figure(replace(still, reference=Reference.hover(still.position[0], 1000)))
        assert len(line(figure, "nose")) == 3
        low, high = figure.low[2], figure.high[2]
        assert low < 3.0 - 0.4
        assert high > 3.0 + 0.4


class TestTimeHistories:
    def test_yaw_follows_its_reference_through_the_turns(self):
        figure = tracking_figure(circle())
        flown, reference = (layers(figure, name)[3] for name in ("flown", "reference"))
        np.testing.assert_allclose(flown.y, reference.y, atol=1e-3)
        assert np.ptp(flown.y) > 720

    def test_lines_of_a_row_differ_without_colour(self):
        for panel in effort_figure(circle()).panels:
            dashes = [layer.dash for layer in panel.layers if layer.name]
            assert len(dashes) == len(set(dashes))

    def test_rotors_are_named_by_their_place(self):
        names = rotor_names(Vehicle.load("bebop2"))
        assert names == ["front left", "front right", "rear right", "rear left"]
