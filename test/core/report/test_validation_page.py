# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.evaluation.evaluate import evaluate_rollouts
from quadpi_core.flight import AXES
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.report.table import markdown_table
from quadpi_core.report.validation_page import (
    fan_figure,
    growth_figure,
    rollout_summary,
    rollout_verdict,
    validation_table,
    validation_verdict,
    write_rollout_page,
)
from quadpi_core.validation.validation_result import (
    AxisValidation,
    ModelValidation,
    NoiseLevels,
    Validation,
    Variation,
)
from quadpi_core.vehicle import Vehicle

from .conftest import Page


def test_only_model_and_measurement_variation_are_judged(markdown_cells):
    variation = Variation(0.9437, None, 1.0, 1.0, 0.0345, 1.0)
    axis = AxisValidation(variation, variation, replace(variation, nmpiw=1.0))
    models = {"m": ModelValidation("m", "polynomial", "default", dict.fromkeys(AXES, axis), {})}
    result = Validation("0", "v", 0.95, 0, 1, NoiseLevels(*[0.1] * 5), 30.0, {}, models)
    heading, *body = markdown_cells(validation_table(result, AXES[2:4]))
    assert heading[2:] == [
        *("PICP % train", "PICP % model", "PICP % meas.", "PICP % both"),
        *("NMPIW % train", "NMPIW % model", "NMPIW % meas."),
    ]
    assert body[1] == ["Mx", "m", "", "▼ 94.37", "▼ 94.37", "94.37", "", "3.45", "3.45"]
    assert [row[0] for row in body] == ["Fz", "Mx"]


@pytest.mark.parametrize(
    ("spread", "said"),
    [
        (
            0.001,
            "do not hold in 1 on the measurement variation "
            "(m Fx 90.0 %, 95 % confidence interval 89.9 % to 90.1 %)",
        ),
        (
            0.1,
            "are not shown to hold in 1 on the measurement variation "
            "(m Fx 90.0 %, 95 % confidence interval 82.8 % to 97.2 %)",
        ),
        (None, "m Fx 90.0 %, its precision unknown"),
    ],
)
def test_headline_of_a_validation_goes_by_it_too(spread, said):
    held = Variation(picp=0.99, picp_sd=0.001, mpiw=1.0, range=1.0, nmpiw=1.0, nmpiw_training=1.0)
    measured = replace(held, picp=0.9, picp_sd=spread)
    model = ModelValidation("m", "polynomial", "default", {"Fx": AxisValidation(held, measured, held)}, {})
    noise = NoiseLevels(*[0.1] * 5)
    result = Validation("0", "v", 0.95, 1, 10, noise, 30.0, {}, {"m": model})
    sentence = validation_verdict(result)
    assert "95\u00a0% intervals hold in 1 of 1 on the model variation and 0 of 1 on" in sentence
    assert said in sentence


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
