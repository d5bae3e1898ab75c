# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Stored polynomials that no fit gives; what they predict is in test_aerodynamic.py."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.models.fitted_polynomial import FittedPolynomials, PolynomialAxis
from quadpi_core.models.interval_rules import NormalRule
from quadpi_core.models.regressors import Regressor

TERMS = tuple(map(Regressor.parse, ("bias", "|v|*w")))
MODEL = FittedPolynomials({"Fx": PolynomialAxis(TERMS, np.ones(2), np.eye(2), 2.0, 0.1, NormalRule(), 1.0)})


def test_what_was_stored_is_read() -> None:
    stored = MODEL.store()
    assert list(stored.entries["Fx"]) == ["regressors", "inflation", "growth", "rule", "rms_spread"]
    assert stored.entries["Fx"]["regressors"] == MODEL.axes["Fx"].terms == ["bias", "|v|*w"]
    assert FittedPolynomials.read(stored).axes["Fx"].regressors == TERMS


@pytest.mark.parametrize(
    ("entry", "arrays", "message"),
    [
        ({"regressors": ["bias"]}, {}, "shapes do not fit the 1 regressors"),
        ({"regressors": ["bias", "zeta"]}, {}, "zeta"),
        ({"inflation": -1.0}, {}, "`inflation` must be a number not below 0"),
        ({"rms_spread": 0.5}, {}, "`rms_spread` must be a number not below 1"),
        ({}, {"Fx.coefficients": np.ones(3)}, "shapes do not fit the 2 regressors"),
        ({}, {"Fx.whitening": np.ones(2)}, "shapes do not fit the 2 regressors"),
    ],
)
def test_numbers_that_no_fit_gives_are_refused(entry: Any, arrays: Any, message: str) -> None:
    stored = MODEL.store()
    entries = {"Fx": {**stored.entries["Fx"], **entry}}
    with pytest.raises(ModelError, match=f"^Fx: .*{message}"):
        FittedPolynomials.read(replace(stored, entries=entries, arrays={**stored.arrays, **arrays}))
