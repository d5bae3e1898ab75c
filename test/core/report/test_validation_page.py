# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import pytest

from quadpi_core.flight import AXES
from quadpi_core.paper.published import published_tables
from quadpi_core.paper.validation_result import (
    AxisValidation,
    ModelValidation,
    NoiseLevels,
    TrainingCoverage,
    Validation,
    Variation,
)
from quadpi_core.report.validation_page import validation_table, validation_verdict


def test_validation_has_both_settings_above_the_papers_numbers(markdown_cells):
    def result(settings, picp):
        variation = Variation(picp, None, 1.0, 1.0, 0.0345, 1.0)
        axis = AxisValidation(TrainingCoverage(picp, 1.0, 1.0, 0.0345), variation, variation, variation)
        models = {"polynomial": ModelValidation("m", "polynomial", settings, dict.fromkeys(AXES, axis), {})}
        noise = NoiseLevels(*[0.1] * 5)
        return Validation("0", "v", 0.95, 0, 1, noise, 30.0, {}, models, published_tables())

    heading, *body = markdown_cells(
        validation_table([result("paper", 0.9437), result("default", 1.0)], AXES[2:4], with_settings=True)
    )
    assert len(heading) == 10
    assert [row[2] for row in body] == ["paper", "default", "*published*"] * 2
    # Training and combined variation stand for reference: they are not judged.
    assert body[0][3:] == ["94.37", "▼ 94.37", "▼ 94.37", "94.37", "3.45", "3.45", "3.45"]
    assert body[2][3:] == ["*96.68*", "*100.00*", "*99.94*", "", "*8.13*", "*27.32*", "*21.78*"]


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
    model = ModelValidation(
        "m", "polynomial", "default", {"Fx": AxisValidation(None, held, measured, held)}, {}
    )
    noise = NoiseLevels(*[0.1] * 5)
    result = Validation("0", "v", 0.95, 1, 10, noise, 30.0, {}, {"m": model}, None)
    sentence = validation_verdict(result)
    assert "95\u00a0% intervals hold in 1 of 1 on the model variation and 0 of 1 on" in sentence
    assert said in sentence
