# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Noise on flights, and what is counted of it."""

from __future__ import annotations

import io
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.stats import norm

from quadpi_core.inputs import flight_inputs
from quadpi_core.models.kinds.polynomial import Polynomial
from quadpi_core.models.model_kind import Evaluation
from quadpi_core.parallel import Workers
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.simulation.sensor_noise import StateNoise, contaminate
from quadpi_core.validation import validation_case as realisation_chunks
from quadpi_core.validation.validation_case import (
    ValidationCase,
    noise_seed,
    noisy_flight,
    realise,
    run_realisations,
    spread,
)

# All work in this process.
HERE = Workers(1)


def test_counts_are_those_of_the_definition(case, model, vehicle):
    tally = realise(case, range(4, 6))
    for row, realisation in enumerate((4, 5)):
        for column, flight in enumerate(case.flights):
            noisy = contaminate(flight, case.noise, noise_seed(case.seed, flight.name, realisation))
            clean = model.evaluate(flight_inputs(flight, vehicle), 0.95)
            said = model.evaluate(flight_inputs(noisy, vehicle), 0.95)
            measured = measured_wrench(noisy, vehicle)
            where = (row, 0, column)

            def count(values, evaluation):
                return np.sum((evaluation.lower <= values) & (values <= evaluation.upper), axis=0)

            np.testing.assert_array_equal(tally.model[where], count(said.predicted, clean))
            np.testing.assert_array_equal(tally.measurement[where], count(measured, clean))
            np.testing.assert_array_equal(tally.combined[where], count(measured, said))
            np.testing.assert_allclose(
                tally.width[where], (said.upper - said.lower).sum(axis=0), rtol=1e-12, atol=0.0
            )
            np.testing.assert_array_equal(tally.predicted[where][:, 0], said.predicted.min(axis=0))
            np.testing.assert_array_equal(tally.predicted[where][:, 1], said.predicted.max(axis=0))
            np.testing.assert_array_equal(tally.measured[row, column].T, [measured.min(0), measured.max(0)])


def test_a_realisation_depends_on_nothing_else(case, same):
    together = realise(case, range(4))
    alone = realise(case, range(2, 3))
    assert same(alone, type(alone)(**{name: values[2:3] for name, values in vars(together).items()}))
    only_second = replace(case, flights=case.flights[1:])
    np.testing.assert_array_equal(realise(only_second, range(4)).width[:, :, 0], together.width[:, :, 1])


def test_noise_is_independent_between_realisations_flights_and_seeds(case):
    flight = case.flights[0]

    def noise(case, flight, realisation):
        return (noisy_flight(case, flight, realisation).velocity - flight.velocity).ravel()

    one = noise(case, flight, 0)
    others = [
        noise(case, flight, 1),
        noise(replace(case, seed=8), flight, 0),
        noise(case, replace(flight, name="other"), 0),
    ]
    for other in others:
        assert abs(np.corrcoef(one, other)[0, 1]) < 0.05
    np.testing.assert_array_equal(one, noise(case, flight, 0))


def test_without_noise_every_prediction_is_in_its_own_interval(case):
    tally = realise(replace(case, noise=StateNoise()), range(1))
    held = [0, 2]
    sizes = np.array([len(flight) for flight in case.flights])
    np.testing.assert_array_equal(tally.model[0, 0][:, held], np.column_stack((sizes, sizes)))
    np.testing.assert_array_equal(tally.measurement, tally.combined)


@dataclass(frozen=True)
class Oracle:
    """Knows the wrench without noise, and how large the noise of the force is."""

    truth: np.ndarray
    std: float
    cutoff_hz: float = 250.0
    kind = Polynomial

    def evaluate(self, inputs, confidence, _derivatives):
        half = norm.ppf(0.5 + confidence / 2.0) * self.std
        nothing = np.zeros_like(self.truth)
        assert len(inputs) == len(self.truth)
        return Evaluation(self.truth, self.truth - half, self.truth + half, nothing, nothing)


@pytest.mark.parametrize("confidence", [0.8, 0.95])
def test_intervals_of_the_true_noise_cover_as_they_say(clean, vehicle, confidence):
    flight = clean[0]
    oracle = Oracle(measured_wrench(flight, vehicle), vehicle.mass_kg * 0.03)
    case = ValidationCase(
        vehicle, {"oracle": oracle}, (flight,), StateNoise(specific_force=0.03), confidence, 5
    )
    tally = realise(case, range(40))
    trials = 40 * len(flight)
    tolerance = 4.0 * np.sqrt(confidence * (1.0 - confidence) / trials)
    np.testing.assert_allclose(tally.measurement[..., :3].sum(axis=0) / trials, confidence, atol=tolerance)


def test_spread_is_between_the_extremes_of_its_realisations(case):
    found = spread(case, "up", range(3))
    flight = case.flights[1]
    runs = [case.samples(noisy_flight(case, flight, realisation)) for realisation in range(3)]
    measured = np.stack([run.wrench for run in runs])
    said = np.stack([case.models["fitted"].evaluate(run.inputs, 0.95).predicted for run in runs])
    np.testing.assert_array_equal(found.measured, [measured.min(axis=0), measured.max(axis=0)])
    np.testing.assert_array_equal(found.predicted["fitted"], [said.min(axis=0), said.max(axis=0)])


COUNT = 7


@pytest.fixture(autouse=True)
def short_chunks(monkeypatch):
    monkeypatch.setattr(realisation_chunks, "CHUNK", 3)


@pytest.fixture
def counted(monkeypatch):
    """The chunks that were counted and not read."""
    spans = []

    def count(case, span):
        spans.append(span)
        return realise(case, span)

    monkeypatch.setattr(realisation_chunks, "realise", count)
    return spans


def test_chunks_join_to_the_whole(case, same, tmp_path):
    whole = realise(case, range(COUNT))
    assert same(run_realisations(case, COUNT, workers=HERE), whole)
    assert same(run_realisations(case, COUNT, workers=HERE, folder=tmp_path), whole)
    assert same(run_realisations(case, COUNT, workers=HERE, folder=tmp_path), whole)


def test_finished_chunks_are_not_counted_again(case, tmp_path, counted):
    run_realisations(case, 6, workers=HERE, folder=tmp_path)
    assert counted == [range(3), range(3, 6)]
    run_realisations(case, COUNT, workers=HERE, folder=tmp_path)
    assert counted[2:] == [range(6, 7)]


def with_objects(content: bytes) -> bytes:
    arrays = dict(np.load(io.BytesIO(content)))
    np.savez(changed := io.BytesIO(), **arrays | {"model": np.array([{"an": "object"}], dtype=object)})
    return changed.getvalue()


@pytest.mark.parametrize(
    "damage", [lambda _: b"", lambda content: content[:-200], lambda _: b"nothing of ours", with_objects]
)
def test_damaged_chunk_is_counted_again(case, same, tmp_path, counted, damage):
    whole = run_realisations(case, 6, workers=HERE, folder=tmp_path)
    damaged = sorted(tmp_path.rglob("*.npz"))[1]
    damaged.write_bytes(damage(damaged.read_bytes()))
    assert same(run_realisations(case, 6, workers=HERE, folder=tmp_path), whole)
    assert counted[2:] == [range(3, 6)]


def test_chunks_of_another_case_are_left_alone(case, model, tmp_path, counted):
    narrower = model.fitted.with_rules({"Fx": replace(model.fitted.axes["Fx"].rule, std=1e-3)})
    others = [
        replace(case, seed=8),
        replace(case, confidence=0.9),
        replace(case, noise=replace(case.noise, rates=0.02)),
        replace(case, flights=case.flights[:1]),
        replace(case, flights=(replace(case.flights[0], wind=case.flights[0].wind + 0.1), case.flights[1])),
        replace(case, models={"fitted": replace(model, fitted=narrower)}),
        replace(case, models={"named": model}),
    ]
    run_realisations(case, 3, workers=HERE, folder=tmp_path)
    for other in others:
        run_realisations(other, 3, workers=HERE, folder=tmp_path)
    assert len(counted) == len(list(tmp_path.iterdir())) == 1 + len(others)


def test_interrupted_run_is_taken_up(case, same, tmp_path, counted):
    def interrupt(progress):
        if progress.done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_realisations(case, COUNT, workers=Workers(1, progress=interrupt), folder=tmp_path)
    seen = []
    resumed = run_realisations(case, COUNT, workers=Workers(1, progress=seen.append), folder=tmp_path)
    assert counted == [range(3), range(3, 6), range(6, 7)]
    assert [progress.done for progress in seen] == [3, 6, 7]
    assert same(resumed, realise(case, range(COUNT)))


@pytest.mark.slow
def test_workers_and_a_cluster_count_the_same(case, same, tmp_path, cluster):
    whole = realise(case, range(COUNT))
    assert case.references  # computed here; each worker computes its own
    assert same(run_realisations(case, COUNT, workers=Workers(2)), whole)
    assert same(run_realisations(case, COUNT, workers=Workers(scheduler=cluster), folder=tmp_path), whole)
    assert len(list(tmp_path.rglob("*.npz"))) == 3
