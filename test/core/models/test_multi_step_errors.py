# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.frames import Array
from quadpi_core.models import multi_step_errors
from quadpi_core.models.disturbance import AxisDisturbance, Disturbance
from quadpi_core.models.multi_step_errors import (
    EVERY_S,
    HORIZONS_S,
    Windows,
    all_rolled,
    log_ratio,
    mean_norms,
    median_norms,
    part_of,
)
from quadpi_core.models.physical_terms import TERM_INDEX, TERMS
from quadpi_core.models.rollout_flight import RolloutFlight
from quadpi_core.models.rollout_model import MOVES
from test.core.models.flights_ahead import ahead, true_model
from test.core.models.physical_flights import STEP_S, known_parameters

PROCESS = Disturbance((AxisDisturbance(0.01, 0.3, 0.1),) * 6, STEP_S)
MODEL = true_model(PROCESS)


@pytest.fixture(scope="module")
def flight() -> RolloutFlight:
    return ahead(6.0, 1, noise=1.0)


@pytest.fixture(scope="module")
def windows(flight: RolloutFlight) -> Windows:
    return Windows.of(flight, MODEL)


def test_roll_outs_start_every_half_second_with_the_disturbance_of_predictions(
    flight: RolloutFlight, windows: Windows
) -> None:
    assert np.diff(windows.starts).tolist() == [round(EVERY_S / STEP_S)] * (len(windows.starts) - 1)
    assert windows.horizons.tolist() == [round(horizon / STEP_S) for horizon in HORIZONS_S]
    predicted = MODEL.predicted(flight, windows.starts, windows.horizons)
    rolled = windows.rolled(MODEL.parameters, derivatives=False)
    np.testing.assert_allclose(rolled.errors, predicted.errors, rtol=1e-9, atol=1e-12)


def test_the_regressors_of_a_long_flight_are_filtered_in_parts(
    flight: RolloutFlight, windows: Windows, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(multi_step_errors, "_SAMPLES", 130)
    np.testing.assert_allclose(Windows.of(flight, MODEL).predicted, windows.predicted, rtol=1e-9, atol=1e-15)


def test_the_gradient_is_that_of_the_cost(windows: Windows) -> None:
    free = MOVES & np.isin(np.arange(len(TERMS)), [TERM_INDEX[n] for n in ("thrust", "hub_height", "drag_x")])
    unit = 0.1 * np.abs(known_parameters()[free])
    scale = median_norms(windows.rolled(MODEL.parameters, derivatives=False))

    def cost(moved: Array) -> float:
        values = MODEL.parameters.copy()
        values[free] += moved * unit
        return part_of(windows.rolled(values, derivatives=False), scale, free, unit).value

    part = part_of(windows.rolled(MODEL.parameters, derivatives=True), scale, free, unit)
    for k in range(3):
        step = 1e-4 * np.eye(3)[k]
        slope = (cost(step) - cost(-step)) / 2e-4
        assert part.gradient[k] == pytest.approx(slope, rel=1e-3, abs=1e-3 * np.abs(part.gradient).max())
    np.testing.assert_allclose(part.blocks.sum(axis=0), part.gradient)
    assert np.all(np.linalg.eigvalsh(part.matrix) > 0.0)


def test_starts_whose_roll_out_is_not_finite_are_left_out(flight: RolloutFlight, windows: Windows) -> None:
    motion = flight.motion.copy()
    motion["rates"][300] = np.nan
    found = Windows.of(replace(flight, motion=motion), MODEL)
    # The disturbance after that sample is not known either.
    assert found.starts.tolist() == [start for start in windows.starts if start + 50 < 300]
    assert np.all(np.isfinite(found.rolled(MODEL.parameters, derivatives=False).errors))


def test_rotor_speeds_missing_in_a_window_leave_it_out(flight: RolloutFlight, windows: Windows) -> None:
    motion = flight.motion.copy()
    motion["rotor_speeds"][320:325, 2] = 0.0
    found = Windows.of(replace(flight, motion=motion), MODEL)
    assert set(windows.starts.tolist()) - set(found.starts.tolist()) == {300}


def test_errors_of_flights_are_compared_by_their_ratio(windows: Windows) -> None:
    wrong = MODEL.parameters.copy()
    wrong[TERM_INDEX["hub_height"]] *= 3.0
    right, worse = mean_norms([windows, windows], [MODEL.parameters, wrong])
    assert log_ratio(np.array([right]), np.array([right])) == 0.0
    assert log_ratio(2.0 * np.array([right]), np.array([right])) == pytest.approx(np.log(2.0))
    assert log_ratio(np.array([worse]), np.array([right])) > 0.0
    diverged = right.copy()
    diverged[-1, 2] = np.inf
    assert log_ratio(np.array([diverged]), np.array([right])) > 1e300


def test_flights_are_rolled_out_in_their_order(windows: Windows) -> None:
    short = windows._replace(
        starts=windows.starts[:2], measured=windows.measured[:2], predicted=windows.predicted[:2]
    )
    first, second = all_rolled([windows, short], MODEL.parameters, derivatives=False)
    assert (len(first.errors), len(second.errors)) == (len(windows.starts), 2)
