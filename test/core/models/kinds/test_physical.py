# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.models.kind_registry import kind_named
from quadpi_core.models.kinds.physical import Physical
from quadpi_core.models.model_kind import Evaluation, Fit, IdentifyOptions
from quadpi_core.models.physical_fit import PhysicalFlight, Sensing
from quadpi_core.models.regressors import CandidatePool
from quadpi_core.parallel import ignore_progress
from test.core.models.physical_flights import (
    NOISE,
    derivatives_of,
    flown,
    inputs_of,
    samples_of,
    swept,
)

KIND = kind_named("physical")
OPTIONS = IdentifyOptions(method="physical")
# Its forces and moments are those of KIND; without what predicts ahead it takes half the time.
FIRST_STEP = Physical(multi_step=False)


def evaluated(fit: Fit, flight: PhysicalFlight) -> Evaluation:
    return fit.fitted.evaluate(inputs_of(flight), fit.fitted.factors(0.95), derivatives_of(flight))


def pools(*axes: str) -> dict[str, CandidatePool]:
    return {axis: CandidatePool((), ()) for axis in axes}


@pytest.fixture(scope="module")
def fit() -> Fit:
    samples = samples_of([flown(20.0, seed) for seed in (1, 2, 3)])
    return KIND.fit(samples, pools(*AXES), OPTIONS, ignore_progress)


def test_flights_unseen_and_faster_are_predicted_and_covered(fit: Fit) -> None:
    faster = flown(20.0, 9, speed=6.0)
    result = evaluated(fit, faster)
    errors = np.sqrt(np.mean(np.square(faster.wrench - result.predicted), axis=0))
    assert np.all(errors < 1.5 * NOISE)
    inside = (result.lower <= faster.wrench) & (faster.wrench <= result.upper)
    assert np.all(np.mean(inside, axis=0) > 0.9)
    assert np.all(result.leverage > 0.0)


def test_a_flight_of_another_day_with_less_thrust_is_covered(fit: Fit) -> None:
    """Thrust differs between flights by more than the flights of one day tell."""
    weak = flown(20.0, 12)
    weak.wrench[:, 2] *= 0.98
    result = evaluated(fit, weak)
    inside = (result.lower[:, 2] <= weak.wrench[:, 2]) & (weak.wrench[:, 2] <= result.upper[:, 2])
    assert np.mean(inside) > 0.9


def test_a_stored_model_is_read_with_the_same_bits(fit: Fit) -> None:
    stored = fit.fitted.store()
    read = Fit(KIND.fitted_type.read(stored))
    for before, after in zip(evaluated(fit, flown(1.0, 4)), evaluated(read, flown(1.0, 4)), strict=True):
        np.testing.assert_array_equal(before, after)
    lines = stored.files["parameters.csv"].decode().splitlines()
    assert lines[0] == "parameter,value,standard_error,unit,meaning,note"
    assert lines[1].startswith("thrust,")
    # What the axes share is stored once.
    assert sorted(name for name in stored.arrays if "." not in name) == [
        "covariance",
        "inertia",
        "values",
        "vehicle",
    ]


def test_a_folder_without_its_fit_is_refused(fit: Fit) -> None:
    with pytest.raises(ModelError, match=r"fit\.json: missing"):
        KIND.fitted_type.read(replace(fit.fitted.store(), files={}))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        ({"rotor_delay_s": -1.0}, r"fit\.json: .*rotor_delay_s"),
        ({"force_bandwidth_hz": 0.0}, r"fit\.json: .*force_bandwidth_hz"),
        ({"parameters": ["warp"]}, "parameter 'warp' is not known to this version"),
        ({"notes": {"warp": "at a bound"}}, "parameter 'warp' is not known"),
        ({"log": [{"step": "", "of": "", "error": 1.0}]}, r"fit\.json: .*log"),
    ],
)
def test_a_fit_file_that_no_fit_gives_is_refused(fit: Fit, damage: dict[str, Any], message: str) -> None:
    stored = fit.fitted.store()
    content = {**json.loads(stored.files["fit.json"]), **damage}
    with pytest.raises(ModelError, match=message):
        KIND.fitted_type.read(replace(stored, files={"fit.json": json.dumps(content).encode()}))


def test_facts_are_parameters_pairs_and_log(fit: Fit) -> None:
    parameters, pairs, ahead, ahead_pairs, log = fit.fitted.facts(fit.rollouts)
    assert ahead.title == "parameters that predict ahead"
    assert "imu_x" in {row[0] for row in parameters.rows} - {row[0] for row in ahead.rows}
    assert abs(float(ahead_pairs.rows[0][2])) > 0.9
    assert parameters.note.startswith("rotor speeds act 0 ms after they were measured")
    assert parameters.rows[0][0] == "thrust"
    assert abs(float(pairs.rows[0][2])) > 0.9
    assert {row[0] for row in log.rows} >= {"rotor delay", "force bandwidth", "gain of a group kept"}


def test_errors_are_judged_by_forces_as_they_were_recorded() -> None:
    """Errors of flights left out are those of forces smoothed alike."""
    flights = []
    for flight in (swept(20.0, seed, noise=0.1, fastest_hz=20.0) for seed in (1, 2)):
        wrench = flight.wrench.copy()
        wrench[:, :3] = flight.recorded(wrench[:, :3, np.newaxis], Sensing(0.0, 7.0))[:, :, 0]
        flights.append(replace(flight, wrench=wrench))
    smoothed = FIRST_STEP.fit(samples_of(flights), pools("Fz"), OPTIONS, ignore_progress)
    bandwidth = smoothed.fitted.force_bandwidth_hz
    assert bandwidth is not None
    assert "smoothed alike" in smoothed.fitted.facts(smoothed.rollouts)[0].note
    raw = evaluated(smoothed, flights[0]).predicted[:, 2]
    unsmoothed = np.std(flights[0].wrench[:, 2] - raw)
    assert np.std(smoothed.held_out["Fz"][0].error) < 0.3 * unsmoothed


def test_some_axes_alone_give_the_same_parameters(fit: Fit) -> None:
    samples = samples_of([flown(20.0, seed) for seed in (1, 2, 3)])
    alone = FIRST_STEP.fit(samples, pools("Fz"), OPTIONS, ignore_progress)
    assert list(alone.fitted.axes) == ["Fz"]
    np.testing.assert_allclose(alone.fitted.parameters.values, fit.fitted.parameters.values)  # type: ignore[attr-defined]
    factors = alone.fitted.factors(0.95)
    result = alone.fitted.evaluate(samples.inputs[:5], factors, samples.derivatives[:5])
    assert np.all(result.predicted[:, 2] < 0.0)
    assert np.all(result.predicted[:, :2] == 0.0)


def test_flights_that_stand_still_give_a_model() -> None:
    """Terms that are the same throughout have a covariance that rounding leaves indefinite."""
    still = []
    for seed in (1, 2):
        flight = flown(5.0, seed, speed=0.0, noise=0.001)
        motion = flight.motion.copy()
        motion[:] = flight.motion[-1]
        motion["rotor_speeds"] += np.random.default_rng(seed).normal(scale=0.1, size=(len(motion), 4))
        still.append(replace(flight, motion=motion, rotor_jerks=np.zeros_like(flight.rotor_jerks)))
    fit = replace(KIND, multi_step=False).fit(  # type: ignore[type-var]
        samples_of(still), pools(*AXES), OPTIONS, ignore_progress
    )
    result = evaluated(fit, still[0])
    assert np.all(np.isfinite(result.lower))
    assert np.all(result.lower < result.upper)
    words = fit.fitted.facts(None)[0].note
    assert "do not tell delays of 0 to 15 ms apart" in words
    assert "what would tell them, and how many: " in words
