# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of residuals: what is drawn is what was measured more than simulated, before and after."""

import numpy as np
import pytest

from quadpi_core.discrepancy.by_condition import Profile, Residual
from quadpi_core.discrepancy.closure import Gap
from quadpi_core.flight import AXES
from quadpi_core.report.discrepancy_evidence import (
    gap_figure,
    map_figure,
    mean_map,
    profile_figure,
    residual_figure,
)

VARIABLES = ("u", "v", "speed", "height", "w", "rotor_speed")


def flight(u, v, wrench=None):
    """Residuals of forces that fall with the forward speed."""
    if wrench is None:
        wrench = np.zeros((u.size, 6))
        wrench[:, 0] = -0.1 * u
    rng = np.random.default_rng(0)
    others = {name: rng.uniform(0.0, 9.0, u.size) for name in VARIABLES[2:]}
    return Residual("a", np.arange(u.size) / 40.0, {"u": u, "v": v, **others}, wrench, wrench, 0.5 * wrench)


@pytest.fixture
def square():
    u, v = np.meshgrid(np.linspace(-3.9, 3.9, 60), np.linspace(-3.9, 3.9, 60))
    return flight(u.ravel(), v.ravel())


def test_maps_hold_the_mean_of_what_was_measured_more_than_simulated(square):
    x, y, table = mean_map([square], 0, "u", "v")
    assert table.shape == (len(y) - 1, len(x) - 1)
    centres = 0.5 * (x[:-1] + x[1:])
    assert np.nanmean(table, axis=0) == pytest.approx(-0.1 * centres, abs=0.02)
    assert max(table.shape) <= 12
    # 14 values in an extent of 13 do not fit into bins of one: bins of two do.
    steps = np.arange(14.0).repeat(30)
    assert len(mean_map([flight(steps, steps)], 0, "u", "v")[0]) - 1 == 7


def test_a_cell_needs_twenty_samples_to_be_drawn():
    """Of several flights together."""
    here, there = np.array([0.5] * 19), np.array([8.5] * 20)
    few = flight(np.concatenate((here, there)), np.concatenate((here, there)))
    x, _, table = mean_map([few], 0, "u", "v")
    assert np.isnan(table[0, 0])
    assert table[-1, -1] == pytest.approx(-0.85)
    assert np.isfinite(table).sum() == 1
    one = flight(np.array([0.5]), np.array([0.5]))
    np.testing.assert_array_equal(mean_map([few, one], 0, "u", "v")[0], x)
    assert np.isfinite(mean_map([few, one], 0, "u", "v")[2]).sum() == 2


def test_colours_of_an_axis_have_one_scale_about_zero(square):
    figure = map_figure([square], ("Fx", "Mz"))
    assert len(figure.panels) == 3 * figure.columns == 6
    for column in range(2):
        own = [panel.layers[0] for panel in figure.panels[column::2]]
        largest = max(np.nanmax(np.abs(cell.values)) for cell in own)
        assert [cell.largest for cell in own] == pytest.approx([largest] * 3)
        assert all(len(cell.values) == (len(cell.x) - 1) * (len(cell.y) - 1) for cell in own)


def test_a_profile_is_drawn_to_the_end_of_its_last_bin():
    profile = Profile("Fx", "u", np.array([0.0, 2.0, 4.0]), *np.array([[3.0, 4.0], [1.0, 2.0], [0.5, 0.6]]))
    figure = profile_figure([profile] * 4)
    drawn = {line.name: line for line in figure.panels[0].layers}
    assert drawn["as it is"].y.tolist() == [3.0, 4.0, 4.0]
    assert drawn["with what was found"].y.tolist() == [1.0, 2.0, 2.0]
    assert all(line.stepped for line in drawn.values())
    assert len({line.dash for line in drawn.values()}) == 3
    assert figure.panels[0].x.title == "forward airspeed [m/s]"


def test_a_gap_is_drawn_before_after_and_as_the_floor():
    before, after, floor = np.arange(18.0).reshape(3, 6)
    figure = gap_figure(Gap(before, after, floor, 0.5))
    for k, panel in enumerate(figure.panels):
        own = slice(3 * k, 3 * k + 3)
        assert tuple(label for _, label in panel.x.ticks) == AXES[own]
        left, right, noise = panel.layers
        assert (left.name, right.name, noise.name) == ("before", "after", "floor")
        np.testing.assert_array_equal(left.top, before[own])
        np.testing.assert_array_equal(right.top, after[own])
        np.testing.assert_array_equal(noise.y, floor[own])
        assert np.all(left.right <= right.left)


def test_residuals_over_time_have_a_band_of_twice_the_floor(square):
    figure = residual_figure(square, np.full(6, 0.25))
    assert len(figure.panels) == 6
    for panel in figure.panels:
        noise, before, after = panel.layers
        assert (noise.bottom.tolist(), noise.top.tolist()) == ([-0.5], [0.5])
        assert (before.name, after.name) == ("before", "after")
    _, before, after = figure.panels[0].layers
    assert after.y.max() == pytest.approx(0.5 * before.y.max(), rel=1e-6)
