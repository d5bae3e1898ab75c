# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The page of simulated flights, on synthetic truths whose numbers are known."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from quadpi_core.frames import quaternion_from_roll_pitch_yaw
from quadpi_core.report.simulation_figures import (
    effort_figure,
    rotor_names,
    tracking_figure,
    trajectory_figure,
)
from quadpi_core.report.simulation_page import (
    effects_text,
    faults_text,
    flight_table,
    summarise,
    write_simulation_page,
)
from quadpi_core.report.table import terminal_table
from quadpi_core.rotations import rotate_world_to_body
from quadpi_core.simulation.truth import Reference, Truth
from quadpi_core.vehicle import Vehicle

RADIUS, TURN_RATE, HEIGHT = 3.0, 2.0, 5.0
OFFSET = np.array([0.3, 0.0, -0.4])
PITCH = 0.2
TENTH = 100


def circle(name="circle", samples=1000):
    """Turns clockwise about the origin, nose ahead and 0.2 rad up, always half a metre from its reference."""
    vehicle = Vehicle.load("bebop2")
    time = np.arange(samples) / 100.0
    angle = TURN_RATE * time
    zero = np.zeros_like(time)
    position = np.stack((RADIUS * np.cos(angle), RADIUS * np.sin(angle), zero - HEIGHT), axis=1)
    velocity = RADIUS * TURN_RATE * np.stack((-np.sin(angle), np.cos(angle), zero), axis=1)
    yaw = angle + np.pi / 2
    attitude = quaternion_from_roll_pitch_yaw(np.stack((zero, zero + PITCH, yaw), axis=1))
    still = np.zeros((samples, 3))
    rotor_speeds = np.full((samples, 4), 900.0)
    rotor_speeds[:TENTH, 2] = vehicle.rotor_speed_max_rad_s
    return Truth(
        name=name,
        vehicle=vehicle,
        time_ns=np.round(1e9 * time).astype(np.int64),
        position=position,
        attitude=attitude,
        velocity=rotate_world_to_body(attitude, velocity),
        rates=still,
        acceleration=still,
        angular_acceleration=still,
        rotor_speeds=rotor_speeds,
        rotor_accelerations=np.zeros((samples, 4)),
        wrench=np.zeros((samples, 6)),
        wind=still,
        known_wind=None,
        reference=Reference(position + OFFSET, velocity, still, yaw, zero, np.zeros((samples, 2)), zero),
    )


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


def trace(figure, name):
    (found,) = (data for data in figure.data if data.name == name)
    return np.column_stack((found.x, found.y, found.z))


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


class TestTrajectory:
    def test_axes_are_east_north_height_at_equal_scale(self):
        figure = trajectory_figure(circle())
        path = trace(figure, "flown")
        np.testing.assert_allclose(path[0], [0.0, RADIUS, HEIGHT], atol=1e-6)
        np.testing.assert_allclose(
            trace(figure, "reference")[0], [0.0, RADIUS + 0.3, HEIGHT + 0.4], rtol=1e-6
        )
        scene = figure.layout.scene
        scales = {
            (axis.range[1] - axis.range[0]) / scene.aspectratio[name]
            for name, axis in (("x", scene.xaxis), ("y", scene.yaxis), ("z", scene.zaxis))
        }
        assert max(scales) == pytest.approx(min(scales))

    def test_a_flat_space_has_fewer_ticks_upward(self):
        scene = trajectory_figure(circle()).layout.scene
        assert scene.zaxis.nticks < 0.5 * scene.xaxis.nticks

    def test_noses_point_along_the_flight_and_up(self):
        nose = trace(trajectory_figure(circle()), "nose").reshape(-1, 3, 3)
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
        assert len(trace(figure, "nose")) == 3
        low, high = figure.layout.scene.zaxis.range
        assert low < 3.0 - 0.4
        assert high > 3.0 + 0.4


class TestTimeHistories:
    def test_yaw_follows_its_reference_through_the_turns(self):
        figure = tracking_figure(circle(), bins=1000)
        flown, reference = (
            next(data for data in figure.data if data.name == name and data.yaxis == "y4")
            for name in ("flown", "reference")
        )
        np.testing.assert_allclose(flown.y, reference.y, atol=1e-3)
        assert np.ptp(flown.y) > 720

    def test_a_peak_of_one_sample_is_drawn(self):
        truth = circle()
        rates = truth.rates.copy()
        rates[567, 1] = 9.0
        figure = effort_figure(replace(truth, rates=rates), bins=150)
        assert next(data for data in figure.data if data.name == "q").y.max() == 9.0

    def test_each_name_is_explained_once(self):
        for figure in (tracking_figure(circle(), 150), effort_figure(circle(), 150)):
            explained = [data.name for data in figure.data if data.showlegend]
            assert len(explained) == len(set(explained))

    def test_rotors_are_named_by_their_place(self):
        names = rotor_names(Vehicle.load("bebop2"))
        assert names == ["front left", "front right", "rear right", "rear left"]


def test_page_needs_nothing_from_outside(page):
    page.assert_needs_nothing_from_outside()


def test_every_flight_can_be_chosen(page):
    figures = json.loads(page.scripts[1])
    flights = {attributes["value"] for tag, attributes in page.tags if tag == "option"}
    buttons = {attributes["data-flight"] for tag, attributes in page.tags if tag == "button"}
    kinds = {attributes["data-kind"] for _, attributes in page.tags if "data-kind" in attributes}
    assert flights == buttons == {"plain", "odd<b>"}
    assert set(figures) == {f"{kind} {flight}" for kind in kinds for flight in flights}
    assert all(figure["data"] for figure in figures.values())


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


def test_twenty_long_flights_stay_under_twelve_megabytes(tmp_path):
    path = tmp_path / "page.html"
    truth = circle(samples=3000)
    write_simulation_page(path, [(planned(str(k)), truth) for k in range(20)])
    assert path.stat().st_size < 12e6


def test_a_page_that_fails_leaves_the_old_one(flights, tmp_path):
    path = tmp_path / "page.html"
    path.write_text("old")
    plan, truth = flights[0]
    with pytest.raises(ValueError, match="broadcast"):
        write_simulation_page(path, [(plan, replace(truth, position=truth.position[:-1]))])
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
