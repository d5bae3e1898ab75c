# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import pytest

from quadpi_core.flight import AXES
from quadpi_core.report.validation_page import validation_table, validation_verdict
from quadpi_core.validation.validation_result import (
    AxisValidation,
    ModelValidation,
    NoiseLevels,
    Validation,
    Variation,
)


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
