# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Coverage and width of models under realisations of noise on flights.

Every realisation of every flight has a seed of its own, so the counts depend neither on the workers nor on
their order.
"""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import numpy.typing as npt

from quadpi_core.flight import AXES, Flight
from quadpi_core.frames import Array
from quadpi_core.models.interval_rules import inside_interval
from quadpi_core.parallel import DEFAULT_WORKERS, Progress, Workers
from quadpi_core.paths import whole_output
from quadpi_core.simulation.sensor_noise import contaminate
from quadpi_core.validation.validation_case import Samples, ValidationCase

Counts = npt.NDArray[np.int64]

LOWEST, HIGHEST = 0, 1


@dataclass(frozen=True)
class Tally:
    """Counts and extremes over R realisations of F flights, for M models and each axis.

    Attributes:
        model: (R, M, F, 6) predictions from noisy inputs inside the interval at the noise-free ones.
        measurement: (R, M, F, 6) noisy measurements inside the interval at the noise-free inputs.
        combined: (R, M, F, 6) noisy measurements inside the interval at the noisy inputs.
        width: (R, M, F, 6) sum of the widths at the noisy inputs.
        predicted: (R, M, F, 6, 2) lowest and highest prediction from noisy inputs.
        measured: (R, F, 6, 2) lowest and highest noisy measurement.
    """

    model: Counts
    measurement: Counts
    combined: Counts
    width: Array
    predicted: Array
    measured: Array

    @classmethod
    def empty(cls, realisations: int, models: int, flights: int) -> Tally:
        """A tally of zeros."""
        shape = (realisations, models, flights, len(AXES))
        return cls(
            model=np.zeros(shape, dtype=np.int64),
            measurement=np.zeros(shape, dtype=np.int64),
            combined=np.zeros(shape, dtype=np.int64),
            width=np.zeros(shape),
            predicted=np.zeros((*shape, 2)),
            measured=np.zeros((realisations, flights, len(AXES), 2)),
        )

    @classmethod
    def joined(cls, parts: Sequence[Tally]) -> Tally:
        """The realisations of all parts, one after the other."""
        columns = [column.name for column in fields(cls)]
        return cls(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in columns})


@dataclass(frozen=True)
class Spread:
    """Extremes over realisations of one flight, at each of its N samples.

    Attributes:
        measured: (2, N, 6) lowest and highest noisy measurement.
        predicted: by model, (2, N, 6) lowest and highest prediction from noisy inputs.
    """

    measured: Array
    predicted: dict[str, Array]


def noisy_flight(case: ValidationCase, flight: Flight, realisation: int) -> Flight:
    """The flight with noise that depends on seed, name of the flight and realisation alone."""
    return contaminate(flight, case.noise, noise_seed(case.seed, flight.name, realisation))


def noise_seed(seed: int, name: str, realisation: int) -> int:
    """Seed of one realisation of one flight, independent of all others."""
    sequence = np.random.SeedSequence(seed, spawn_key=(zlib.crc32(name.encode()), realisation))
    return int.from_bytes(sequence.generate_state(4).astype("<u4").tobytes(), "little")


def realise(case: ValidationCase, realisations: range) -> Tally:
    """Tally of some realisations of a case."""
    tally = Tally.empty(len(realisations), len(case.models), len(case.flights))
    for row, realisation in enumerate(realisations):
        for column, flight in enumerate(case.flights):
            noisy = case.samples(noisy_flight(case, flight, realisation))
            tally.measured[row, column] = _extremes(noisy.wrench)
            for place, name in enumerate(case.models):
                _count(tally, (row, place, column), case, name, noisy)
    return tally


def spread(case: ValidationCase, flight: str, realisations: range) -> Spread:
    """Extremes over some realisations of a flight, given by name."""
    clean = next(candidate for candidate in case.flights if candidate.name == flight)
    measured: Array | None = None
    predicted: dict[str, Array] = {}
    for realisation in realisations:
        noisy = case.samples(noisy_flight(case, clean, realisation))
        measured = _widened(measured, noisy.wrench)
        for name, model in case.models.items():
            prediction = model.evaluate(noisy.inputs, case.confidence, noisy.derivatives).predicted
            predicted[name] = _widened(predicted.get(name), prediction)
    if measured is None:
        raise ValueError("no realisations given")
    return Spread(measured, predicted)


def _extremes(values: Array) -> Array:
    """Lowest and highest (A, 2) of values (N, A)."""
    return np.stack((values.min(axis=0), values.max(axis=0)), axis=-1)


def _widened(extremes: Array | None, values: Array) -> Array:
    if extremes is None:
        return np.stack((values, values))
    return np.stack((np.minimum(extremes[LOWEST], values), np.maximum(extremes[HIGHEST], values)))


def _count(
    tally: Tally, where: tuple[int, int, int], case: ValidationCase, name: str, noisy: Samples
) -> None:
    """Fill in one realisation, model and flight."""
    reference = case.references[name][where[-1]]
    evaluation = case.models[name].evaluate(noisy.inputs, case.confidence, noisy.derivatives)
    for counts, values, interval in (
        (tally.model, evaluation.predicted, reference),
        (tally.measurement, noisy.wrench, reference),
        (tally.combined, noisy.wrench, evaluation),
    ):
        counts[where] = inside_interval(values, interval.lower, interval.upper).sum(axis=0)
    tally.width[where] = (evaluation.upper - evaluation.lower).sum(axis=0)
    tally.predicted[where] = _extremes(evaluation.predicted)


# Realisations of one task: some seconds of work, so that an interruption loses little.
CHUNK = 5


def run_realisations(
    case: ValidationCase,
    count: int,
    *,
    folder: Path | None = None,
    workers: Workers = DEFAULT_WORKERS,
) -> Tally:
    """Count the first `count` realisations of a case; the result does not depend on the workers.

    Args:
        case: checked.
        count: of realisations, at least one.
        folder: of finished chunks, from which a later run of the same case continues.
        workers: that do the counting.

    Raises:
        ParallelError: see :meth:`quadpi_core.parallel.Workers.map`.
        OutputError: if a chunk cannot be kept.
    """
    spans = [range(start, min(start + CHUNK, count)) for start in range(0, count, CHUNK)]
    tallies = [None if folder is None else _read(_path(folder, case, span), case, span) for span in spans]
    missing = [k for k, tally in enumerate(tallies) if tally is None]
    finished = sum(len(spans[k]) for k in range(len(spans)) if k not in set(missing))
    workers.progress(Progress("Realisations", finished, count))

    def done(index: int, tally: Tally) -> None:
        nonlocal finished
        span = spans[missing[index]]
        if folder is not None:
            _write(_path(folder, case, span), tally)
        finished += len(span)
        workers.progress(Progress("Realisations", finished, count))

    counted = workers.map(realise, [spans[k] for k in missing], shared=case, done=done)
    for k, tally in zip(missing, counted, strict=True):
        tallies[k] = tally
    return Tally.joined([tally for tally in tallies if tally is not None])


def _path(folder: Path, case: ValidationCase, span: range) -> Path:
    return folder / case.fingerprint[:16] / f"{span.start:06d}-{span.stop:06d}.npz"


def _write(path: Path, tally: Tally) -> None:
    with whole_output(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **{column.name: getattr(tally, column.name) for column in fields(tally)})


def _read(path: Path, case: ValidationCase, span: range) -> Tally | None:
    """Tally of a stored chunk; None where the file is missing or damaged."""
    expected = Tally.empty(len(span), len(case.models), len(case.flights))
    try:
        with np.load(path, allow_pickle=False) as file:
            tally = Tally(**{column.name: file[column.name] for column in fields(Tally)})
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    same = all(
        getattr(tally, column.name).shape == getattr(expected, column.name).shape for column in fields(Tally)
    )
    return tally if same else None
