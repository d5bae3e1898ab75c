# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The case of a validation: models, noise-free flights, and the noise on them."""

from __future__ import annotations

import hashlib
import json
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import LogError, QuadpiError, named_in
from quadpi_core.evaluation.evaluate import common_confidence, load_models
from quadpi_core.flight import AXES, Flight
from quadpi_core.frames import Array
from quadpi_core.inputs import flight_derivatives, flight_inputs
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.interval_rules import inside_interval
from quadpi_core.models.model_kind import Evaluation
from quadpi_core.parallel import DEFAULT_WORKERS, Progress, Workers
from quadpi_core.paths import whole_output
from quadpi_core.reading_options import WHOLE, TimeRange
from quadpi_core.records import Records
from quadpi_core.signals.chain import filter_zero_phase
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.simulation.sensor_noise import SensorSuite, StateNoise, contaminate
from quadpi_core.simulation.simulated_bags import read_truth
from quadpi_core.vehicle import Vehicle
from quadpi_core.version import __version__

_PACKAGE = Path(__file__).resolve().parents[1]
# Folders of the package on which neither a model nor a count depends.
_PRESENTATION = ("report", "cli")


class ValidationError(QuadpiError):
    """Models, flights and noise do not make a validation."""


@dataclass(frozen=True)
class Samples:
    """Inputs of a model and the wrench that it should predict.

    Attributes:
        inputs: (N, 19) input vectors.
        derivatives: (N,) see `quadpi_core.inputs.Derivatives`; None where no model uses them.
        wrench: (N, 6) N and Nm.
    """

    inputs: Array
    derivatives: Records | None
    wrench: Array


@dataclass(frozen=True)
class ValidationCase:
    """Models judged on realisations of noise over flights.

    Attributes:
        vehicle: that flew and that the models are of.
        models: by the name that they have in the result.
        flights: noise-free, of different names.
        noise: on states and measurements.
        confidence: nominal coverage of the intervals.
        seed: of all noise.
    """

    vehicle: Vehicle
    models: Mapping[str, AerodynamicModel]
    flights: tuple[Flight, ...]
    noise: StateNoise
    confidence: float
    seed: int

    def check(self) -> None:
        """Refuse models and flights that cannot be compared.

        Raises:
            ValidationError: for no model or flight, flights of the same name, and models that take another
                low-pass each.
            ModelError: for a model of another vehicle, or that gives no interval of this confidence.
        """
        if not self.models or not self.flights:
            raise ValidationError("a validation needs models and noise-free flights")
        names = [flight.name for flight in self.flights]
        for name in names:
            if names.count(name) > 1:
                raise ValidationError(f"flight {name}: present twice")
        for model in self.models.values():
            model.require(self.vehicle)
            model.fitted.factors(self.confidence)
        cutoffs = {name: f"{model.cutoff_hz:g} Hz" for name, model in self.models.items()}
        if len(set(cutoffs.values())) > 1:
            listed = ", ".join(f"{name} {cutoff}" for name, cutoff in cutoffs.items())
            raise ValidationError(f"models of different low-pass ({listed}): validate them one by one")

    def samples(self, flight: Flight) -> Samples:
        """Inputs and wrench of a flight with noise or without, after the low-pass of the models."""
        flight = low_passed(flight, next(iter(self.models.values())).cutoff_hz)
        needed = any(model.kind.uses_derivatives for model in self.models.values())
        derivatives = flight_derivatives(flight) if needed else None
        return Samples(
            flight_inputs(flight, self.vehicle), derivatives, measured_wrench(flight, self.vehicle)
        )

    @cached_property
    def references(self) -> dict[str, tuple[Evaluation, ...]]:
        """Per model, its predictions and intervals on each of the flights without noise."""
        samples = [self.samples(flight) for flight in self.flights]
        return {
            name: tuple(model.evaluate(own.inputs, self.confidence, own.derivatives) for own in samples)
            for name, model in self.models.items()
        }

    @cached_property
    def fingerprint(self) -> str:
        """Hash of everything that the result depends on except the number of realisations."""
        facts = {
            "quadpi": __version__,
            "code": code_fingerprint(),
            "vehicle": self.vehicle.fingerprint,
            "noise": asdict(self.noise),
            "confidence": self.confidence,
            "seed": self.seed,
            "models": {name: _numbers(model) for name, model in self.models.items()},
            "flights": {flight.name: flight_hash(flight) for flight in self.flights},
        }
        return hashlib.sha256(json.dumps(facts).encode()).hexdigest()

    def __getstate__(self) -> dict[str, Any]:
        """State for pickling, without cached values."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def low_passed(flight: Flight, cutoff_hz: float) -> Flight:
    """The flight after the zero-phase low-pass that offline use of a model has.

    A cut-off of half the sample rate or more leaves it as it is.

    Raises:
        SignalError: naming the flight, if it is too short to filter.
    """
    if cutoff_hz >= 0.5 * flight.rate_hz * (1.0 - 1e-6):
        return flight
    with named_in(flight.source):
        filtered = filter_zero_phase(
            flight.velocity,
            flight.attitude,
            flight.rates,
            flight.specific_force,
            flight.rotor_speeds,
            flight.wind,
            rate_hz=flight.rate_hz,
            cutoff_hz=cutoff_hz,
        )
    return replace(flight, **filtered._asdict())


@cache
def code_fingerprint(package: Path = _PACKAGE) -> str:
    """Hash of the code that makes models and counts, as a version in development has no number of its own."""
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        place = path.relative_to(package)
        if place.parts[0] not in _PRESENTATION:
            digest.update(place.as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def flight_hash(flight: Flight) -> str:
    """SHA-256 of the samples of a flight."""
    return _hash([getattr(flight, column.name) for column in fields(flight)])


def _numbers(model: AerodynamicModel) -> dict[str, Any]:
    """The numbers that determine the predictions of a model."""
    stored = model.fitted.store()
    numbers = [*(own for _, own in sorted(stored.arrays.items())), *stored.files.values()]
    return {
        "method": model.method,
        "cutoff_hz": model.cutoff_hz,
        "axes": stored.entries,
        "numbers": _hash(numbers),
    }


def _hash(values: Sequence[Any]) -> str:
    digest = hashlib.sha256()
    for value in values:
        if isinstance(value, np.ndarray | bytes):
            digest.update(np.ascontiguousarray(value).tobytes())
    return digest.hexdigest()


def _flown(path: Path, vehicle: Vehicle, part: TimeRange) -> Flight:
    """A part of the truth of a simulated flight, in the place of an estimated one."""
    flight = read_truth(path).flight
    if flight.vehicle != vehicle.name:
        raise LogError(f"{path}: is a flight of vehicle {flight.vehicle}, not of {vehicle.name}")
    inside = np.flatnonzero((flight.time >= part.from_s) & (flight.time <= part.to_s))
    if len(inside) == 0:
        raise LogError(f"{flight.source}: has no sample {part}: it ends at {flight.time[-1]:.3f} s")
    return flight.slice(slice(int(inside[0]), int(inside[-1]) + 1))


def given_case(
    folders: Sequence[Path],
    bags: Sequence[Path],
    *,
    vehicle: str | None = None,
    noise: str = "paper",
    confidence: float | None = None,
    seed: int = 0,
    part: TimeRange = WHOLE,
) -> ValidationCase:
    """Validation of stored models on the truth of simulated flights.

    Args:
        folders: of the models, of one vehicle and one low-pass; their names are those in the result.
        bags: that `quadpi simulate` wrote, of the same vehicle.
        vehicle: name or path of the vehicle file; default: the one that the first model names.
        noise: name in config/noise, or path.
        confidence: of the intervals; default: the models' own.
        seed: of all noise.
        part: of each flight.

    Raises:
        ValidationError: where models or bags are missing.
        ModelError: for what is no model, two models of one name, and confidences that differ where none is
            given.
        LogError, VehicleError, SimulationError: for what cannot be read.
    """
    if not folders or not bags:
        missing = "model folder" if not folders else "bag of a simulated flight"
        raise ValidationError(f"no {missing} given: name model folders, then bags of simulated flights")
    models = load_models(folders)
    level = common_confidence(models, confidence)
    the_vehicle = next(iter(models.values())).load_vehicle(vehicle)
    return ValidationCase(
        vehicle=the_vehicle,
        models=models,
        flights=tuple(_flown(bag, the_vehicle, part) for bag in bags),
        noise=SensorSuite.load(noise).states,
        confidence=level,
        seed=seed,
    )


# Every realisation of every flight has a seed of its own, so the counts depend neither on the workers nor on
# their order.

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
