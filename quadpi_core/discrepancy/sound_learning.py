# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Learn what sound flights leave of a model that was identified without them: its noise and known errors.

The residual of a flight is y = X (a + c) + T t + e. Columns X are one prior deviation of each parameter of
all effects; a is shared by all flights and c is of one alone, both normal with a variance for each parameter
that is zero for most. Columns T are one standard deviation of what the other flights leave open of the model,
so t is standard normal: a model of two flights errs more on the next than one of ten. The rest, e, is noise
with a variance for each axis and band of frequency. The variances are those of the largest evidence:
parameters enter one at a time (Tipping, Faul, Fast marginal likelihood maximisation for sparse Bayesian
models, 2003), and all are estimated again by fixed-point iteration (MacKay, Bayesian interpolation, 1992).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.stats import t as student

from quadpi_core import array_checks
from quadpi_core.discrepancy.acceptance import LARGEST
from quadpi_core.discrepancy.candidates import Candidate, candidates, linearise
from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.loading import simulation_of
from quadpi_core.discrepancy.whitening import EDGES_HZ, Columns, Indices, Spectrum
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.identification.found_wind import in_found_wind
from quadpi_core.identification.prepared_flights import PREPARE_FLIGHTS, PreparedFlight
from quadpi_core.models.aerodynamic import LOAD_MODEL, AerodynamicModel
from quadpi_core.models.sound_flights import SoundFlights
from quadpi_core.parallel import Progress, ReportProgress, ignore_progress, one_blas_thread
from quadpi_core.records import CONVENTION, Threshold
from quadpi_core.vehicle import Vehicle

LEAST_SOUND = Threshold(
    "sound flights that tell what a model leaves",
    2.0,
    "flights",
    "each is judged by a model of the others; what so few leave open of that is told apart from noise",
    "models of two flights of a Crazyflie (experiments/results/discovery-hidden.md)",
)
SHOWN = Threshold(
    "evidence that an error is known",
    5.0,
    "nat",
    "odds of about 150; what is weaker is found by no search, and stays part of the noise",
    CONVENTION,
)
BETTER = Threshold(
    "flights that a known error explains better while its mean is of all others",
    0.95,
    "probability that they do on average, by Student's t",
    "the level of the intervals that are stated; the noise of fast flights changes as they go, and evidence "
    "alone, which takes it for stationary, finds errors that the next flight does not have",
    "flights of a thrown quadrotor (INDIflight)",
)
# Largest and smallest standard deviation of a known error, in prior ones: beyond what a search looks for, and
# far below the smallest that it names.
_LARGEST, _SMALLEST = 1.0, 1e-4
# Share of the variance of single flights that an error that they share starts from, as it is estimated next.
_AT_FIRST = 0.1
_ROUNDS = 6
_TRIED = np.geomspace(_SMALLEST**2, _LARGEST**2, 33)
_TINY = 1e-9


def are_enough(flights: float) -> bool:
    """Whether so many sound flights tell what a model leaves."""
    return flights >= LEAST_SOUND.value


def learned_from(
    model: AerodynamicModel, flights: Sequence[PreparedFlight], progress: ReportProgress = ignore_progress
) -> AerodynamicModel:
    """The model with what the flights that it was identified on leave of it, each where it was left out.

    A model that is no simulation of all axes, of a single flight, or of flights made of arrays knows nothing
    of that and stays as it is.

    Args:
        model: as `identify` gives it, before it is saved.
        flights: the flights that it was identified on, in the same order.
        progress: called for each flight.

    Raises:
        ArgumentError: for what are no model or flights.
        DiscrepancyError: for flights that cannot be compared with it.
    """
    array_checks.instance("model", model, AerodynamicModel, LOAD_MODEL)
    flights = array_checks.several("flights", flights, PreparedFlight, PREPARE_FLIGHTS)
    if not are_enough(len(flights)) or len(model.left_out) != len(flights) or len(model.axes) < len(AXES):
        return model
    vehicle = model.load_vehicle()
    whole = simulation_of(model.simulation_section(), vehicle)
    sought = known_errors(vehicle)
    spectra = []
    with one_blas_thread():
        for place, (section, prepared) in enumerate(zip(model.sections_left_out, flights, strict=True)):
            progress(Progress("Learning what sound flights leave", place, len(flights)))
            if prepared.flight is None:
                return model
            # In the wind that the model found, which its residual would hold as an error of its own.
            blown = in_found_wind(prepared, model.wind, vehicle).flight
            assert blown is not None
            flight = blown.longest_stretch()
            compared, without = Compared(flight, whole), Compared(flight, simulation_of(section, vehicle))
            columns = [linearise(own, [compared], np.zeros(len(own.free)))[0][1] for own in sought]
            # What the other flights leave open of the coefficients is in these residuals, and in no search,
            # which has coefficients of its own.
            uncertain = [column.wrench[:, :, np.newaxis] for column in without.uncertain()]
            rows = np.concatenate((without.residual[:, :, np.newaxis], *columns, *uncertain), axis=2)
            spectra.append(compared.spectrum(rows))
        progress(Progress("Learning what sound flights leave", len(flights), len(flights)))
        names = tuple((own.label, own.effect.parameters[k].name) for own in sought for k in own.free)
        return replace(model, sound=learned(spectra, names, np.concatenate([own.scale for own in sought])))


def known_errors(vehicle: Vehicle) -> list[Candidate]:
    """The candidates that a model of a vehicle may be known to err by: no swing, and no scale of thrust."""
    both = [(candidate, candidate.effect) for candidate in candidates(vehicle)]
    return [candidate for candidate, effect in both if not (effect.at_rest or effect.scales_thrust)]


def learned(spectra: Sequence[Spectrum], names: Sequence[tuple[str, str]], scale: Array) -> SoundFlights:
    """What flights leave, by spectra of their residual and of K columns.

    Args:
        spectra: of each of F > 1 flights, rows (6, B, 1 + K + T); T columns are what is open of the model of
            the others, as many as that has coefficients.
        names: of K parameters: the candidate of a search, and its parameter.
        scale: (K,) prior deviation of each, which its column is for, in its unit.
    """
    bands = len(EDGES_HZ.value) - 1
    width = max(own.rows.shape[2] for own in spectra)
    products = np.zeros((len(spectra), len(AXES), bands, width, width))
    # What no coefficient of a model leaves open is nothing.
    columns = Columns(
        tuple(
            Spectrum(np.pad(own.rows, ((0, 0), (0, 0), (0, width - own.rows.shape[2]))), own.band)
            for own in spectra
        )
    )
    products[:, :, : columns.bands] = columns.products(columns)
    rows = np.array([np.bincount(own.band, minlength=bands) for own in spectra])
    found, posterior = _variances(products, rows.astype(float), len(names))
    squared = _beside_what_is_open(products, posterior, len(names))
    # A band that no flight is long or fast enough for has the noise of the next.
    filled = np.flatnonzero(rows.sum(axis=0))
    left = squared.sum(axis=0)[:, filled] / rows.sum(axis=0)[filled]
    noise, left = (
        np.stack([np.interp(np.arange(bands), filled, own) for own in each])
        for each in (found.noise[:, filled], left)
    )
    squares = np.sum(squared / left, axis=2) / rows.sum(axis=1)[:, np.newaxis]
    known = np.flatnonzero((found.common + found.of_flight)[: len(names)])
    mean, covariance = np.zeros(len(scale)), np.zeros((len(scale), len(scale)))
    mean[posterior.common] = posterior.mean
    covariance[np.ix_(posterior.common, posterior.common)] = posterior.covariance + posterior.jackknife
    units = scale[known]
    return SoundFlights(
        flights=len(spectra),
        edges_hz=EDGES_HZ.value,
        noise=noise,
        left=left,
        differ=np.std(squares, axis=0, ddof=1),
        names=tuple(names[k] for k in known.tolist()),
        mean=mean[known] * units,
        covariance=_symmetric(covariance[np.ix_(known, known)] * np.outer(units, units)),
        of_flight=np.sqrt(found.of_flight[known]) * units,
    )


class _Variances(NamedTuple):
    """Variances of the noise (6, C), and of K + T columns: shared by all flights, and of each."""

    noise: Array
    common: Array
    of_flight: Array


class _OfFlight(NamedTuple):
    """What a flight adds to the posterior.

    Attributes:
        gram: (1 + K, 1 + K) of the whitened residual and columns.
        covariance: (m, m) of its own coefficients, given the common ones.
        gain: (n, m) change of its own coefficients by the common ones, with the opposite sign.
        information, projection: (n, n), (n,) what it tells of the common ones.
    """

    gram: Array
    covariance: Array
    gain: Array
    information: Array
    projection: Array


@dataclass(frozen=True)
class _Posterior:
    """Coefficients given variances.

    Attributes:
        common, own: columns (n,), (m,) that are shared, and that flights have of their own.
        information, projection: (n, n), (n,) of the shared coefficients, their prior and all flights.
        flights: one for each.
    """

    common: Indices
    own: Indices
    information: Array
    projection: Array
    flights: tuple[_OfFlight, ...]

    @cached_property
    def covariance(self) -> Array:
        """Of the shared coefficients (n, n)."""
        return _symmetric(np.linalg.inv(self.information))

    @cached_property
    def mean(self) -> Array:
        """Of the shared coefficients (n,)."""
        return self.covariance @ self.projection

    def of_flight(self, flight: _OfFlight) -> tuple[Array, Array]:
        """Mean (m,) and covariance (m, m) of the coefficients that a flight has of its own."""
        values = flight.covariance @ flight.gram[1 + self.own, 0] - flight.gain.T @ self.mean
        return values, flight.covariance + flight.gain.T @ self.covariance @ flight.gain

    @property
    def jackknife(self) -> Array:
        """Covariance (n, n) of the shared coefficients by their fits without each flight in turn."""
        flights = len(self.flights)
        without = np.array(
            [
                np.linalg.solve(self.information - own.information, self.projection - own.projection)
                for own in self.flights
            ]
        )
        away = without - without.mean(axis=0)
        return (flights - 1) / flights * away.T @ away


def _variances(products: Array, rows: Array, sought: int) -> tuple[_Variances, _Posterior]:
    """Variances of the largest evidence that also predict flights left out, and the posterior under them.

    Args:
        products: (F, 6, C, 1 + K + T, 1 + K + T) of the residual and the columns of each flight and band.
        rows: (F, C) of each flight.
        sought: K.
    """
    columns, counts = products.shape[-1] - 1, np.maximum(rows.sum(axis=0), 1.0)
    noise = np.maximum(products[..., 0, 0].sum(axis=0) / counts, np.finfo(float).tiny)
    is_open = np.arange(columns) >= sought
    found, posterior = _settled(
        products, counts, _Variances(noise, np.zeros(columns), is_open.astype(float)), is_open
    )
    before, tried = _left_out(found, posterior, rows), is_open.copy()
    while True:
        gain, start, shared = _gains(found, posterior)
        gain[tried] = -np.inf
        best = int(np.argmax(gain))
        if gain[best] < SHOWN.value:
            return found, posterior
        tried[best] = True
        larger = _Variances(noise=found.noise, common=found.common.copy(), of_flight=found.of_flight.copy())
        larger.common[best] = max(found.common[best], start[best])
        own = start[best] * (_AT_FIRST if shared[best] else 1.0)
        larger.of_flight[best] = max(found.of_flight[best], own)
        larger, changed = _settled(products, counts, larger, is_open)
        if np.any(np.abs(changed.mean) > LARGEST.value):
            # What would have no mass and no thrust leaves no noise of either: no error that a model has.
            continue
        after = _left_out(larger, changed, rows)
        if predicts(after - before):
            found, posterior, before = larger, changed, after


def _settled(
    products: Array, counts: Array, variances: _Variances, is_open: npt.NDArray[np.bool_]
) -> tuple[_Variances, _Posterior]:
    """The variances estimated again, but for those (K + T,) of what is open, and the posterior under them."""
    for _ in range(_ROUNDS):
        variances = _renewed(products, counts, variances, _posterior(products, variances))
        variances.of_flight[is_open] = 1.0
    return variances, _posterior(products, variances)


def _beside_what_is_open(products: Array, posterior: _Posterior, sought: int) -> Array:
    """Mean squares (F, 6, C) of the residual of each flight less what is open of the model, times rows."""
    is_open = posterior.own >= sought
    used = np.concatenate(([0], 1 + posterior.own[is_open]))
    squares = []
    for product, flight in zip(products, posterior.flights, strict=True):
        values, spread = posterior.of_flight(flight)
        squares.append(_squares_left(product, used, values[is_open], spread[np.ix_(is_open, is_open)]))
    return np.array(squares)


def _squares_left(product: Array, used: Indices, mean: Array, covariance: Array) -> Array:
    """Expected squares (6, C) of a flight's residual less columns, given mean and covariance of these.

    Args:
        product: (6, C, 1 + K + T, 1 + K + T) of the residual and the columns.
        used: (1 + k,) indices in it, of the residual first and then of k columns.
        mean: (k,) of their coefficients.
        covariance: (k, k) of these.
    """
    weights = np.concatenate(([1.0], -mean))
    moment = np.outer(weights, weights)
    moment[1:, 1:] += covariance
    # As one product of a matrix and a vector: the columns used of `product` are not copied. A column that is
    # shared and each flight's own as well is used twice.
    whole = np.zeros(product.shape[2:])
    np.add.at(whole, (used[:, np.newaxis], used), moment)
    return product.reshape(*product.shape[:2], -1) @ whole.ravel()


def predicts(gained: Array) -> bool:
    """Whether flights left out gain evidence (F,) on average, beyond what chance makes of so few.

    By its root, which has the scale of a deviation: a flight that gains a thousand must not hide others.
    """
    roots, flights = np.sign(gained) * np.sqrt(np.abs(gained)), len(gained)
    needed = float(student.ppf(BETTER.value, flights - 1)) * np.std(roots, ddof=1) / np.sqrt(flights)
    return bool(np.mean(roots) > needed)


def _left_out(found: _Variances, posterior: _Posterior, rows: Array) -> Array:
    """Log evidence (F,) of each flight given all others [nat]."""
    own, information, projection = posterior.own, posterior.information, posterior.projection

    def evidence(inner: Array, seen: Array) -> float:
        solved = float(seen @ np.linalg.solve(inner, seen))
        return 0.5 * (solved - float(np.linalg.slogdet(inner)[1]))

    whole, own_prior = evidence(information, projection), float(np.log(found.of_flight[own]).sum())
    result = []
    for flight, count in zip(posterior.flights, rows, strict=True):
        gram = flight.gram
        left = gram[0, 0] - gram[0, 1 + own] @ flight.covariance @ gram[1 + own, 0]
        spread = float(np.linalg.slogdet(flight.covariance)[1]) - own_prior
        alone = 0.5 * (spread - left - float(np.sum(count * np.log(found.noise))))
        others = evidence(information - flight.information, projection - flight.projection)
        result.append(alone + whole - others)
    return np.array(result)


def _posterior(products: Array, variances: _Variances) -> _Posterior:
    common, own = np.flatnonzero(variances.common), np.flatnonzero(variances.of_flight)
    flat = products.reshape(len(products), variances.noise.size, -1)
    grams = ((1.0 / variances.noise).ravel() @ flat).reshape(len(products), *products.shape[3:])
    information, projection = np.diag(1.0 / variances.common[common]), np.zeros(len(common))
    flights = []
    for gram in grams:
        inner = gram[np.ix_(1 + own, 1 + own)] + np.diag(1.0 / variances.of_flight[own])
        covariance = np.linalg.inv(inner)
        gain = gram[np.ix_(1 + common, 1 + own)] @ covariance
        told = gram[np.ix_(1 + common, 1 + common)] - gain @ gram[np.ix_(1 + own, 1 + common)]
        seen = gram[1 + common, 0] - gain @ gram[1 + own, 0]
        information, projection = information + told, projection + seen
        flights.append(_OfFlight(gram, covariance, gain, told, seen))
    return _Posterior(common, own, information, projection, tuple(flights))


def _renewed(products: Array, rows: Array, found: _Variances, posterior: _Posterior) -> _Variances:
    """The variances after a step of their iteration: squares of coefficients over what flights tell."""
    common, own, mean, covariance = posterior.common, posterior.own, posterior.mean, posterior.covariance
    squares, told = np.zeros(len(own)), np.zeros(len(own))
    noise = np.zeros_like(found.noise)
    used = np.concatenate(([0], 1 + common, 1 + own))
    for product, flight in zip(products, posterior.flights, strict=True):
        values, spread = posterior.of_flight(flight)
        between = -covariance @ flight.gain
        both = np.block([[covariance, between], [between.T, spread]])
        noise += _squares_left(product, used, np.concatenate((mean, values)), both)
        squares += np.square(values)
        told += 1.0 - np.diag(spread) / found.of_flight[own]
    result = _Variances(
        np.maximum(noise / rows, np.finfo(float).tiny), found.common.copy(), found.of_flight.copy()
    )
    known = 1.0 - np.diag(covariance) / found.common[common]
    result.common[common] = _bounded(np.square(mean) / np.maximum(known, _TINY))
    result.of_flight[own] = _bounded(squares / np.maximum(told, _TINY))
    return result


def _bounded(variance: Array) -> Array:
    """Variances no larger than what is looked for, and 0 where they are too small to matter."""
    return np.where(variance < _SMALLEST**2, 0.0, np.minimum(variance, _LARGEST**2))


def _gains(found: _Variances, posterior: _Posterior) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
    """For each column (K,) the evidence [nat] that a variance of it gains, that variance, and whether shared.

    With s the square of a column and q its product with the residual, both beside what is known, a variance v
    gains ½ q² v / (1 + v s) − ½ ln(1 + v s).
    """
    common, own, mean, covariance = posterior.common, posterior.own, posterior.mean, posterior.covariance
    columns = len(found.common)
    shared_s, shared_q = np.zeros(columns), np.zeros(columns)
    shared_u = np.zeros((columns, len(common)))
    of_flight = np.zeros((len(_TRIED), columns))
    for flight in posterior.flights:
        gram = flight.gram
        weights = gram[1:, 1 + own] @ flight.covariance
        square = np.diag(gram)[1:] - np.sum(weights * gram[1:, 1 + own], axis=1)
        product = gram[1:, 0] - weights @ gram[1 + own, 0]
        other = gram[1:, 1 + common] - weights @ gram[np.ix_(1 + own, 1 + common)]
        shared_s, shared_q, shared_u = shared_s + square, shared_q + product, shared_u + other
        alone = np.maximum(square - np.sum(other @ covariance * other, axis=1), _TINY)
        of_flight += _gained(alone, product - other @ mean, _TRIED[:, np.newaxis])
    square = np.maximum(shared_s - np.sum(shared_u @ covariance * shared_u, axis=1), _TINY)
    product = shared_q - shared_u @ mean
    best = np.clip((np.square(product) - square) / np.square(square), _SMALLEST**2, _LARGEST**2)
    shared = np.where(found.common > 0.0, -np.inf, _gained(square, product, best))
    place = np.argmax(of_flight, axis=0)
    alone = np.where(found.of_flight > 0.0, -np.inf, np.max(of_flight, axis=0))
    is_shared = np.asarray(shared >= alone)
    return np.maximum(shared, alone), np.where(is_shared, best, _TRIED[place]), is_shared


def _gained(square: Array, product: Array, variance: Array) -> Array:
    gain: Array = 0.5 * np.square(product) * variance / (1.0 + variance * square)
    gain -= 0.5 * np.log1p(variance * square)
    return gain


def _symmetric(matrix: npt.NDArray[np.floating]) -> Array:
    return 0.5 * (matrix + matrix.T)
