# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What realisations add up to."""

from __future__ import annotations

import json

import numpy as np
import pytest

from quadpi_core.config_schema import check_config
from quadpi_core.inputs import flight_inputs
from quadpi_core.validation.validation_case import Tally, realise
from quadpi_core.validation.validation_result import VARIATIONS, Validation, summarise


@pytest.fixture
def tally(case):
    """Two realisations; of Fx a tenth and three tenths of all samples lie inside, and every width is 2 N."""
    tally = Tally.empty(2, 1, 2)
    sizes = np.array([len(flight) for flight in case.flights])
    for row, share in enumerate((0.1, 0.3)):
        for inside in (tally.model, tally.measurement, tally.combined):
            inside[row, 0, :, 0] = np.round(share * sizes)
    tally.width[:] = 2.0 * sizes[:, None]
    tally.measured[..., 0], tally.measured[..., 1] = -1.0, 3.0
    tally.measured[1, 1, 0] = -2.0, 5.0
    tally.predicted[..., 1] = 0.5
    return tally


def test_numbers_of_known_counts(case, tally, model):
    result = summarise(case, tally).models["fitted"].axes["Fx"]
    assert result.training is None
    combined = result.combined_variation
    assert combined.picp == pytest.approx(0.2, abs=1e-3)
    assert combined.picp_sd == pytest.approx(0.2 / np.sqrt(2.0), abs=1e-3)
    assert combined.mpiw == pytest.approx(2.0)
    # Over both flights the measurements span 4 N in one realisation and 7 N in the other.
    assert combined.range == pytest.approx(5.5)
    assert combined.nmpiw == pytest.approx(2.0 / 5.5)
    assert combined.nmpiw_training == pytest.approx(2.0 / model.training_range["Fx"])
    assert result.model_variation.range == pytest.approx(0.5)


def test_width_of_model_and_measurement_variation_is_that_without_noise(case, tally, model, vehicle):
    result = summarise(case, tally).models["fitted"].axes["Fz"]
    said = model.evaluate(np.concatenate([flight_inputs(flight, vehicle) for flight in case.flights]), 0.95)
    width = (said.upper - said.lower)[:, 2].mean()
    for variation in VARIATIONS[:2]:
        assert getattr(result, variation).mpiw == pytest.approx(width, rel=1e-12)


def test_flights_add_up_to_the_whole(case):
    result = summarise(case, realise(case, range(3))).models["fitted"]
    sizes = [len(flight) for flight in case.flights]
    for axis in case.models["fitted"].axes:
        for variation in VARIATIONS:
            shares = [getattr(result.flights[flight.name][axis], variation) for flight in case.flights]
            assert np.average(shares, weights=sizes) == pytest.approx(
                getattr(result.axes[axis], variation).picp
            )


def test_one_realisation_is_json_without_nan(case):
    result = summarise(case, realise(case, range(1)))
    text = json.dumps(result.to_json(), allow_nan=False)
    assert json.loads(text)["models"]["fitted"]["axes"]["Fx"]["model_variation"]["picp_sd"] is None
    assert check_config(Validation, json.loads(text)) == result
    assert set(result.models["fitted"].axes) == {"Fx", "Fz"}
