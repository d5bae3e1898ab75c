# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np

from quadpi_core.report.simulation_page import (
    effort_figure,
    rotor_names,
    tracking_figure,
    trajectory_figure,
)
from quadpi_core.simulation.truth import Reference
from quadpi_core.vehicle import Vehicle

from .circling import HEIGHT, PITCH, RADIUS, circle


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
