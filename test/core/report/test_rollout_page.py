# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.evaluation.evaluate import evaluate_rollouts
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.report.table import markdown_table
from quadpi_core.report.validation_page import (
    fan_figure,
    growth_figure,
    rollout_summary,
    rollout_verdict,
    write_rollout_page,
)
from quadpi_core.vehicle import Vehicle

from .conftest import Page


@pytest.fixture(scope="module")
def judged(predicting, bags):
    return evaluate_rollouts(AerodynamicModel.load(predicting), [bags[2]], Vehicle.load("neurobem"))


def test_the_page_holds_the_table_and_a_fan(judged, tmp_path) -> None:
    write_rollout_page(tmp_path / "page.html", *judged)
    page = Page((tmp_path / "page.html").read_text())
    page.assert_needs_nothing_from_outside()
    assert "how far ahead can this model be trusted?" in page.text
    assert "split conformal" in page.text
    assert " ".join(rollout_verdict(judged[1]).split()) in " ".join(page.text.split())


def test_a_row_for_each_horizon_and_quantity(judged) -> None:
    text = markdown_table(rollout_summary(judged[1]))
    assert text.count("position [m]") == 3
    assert text.count("attitude [°]") == 3


def test_starts_that_were_left_out_are_said(judged) -> None:
    _, evaluation = judged
    ((name, whole),) = evaluation.flights.items()
    assert "left out" not in rollout_summary(evaluation).note
    partly = replace(evaluation, flights={name: replace(whole, starts=90, left_out=10)})
    assert f"{name}: 10 of 100 starts left out" in rollout_summary(partly).note


def test_a_fan_spreads_around_the_prediction(judged) -> None:
    (flight,), _ = judged
    figure = fan_figure(flight)
    measured, tube, predicted = figure.panels[0].layers
    assert (tube.name, measured.name, predicted.name) == ("tube", "measured", "predicted")
    assert len(measured.x) == len(flight.flight.time)
    # Fans do not overlap, and no line goes from one to the next.
    size = len(flight.horizons_s)
    assert np.all(np.diff(tube.x) > 0.0)
    assert np.isnan(predicted.y[size :: size + 1]).all()
    assert np.all(tube.high[:size] > tube.low[:size])
    np.testing.assert_allclose(0.5 * (tube.high + tube.low), predicted.y, rtol=1e-9)


def test_fans_are_clipped_to_the_flight(judged) -> None:
    (flight,), _ = judged
    wild = flight.rolled._replace(errors=100.0 * flight.rolled.errors)
    for panel in fan_figure(flight._replace(rolled=wild)).panels:
        measured = panel.layers[0].y
        assert panel.y.low < measured.min() < measured.max() < panel.y.high
        assert panel.y.high - panel.y.low == pytest.approx(1.5 * np.ptp(measured))


def test_tubes_grow_with_the_horizon(judged) -> None:
    (flight,), _ = judged
    growth = growth_figure(flight)
    position = next(panel for panel in growth.panels if panel.y.title == "position [m]")
    tube = next(layer for layer in position.layers if layer.name == "tube")
    assert np.all(np.diff(tube.high) > 0.0)
    assert "-0" not in rollout_verdict(judged[1])
