# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Regression of residuals on the effects of a search, as immutable values: columns, noise, and fits."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from quadpi_core.discrepancy.candidates import (
    Candidate,
    Modulators,
    Tolerances,
    block_of,
    candidates,
    first_point,
    in_frequency,
)
from quadpi_core.discrepancy.effect_response import Compared, errors_of_speeds, share_of_wrench
from quadpi_core.discrepancy.evidence import Block, Condition, Equations, Fit, own_sizes
from quadpi_core.discrepancy.unexplained import stated_squares
from quadpi_core.discrepancy.whitening import (
    Columns,
    Indices,
    Memoised,
    Noise,
    OfEachFlight,
    Part,
    Sum,
    band_means,
    estimate_noise,
    rows_of,
)
from quadpi_core.errors import DiscrepancyError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.sound_flights import SoundFlights
from quadpi_core.records import CONVENTION, Threshold

# Rounds in which the columns of mass and inertia and the accelerations that all columns explain converge.
_ACCELERATION_ROUNDS = 2
# Steps to the point of linearisation of candidates.
ROUNDS = 3
# Step of the difference quotient in a vehicle parameter, in prior standard deviations.
_VEHICLE_STEP = 1e-3
ALIKE_ROWS = Threshold(
    "rows for which the noise of a flight is taken for that of all",
    20.0,
    "rows of an axis and band",
    "flights differ in their noise, where a cable falls slack by ten times; of a band with few rows that of "
    "all is likelier",
    CONVENTION,
)
SURE_STEP = Threshold(
    "step to another point of linearisation beside other effects",
    2.0,
    "standard deviations of the fit",
    "the level of the intervals that are stated: a shorter one changed evidence by at most one nat",
    "sets of eight flights of a Crazyflie with a load",
)


class Reduction(NamedTuple):
    """Squares by which effects reduce the residual, axis by axis.

    Attributes:
        fitted, stated: (6,) with the coefficients of the simulation as fitted, and as stated.
    """

    fitted: Array
    stated: Array

    @property
    def credited(self) -> Array:
        """Squares (6,) that speak for the effects: where coefficients undo what they add, not the whole."""
        return np.minimum(self.fitted, self.stated)


@dataclass(frozen=True, eq=False)
class Regression(Memoised):
    """Residual, tolerances and candidates of all flights, and their noise; changes give new values.

    Attributes:
        flights: F flights beside their simulation.
        candidates: the effects that are looked for.
        points: free parameters at which each candidate is linearised.
        blocks: columns of each candidate.
        residual: one column.
        tolerances: columns of what is uncertain in the simulation.
        modulators: what laws may depend on.
        noise: of the residual.
        explained: per flight, rows (6, B) of the wrench of the accelerations that the columns of mass and
            inertia are made of.
        conditions: what each flight has of its own, in the order of the last of `noise.own`.
        beside_fitted: the flights beside the simulation that columns are made of, where it is not the stated.
    """

    flights: tuple[Compared, ...]
    candidates: tuple[Candidate, ...]
    points: tuple[Array, ...]
    blocks: tuple[Block, ...]
    residual: Columns
    tolerances: Tolerances
    modulators: Modulators
    noise: Noise
    explained: tuple[Array, ...]
    conditions: tuple[Condition, ...] = ()
    beside_fitted: tuple[Compared, ...] = ()

    @classmethod
    def from_flights(cls, flights: Sequence[Compared], candidates: Sequence[Candidate]) -> Regression:
        """Regression with every candidate linearised at no effect, and the noise that all of them leave."""
        points = tuple(first_point(candidate, flights) for candidate in candidates)
        residual = in_frequency(flights, [flight.residual[:, :, np.newaxis] for flight in flights])
        regression = cls(
            flights=tuple(flights),
            candidates=tuple(candidates),
            points=points,
            blocks=tuple(block_of(*own, flights) for own in zip(candidates, points, strict=True)),
            residual=residual,
            tolerances=Tolerances.from_flights(flights),
            modulators=Modulators.from_flights(flights),
            noise=Noise(np.ones((len(flights), len(AXES), residual.bands)), errors_of_speeds(flights)),
            explained=tuple(_rows(flight, flight.expected_measured) for flight in flights),
        )
        if regression.sound is not None:
            # Its known errors were found with columns of the accelerations that the simulation expects.
            return regression._beside_known_errors(regression.sound)
        for _ in range(_ACCELERATION_ROUNDS):
            regression = regression.weighted(np.maximum(regression.least, regression._estimated_noise(())))
            regression = regression.accelerated(regression.fit_none())
        return regression.weighted(np.maximum(regression.least, regression._estimated_noise(())))

    @cached_property
    def least(self) -> Array:
        """Least variance (6, C) of the noise: what sound flights leave, or what the simulation states."""
        return self.stated if self.sound is None else self.sound.noise

    @cached_property
    def stated_squares(self) -> Array:
        """Mean squares (6,) that the simulation's own intervals state."""
        return stated_squares(self.flights)

    @cached_property
    def stated(self) -> Array:
        """Variance (6, C) that the simulation's own intervals state.

        A model states by its intervals how well it knows a wrench, but not how fast its errors change: in any
        band there may be as much of them as there would be in all together, were they white.
        """
        rows = self.residual.counts
        return self.stated_squares[:, np.newaxis] * rows.sum() / np.maximum(rows, 1)

    def _beside_known_errors(self, sound: SoundFlights) -> Regression:
        """The regression of the residual less what sound flights leave, with their noise."""
        noise = self.weighted(sound.noise).noise
        if not sound.names:
            return replace(self, noise=noise)
        known = self._known_errors(sound)
        deviations = sound.deviations(len(self.flights))
        own = OfEachFlight(known, np.repeat(deviations[np.newaxis], len(self.flights), axis=0))
        shared = known.spectra
        residual = self.residual.plus(lambda place: -(shared[place].rows @ sound.mean)[:, :, np.newaxis])
        return replace(self, residual=residual, noise=noise.beside(own))

    def _known_errors(self, sound: SoundFlights) -> Columns:
        """Columns of the known errors of a simulation, per unit of each parameter, about no effect."""
        blocks = {own.label: block for own, block in zip(self.candidates, self.blocks, strict=True)}
        labels, parts = {label for label, _ in sound.names}, {}
        for candidate in candidates(self.flights[0].simulation.vehicle):
            if candidate.label in labels:
                block = blocks.get(candidate.label) or block_of(
                    candidate, np.zeros(len(candidate.free)), self.flights
                )
                for k, free in enumerate(candidate.free):
                    name = candidate.label, candidate.effect.parameters[free].name
                    parts[name] = block.columns, k, candidate.scale[k]
        if unknown := [label for label, parameter in sound.names if (label, parameter) not in parts]:
            raise DiscrepancyError(
                f"{self.flights[0].simulation.name}: knows an error of {unknown[0]}, which is no effect "
                "here: install what it came from, or identify the model again"
            )
        wanted = [parts[name] for name in sound.names]
        return self.residual.like(
            lambda place: np.dstack(
                [columns.spectra[place].rows[:, :, k] / scale for columns, k, scale in wanted]
            )
        )

    def accelerated(self, found: Fit) -> Regression:
        """The regression with columns of mass and inertia made of the accelerations that a fit explains.

        They are those of the quiet simulation and of what the fit adds to it. Another mass or inertia then
        explains nothing that the fit itself does not. Measured accelerations hold the noise of the residual,
        and so do those that many columns explain together: a vehicle without mass, in no air, would leave
        none of it. The noise is not changed.
        """
        left = [Part(part.columns, -part.weights) for part in found.residual(without=[self.residual])]
        explained = tuple(
            _rows(flight, flight.quiet_wrench[:: flight.step]) + rows_of(left, place)
            for place, flight in enumerate(self.flights)
        )
        changes = [new - old for new, old in zip(explained, self.explained, strict=True)]

        def changed(shares: Array) -> Callable[[int], Array]:
            return lambda place: np.einsum("ack,cb->abk", shares, changes[place])

        blocks = list(self.blocks)
        for index, candidate in enumerate(self.candidates):
            if candidate.effect.kind == "vehicle":
                vehicle, steps = self.flights[0].simulation.vehicle, _VEHICLE_STEP * np.diag(candidate.scale)
                shares = [share_of_wrench(candidate.effect, vehicle, own) / _VEHICLE_STEP for own in steps]
                columns = blocks[index].columns.plus(changed(np.stack(shares, axis=2)))
                blocks[index] = replace(blocks[index], columns=columns)
        body = self.tolerances.body.plus(changed(self.tolerances.shares))
        tolerances = self.tolerances._replace(body=body)
        return replace(self, blocks=tuple(blocks), tolerances=tolerances, explained=explained)

    @cached_property
    def sound(self) -> SoundFlights | None:
        """What sound flights leave of the simulation, in the bands that are compared; None where unknown."""
        sound, bands = self.flights[0].simulation.sound, self.residual.bands
        if sound is None or bands == sound.noise.shape[1]:
            return sound
        edges, noise, left = sound.edges_hz[: bands + 1], sound.noise[:, :bands], sound.left[:, :bands]
        return replace(sound, edges_hz=edges, noise=noise, left=left)

    @property
    def base(self) -> tuple[Columns, ...]:
        """Columns of every fit: the residual, and the tolerances."""
        return self.residual, self.tolerances.coefficients, self.tolerances.body

    def moved(self, points: Mapping[int, Array], *, anew: bool = False) -> Regression:
        """The regression with candidates, by index, linearised about other points, with forms.

        Columns of linear ones stay, unless all are made `anew`.
        """
        at, blocks, flights = list(self.points), list(self.blocks), self.beside_fitted or self.flights
        for index, point in points.items():
            candidate = self.candidates[index]
            at[index] = point
            if anew or not candidate.linear:
                blocks[index] = block_of(candidate, point, flights)
            size = float(np.linalg.norm(point / candidate.scale))
            form = None
            if size > 0.0 and candidate.form > 0.0:
                form = self.modulators.form(candidate, flights, point)
            own_point = (point - candidate.centre) / candidate.scale
            blocks[index] = replace(blocks[index], at=own_point, form=form, formed_at=size or 1.0)
        return replace(self, points=tuple(at), blocks=tuple(blocks))

    def with_fitted_coefficients(self, chosen: Sequence[int], found: Fit) -> Regression:
        """The regression with the chosen made of the simulation with its coefficients as a fit has them.

        A tilted rotor turns its true thrust, not the stated one: the product of an effect and a coefficient
        would bias what is known to less than the tolerance. Mass and inertia are made of other accelerations,
        see :meth:`accelerated`. The noise stays that of the fit, which holds that product: intervals are
        rather too wide for it.
        """
        fitted = zip(self.tolerances.names, self.moved_by(found).tolist(), strict=True)
        stated = self.flights[0].simulation
        simulation = stated.with_coefficients(dict(fitted))
        if simulation is stated:
            return self

        def made() -> Regression:
            flights = tuple(flight.compared_with(simulation) for flight in self.flights)
            points = {k: self.points[k] for k in chosen if self.candidates[k].effect.kind != "vehicle"}
            return replace(self, beside_fitted=flights).moved(points, anew=True)

        return self.once(("fitted", tuple(chosen), found), made)

    def weighted(self, variance: Array) -> Regression:
        """The regression with noise of another variance, (6, C) or (F, 6, C)."""
        each = np.broadcast_to(variance, (len(self.flights), len(AXES), self.residual.bands))
        return replace(self, noise=replace(self.noise, variance=each))

    def beside(self, chosen: Sequence[int], found: Fit) -> Regression:
        """The regression with at least the residual after a set of effects as noise, as far as there was any.

        An error of a law would otherwise be explained by another effect. Columns of mass and inertia are made
        of the accelerations that the set explains. What flights may have of their own is no noise.
        """
        left = self.varied.left(found)
        accelerated, variance = self.accelerated(found), self.band_means(left)
        if self.sound is None:
            variance = np.maximum(variance, accelerated._estimated_noise(chosen))
            variance = np.minimum(variance, self._residual_squares)
        else:
            pairs = zip(left, self.residual.spectra, strict=True)
            variance = np.array([noise_of_flight(rows, own.band, variance) for rows, own in pairs])
        return accelerated.weighted(np.maximum(variance, self.least))

    @cached_property
    def varied(self) -> Regression:
        """The regression with all that flights may have of their own as noise, however large."""
        own = []
        for index in self.conditions_to_come:
            sizes = np.ones((len(self.flights), len(self.blocks[index].at)))
            own.append(self._of_each_flight(Condition(index, sizes)))
        return replace(self, noise=self.noise.beside(*own)) if own else self

    def _of_each_flight(self, condition: Condition) -> OfEachFlight:
        columns, sizes = self.blocks[condition.index].columns, condition.sizes
        return OfEachFlight(columns, sizes[:, np.newaxis] * np.eye(columns.width)[:, : sizes.shape[1]])

    @property
    def conditions_to_come(self) -> list[int]:
        """Candidates of which flights may have parameters of their own; none without sound flights."""
        if self.sound is None:
            return []
        known = {condition.index for condition in self.conditions}
        return [
            index
            for index, candidate in enumerate(self.candidates)
            if candidate.of_a_flight and index not in known
        ]

    def equations(self, chosen: Sequence[int], formed: Sequence[int] = ()) -> Equations:
        """Normal equations of a set of candidates, by their indices, some with the columns of their form."""
        return self.once(("equations", tuple(chosen), tuple(formed)), lambda: self._equations(chosen, formed))

    def _equations(self, chosen: Sequence[int], formed: Sequence[int]) -> Equations:
        blocks, of_form = ([self.blocks[index] for index in some] for some in (chosen, formed))
        return Equations.from_columns(self.base, blocks, self.noise, of_form)

    def fit(self, chosen: Sequence[int], *, form: bool = True) -> Fit | None:
        """Fit a set of candidates, by their indices, see :meth:`Equations.fit`."""

        def made() -> Fit | None:
            # Hundreds of fits are kept, but not the equations of each, which are a thousand times as large.
            found = self._equations(chosen, chosen if form else ()).fit(known=self.sound is not None)
            return found and self._comparable(found)

        return self.once(("fit", tuple(chosen), form), made)

    def fit_none(self) -> Fit:
        """The fit without effects, which there always is."""
        return self.once("no effect", lambda: self._comparable(self.equations(()).fit_none()))

    def _comparable(self, found: Fit) -> Fit:
        """The fit with the cost of what flights have of their own, so that noises can be compared."""
        return replace(found, log_evidence=found.log_evidence - self.noise.cost)

    def at_points(self, chosen: Sequence[int]) -> float:
        """See :meth:`Equations.at_points`, of candidates by their indices."""
        return self.equations(chosen).at_points()

    def moved_by(self, found: Fit) -> Array:
        """What a fit moves coefficients (T,) of the simulation by, in their tolerances."""
        return np.concatenate([found.of(columns) for columns in self.base[1:]])

    def found(self, index: int, found: Fit) -> Array:
        """Free parameters (k,) of a candidate in a fit, in prior standard deviations from their mean."""
        block = self.blocks[index]
        return found.of(block.columns)[: len(block.at)]

    def parameters(self, index: int, found: Fit) -> Array:
        """Free parameters (k,) of a candidate in a fit, brought within their bounds."""
        candidate = self.candidates[index]
        return candidate.within_bounds(candidate.centre + self.found(index, found) * candidate.scale)

    def deviation(self, index: int, found: Fit) -> Array:
        """Standard deviations (k,) of the parameters of a candidate in a fit; 0 for those at a bound."""
        block = self.blocks[index]
        return found.deviation(block.columns)[: len(block.at)]

    def of_tolerances(self, values: Array) -> list[Part]:
        """What coefficients (T,), in their tolerances, add to the simulated wrench, as a sum of columns."""
        count = self.tolerances.coefficients.width
        return [Part(self.base[1], values[:count]), Part(self.base[2], values[count:])]

    def moves(self, index: int, found: Fit, to: Array) -> bool:
        """Whether a candidate is linearised anew at parameters (k,): further away than a fit is unsure."""
        at, deviation = self.points[index], self.deviation(index, found) * self.candidates[index].scale
        # However small the first step: what else a law depends on acts only where it is there.
        return not at.any() or bool(np.any(np.abs(to - at) > SURE_STEP.value * deviation))

    def size(self, index: int, found: Fit) -> float:
        """Largest parameter of a candidate in a fit, in prior standard deviations."""
        return float(np.abs(self.found(index, found)).max())

    def left(self, found: Fit) -> list[Array]:
        """Rows (6, B) of the residual of each flight after a fit and what that flight has of its own."""
        return [self.left_of(place, found) for place in range(len(self.flights))]

    def left_of(self, place: int, found: Fit) -> Array:
        """Rows (6, B) of the residual of a flight after a fit, less what that flight has of its own."""
        residual = found.residual()
        return rows_of(residual, place) - self.noise.own_rows(residual, place)

    def squares(self, parts: Sum, variance: Array | None = None) -> Array:
        """Squares (6,) of a sum of columns over all flights.

        They are in variances, (6, C) or (F, 6, C), where these are given.
        """
        each = np.broadcast_to(1.0 if variance is None else variance, self.noise.variance.shape)
        squares = np.zeros(len(AXES))
        for place, (own, at) in enumerate(zip(each, self.residual.spectra, strict=True)):
            squares += np.sum(np.square(rows_of(parts, place)) / own[:, at.band], axis=1)
        return squares

    def band_means(self, rows: Sequence[Array]) -> Array:
        """Mean squares (6, C) of rows (6, B) of each flight by band."""
        return band_means([np.square(own) for own in rows], [own.band for own in self.residual.spectra])

    def sizes_of_condition(self, index: int, chosen: Sequence[int]) -> Array:
        """Deviations (F, k) of what flights have of a candidate beside a set, see :func:`own_sizes`."""
        equations = self.equations((*(one for one in chosen if one != index), index))
        residual, own = equations.residual, equations.parameters(-1)
        if index not in chosen:
            residual[own[-1] + 1 :] = 0.0
        tolerances = np.arange(1, 1 + equations.tolerances)
        shared = np.concatenate((tolerances, *map(equations.parameters, range(len(equations.blocks)))))
        return own_sizes(equations.per_flight, residual, shared, own)

    def with_condition(self, condition: Condition) -> Regression:
        """The regression with parameters of a candidate that each flight has of its own, as noise."""
        noise = self.noise.beside(self._of_each_flight(condition))
        return replace(self, noise=noise, conditions=(*self.conditions, condition))

    def of_condition(self, condition: Condition, place: int, found: Fit) -> tuple[Array, Array]:
        """Parameters (k,) of a candidate that a flight has of its own, and their standard deviations (k,)."""
        later = self.conditions[self.conditions.index(condition) :]
        mean = self.noise.deviations(found.residual(), place)
        deviation = np.sqrt(np.diag(self.noise.covariance[place]))
        first = len(mean) - sum(one.sizes.shape[1] for one in later)
        own = slice(first, first + condition.sizes.shape[1])
        units = condition.sizes[place] * self.candidates[condition.index].scale
        return mean[own] * units, deviation[own] * units

    def added(self, chosen: Sequence[int], found: Fit) -> list[Part]:
        """The contribution of candidates in a fit, as a sum of columns."""
        columns = [self.blocks[index].columns for index in chosen]
        return [Part(own.columns, -own.weights) for own in found.residual() if own.columns in columns]

    @cached_property
    def noise_squares(self) -> Array:
        """Squares (6,) of the noise over all flights."""
        squares = np.zeros(len(AXES))
        for variance, own in zip(self.noise.variance, self.residual.spectra, strict=True):
            squares += variance[:, own.band].sum(axis=1)
        return squares

    def loudness(self, index: int, found: Fit) -> float:
        """Root mean square of the contribution of a candidate over that of the noise, in its loudest axis."""
        ratio = self.squares(self.added((index,), found)) / self.noise_squares
        return float(np.sqrt(np.max(ratio)))

    def energy(self, chosen: Sequence[int], found: Fit) -> float:
        """Evidence of candidates in a fit: half of the squares that they add, in variances of the noise."""
        if not chosen:
            return 0.0
        return 0.5 * float(self.squares(self.added(chosen, found), self.noise.variance).sum())

    def reduction(self, chosen: Sequence[int], found: Fit, variance: Array | None = None) -> Reduction:
        """Squares by which candidates in a fit reduce the residual of all flights.

        Args:
            chosen: indices of the candidates.
            found: fit of them, and of others.
            variance: (6, C) or (F, 6, C) to count squares in; unless given, in units of the wrench.
        """
        blocks = [self.blocks[index] for index in chosen]
        added = [*(own.columns for own in blocks), *(own.form for own in blocks if own.form is not None)]
        reduced = []
        for stated in ((), self.base[1:]):
            without, left = found.residual(without=[*stated, *added]), found.residual(without=stated)
            reduced.append(self.squares(without, variance) - self.squares(left, variance))
        return Reduction(*reduced)

    def _estimated_noise(self, chosen: Sequence[int]) -> Array:
        """Variance (6, C) of the residual after tolerances, every linear candidate, and those chosen."""
        own = [(k, block) for k, block in enumerate(self.blocks) if k in chosen or not block.curved]
        forms = [block.form for k, block in own if k in chosen and block.form is not None]

        def rows(place: int) -> Array:
            residual = self.residual.spectra[place].rows.copy()
            explaining = [part.spectra[place].rows for part in (*self.base[1:], *forms)]
            for _, block in own:
                columns, count = block.columns.spectra[place].rows, len(block.at)
                explaining.append(columns[:, :, :count])
                residual += columns[:, :, count:].sum(axis=2, keepdims=True)
            return np.dstack([residual, *explaining])

        columns = self.residual.like(rows)
        products = columns.products(columns).sum(axis=0)
        return estimate_noise(products, columns.counts, self._residual_squares)

    @property
    def _residual_squares(self) -> Array:
        """Mean squares (6, C) of the residual as it is; infinite in a band that no flight reaches."""
        squares = self.band_means([own.rows[:, :, 0] for own in self.residual.spectra])
        return np.where(squares > 0.0, squares, np.inf)


def noise_of_flight(left: Array, band: Indices, of_all: Array) -> Array:
    """Variance (6, C) of a flight's noise by what is left of it (6, B), and that of all flights (6, C)."""
    counts = np.bincount(band, minlength=of_all.shape[1])
    squares = np.stack([np.bincount(band, own, len(counts)) for own in np.square(left)])
    return (squares + ALIKE_ROWS.value * of_all) / (counts + ALIKE_ROWS.value)


def law_fit(regression: Regression, chosen: Sequence[int], without: int | None = None) -> Fit:
    """Fit of some candidates by their laws alone, and of all coefficients; without one of the flights."""
    return regression.equations(chosen).fit(without) or regression.equations(()).fit_none()


def left_out_squares(regression: Regression, chosen: Sequence[int]) -> Array:
    """Squares (6,) of the flights, each after the fit of all others by the laws, in variances of the noise.

    What a flight may have of its own is left out, however large.
    """
    varied = regression.varied

    def made() -> Array:
        squares = np.zeros(len(AXES))
        for place, (_, band) in enumerate(varied.residual.spectra):
            left = varied.left_of(place, law_fit(varied, chosen, place))
            squares += np.sum(np.square(left) * varied.noise.precision[place][:, band], axis=1)
        return squares

    return varied.once(("left out", tuple(chosen)), made)


def _rows(flight: Compared, wrench: Array) -> Array:
    return flight.spectrum(wrench[:, :, None]).rows[:, :, 0]
