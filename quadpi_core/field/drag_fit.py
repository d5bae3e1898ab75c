# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Drag over mass in body x and y, and the wind of each flight, fitted together.

An accelerometer senses no gravity, and the thrust of a multirotor has no part along body x and y: what it
reads there is drag over mass, its bias, and a tilt of its mounting. With linear drag, k in 1/s,

    f_x = −k_x (Rᵀ(v − w))_x + b_x + e_x (f_z + g),        f_y likewise,

where R turns body into world, v is the velocity over ground and w the wind, horizontal and slow. Neither
rotor speeds nor mass are needed. Source: D. Abeywardena et al., Improved state estimation in quadrotor MAVs
(IEEE RAM 2013), eqs. 5–7; PX4's drag_fusion.cpp for the split into momentum drag and bluff-body drag.

The wind of each flight is a polygon over time whose steps are a random walk. All is solved together by
Gauss–Newton; intervals leave out pieces of flight (see :mod:`quadpi_core.field.estimates`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from quadpi_core.field.drag_samples import STEP_S, DragSamples
from quadpi_core.field.estimates import PIECES_FEWEST, effective_pieces, jackknife
from quadpi_core.frames import Array
from quadpi_core.inputs import STANDARD_DENSITY
from quadpi_core.messages.payloads import Indices
from quadpi_core.records import STANDARD_GRAVITY

# What is known before: bias of an accelerometer with the tilt of its mounting [m/s²], wind [m/s], its change
# in the square root of a second [m/s], lean of the mounting [rad].
BIAS, WIND, WALK, _LEAN = 0.5, 6.0, 0.3, 0.05
_KNOTS_S = 10.0
# Of all flights together: an hour takes no more than ten minutes do.
_KNOTS_MOST, _SAMPLES_MOST = 60, 6000
_ITERATIONS, _SETTLED = 12, 1e-5
# Information on what is known: more than any flight's.
_KNOWN = 1e12


class _Information(NamedTuple):
    """What a piece of a flight tells of the parameters at `columns` (C,): (C, C) and (C,)."""

    flight: int
    columns: Indices
    information: Array
    gradient: Array


class DragFit:
    """The joint problem of several flights: drag of the vehicle, wind and bias of each flight.

    Attributes:
        theta: (P,) drag parameters first.
        prior: (P, P) information of what is known before; the square terms `without` are known to be 0.
        mean: (P,) what it is known to be.

    Args:
        flights: samples of each.
        quadratic: EKF2's split of drag, or else one coefficient an axis.
        without: axes that have no square term.
        known: drag (2,) along x and y, 1/s, where it is not to be found.
        wind: standard deviation of the wind beforehand, m/s.
    """

    def __init__(
        self,
        flights: Sequence[DragSamples],
        *,
        quadratic: bool,
        without: Sequence[int] = (),
        known: Sequence[float] | None = None,
        wind: float = WIND,
    ) -> None:
        stride = -(-sum(len(one.time) for one in flights) // _SAMPLES_MOST)
        self.flights, self.step_s = [one.every(stride) for one in flights], stride * STEP_S
        self.drags = 3 if quadratic else 2
        self.quadratic = quadratic
        self.layout: list[tuple[int, Array]] = []
        place = self.drags
        for one in flights:
            count = round((one.time[-1] - one.time[0]) / _KNOTS_S) + 1
            knots = np.linspace(
                one.time[0], one.time[-1], max(2, min(count, 2 * _KNOTS_MOST // len(flights), _KNOTS_MOST))
            )
            self.layout.append((place, knots))
            place += 4 + 2 * len(knots)
        self.theta = np.zeros(place)
        # No drag leaves the wind without an effect: begin at that of a usual vehicle.
        self.theta[: self.drags] = [0.15, 0.005, 0.005] if quadratic else [0.3, 0.3]
        self.mean, self.prior, self.scale = np.zeros(place), self._prior(wind), np.array([0.3, 0.3])
        for axis in without:
            self.theta[1 + axis], self.prior[1 + axis, 1 + axis] = 0.0, _KNOWN
        for axis, value in enumerate(known or ()):
            self.theta[axis] = self.mean[axis] = value
            self.prior[axis, axis] = _KNOWN
        self._solve()

    def _prior(self, wind: float) -> Array:
        prior = np.zeros((len(self.theta), len(self.theta)))
        for place, knots in self.layout:
            prior[range(place, place + 4), range(place, place + 4)] = np.repeat([BIAS**-2, _LEAN**-2], 2)
            for axis in range(2):
                own = place + 4 + axis * len(knots) + np.arange(len(knots))
                prior[own, own] += wind**-2 / len(knots)
                step = 1.0 / (WALK**2 * np.diff(knots))
                np.add.at(prior, (own[1:], own[1:]), step)
                np.add.at(prior, (own[:-1], own[:-1]), step)
                np.add.at(prior, (own[1:], own[:-1]), -step)
                np.add.at(prior, (own[:-1], own[1:]), -step)
        return prior

    def _weights(self, flight: int, time: Array) -> Array:
        """Shares (N, K) of the knots of the wind at times (N,) s."""
        _, knots = self.layout[flight]
        after = np.clip(np.searchsorted(knots, time), 1, len(knots) - 1)
        share = np.clip(
            (time - knots[after - 1]) / np.maximum(knots[after] - knots[after - 1], 1e-9), 0.0, 1.0
        )
        weights = np.zeros((len(time), len(knots)))
        rows = np.arange(len(time))
        weights[rows, after - 1], weights[rows, after] = 1.0 - share, share
        return weights

    def wind_at(self, flight: int, time: Array) -> Array:
        """Wind (N, 2) of a flight to north and east, m/s, at times (N,) s."""
        place, knots = self.layout[flight]
        winds = self.theta[place + 4 : place + 4 + 2 * len(knots)].reshape(2, -1).T
        found: Array = self._weights(flight, time) @ winds
        return found

    def residuals(self, flight: int) -> tuple[Array, Array, Array]:
        """Residuals (N, 2) in m/s², slopes (N, 2, C) by its columns, airspeed (N, 3) in body axes."""
        one, (place, knots), theta = self.flights[flight], self.layout[flight], self.theta
        weights, count = self._weights(flight, one.time), len(knots)
        air = one.velocity.copy()
        air[:, :2] -= self.wind_at(flight, one.time)
        body = np.einsum("nji,nj->ni", one.turn, air)
        speed = np.linalg.norm(body, axis=1)
        slopes = np.zeros((len(body), 2, self.drags + 4 + 2 * count))
        residuals = np.empty((len(body), 2))
        thrust = one.force[:, 2] + STANDARD_GRAVITY
        for axis in range(2):
            if self.quadratic:
                # EKF2: −(MCOEF √(ρ/ρ0) + ½ ρ |v| / BCOEF) v.
                linear, square = np.sqrt(one.air_ratio), 0.5 * STANDARD_DENSITY * one.air_ratio * speed
                gain = theta[0] * linear + theta[1 + axis] * square
                slopes[:, axis, 0] = linear * body[:, axis]
                slopes[:, axis, 1 + axis] = square * body[:, axis]
            else:
                gain = np.full(len(body), theta[axis])
                slopes[:, axis, axis] = body[:, axis]
            bias, lean = theta[place + axis], theta[place + 2 + axis]
            residuals[:, axis] = one.force[:, axis] + gain * body[:, axis] - bias - lean * thrust
            slopes[:, axis, self.drags + axis], slopes[:, axis, self.drags + 2 + axis] = -1.0, -thrust
            for world in range(2):
                own = self.drags + 4 + world * count + np.arange(count)
                slopes[:, axis, own] = -(gain * one.turn[:, world, axis])[:, np.newaxis] * weights
        return residuals, slopes, body

    def columns(self, flight: int) -> Indices:
        """Places (C,) of the parameters that a flight tells of: drag, and its own."""
        place, knots = self.layout[flight]
        return np.concatenate([np.arange(self.drags), place + np.arange(4 + 2 * len(knots))])

    def normal(self) -> tuple[Array, Array, list[_Information]]:
        """Information (P, P) and gradient (P,) with what was known before; and of each piece."""
        whole, pull = self.prior.copy(), self.prior @ (self.theta - self.mean)
        pieces = []
        for flight, one in enumerate(self.flights):
            residuals, slopes, _ = self.residuals(flight)
            slopes, scaled = slopes / self.scale[:, np.newaxis], residuals / self.scale
            columns = self.columns(flight)
            for piece in np.unique(one.piece):
                rows = one.piece == piece
                flat = slopes[rows].reshape(-1, len(columns))
                information, gradient = flat.T @ flat, flat.T @ scaled[rows].ravel()
                pieces.append(_Information(flight, columns, information, gradient))
                whole[np.ix_(columns, columns)] += information
                pull[columns] += gradient
        return whole, pull, pieces

    def _solve(self) -> None:
        for _ in range(_ITERATIONS):
            whole, pull, _ = self.normal()
            step = np.linalg.solve(whole, pull)
            self.theta = self.theta - step
            # Drag that turns up slightly negative would flip the wind on the way.
            self.theta[: self.drags] = np.maximum(self.theta[: self.drags], -0.5)
            together = np.vstack([self.residuals(flight)[0] for flight in range(len(self.flights))])
            # Of autocorrelated samples fewer count: a second's worth each.
            self.scale = np.sqrt(np.mean(together**2, axis=0) / min(self.step_s, 1.0)) + 1e-6
            if np.abs(step[: self.drags]).max() < _SETTLED:
                break

    def intervals(self, *, by_flight: bool) -> tuple[Array, Array, Array]:
        """Drag parameters and mean wind, north and east, of each flight (M,), and ends of intervals (M, 2).

        Also the number (D,) of pieces that would share the information on each drag parameter evenly.

        Args:
            by_flight: leave out whole flights for drag. A wind has one flight: its pieces are left out with
                drag held, and the other flights for what their drag does to it.
        """
        whole, pull, pieces = self.normal()
        wanted = np.zeros((self.drags + 2 * len(self.layout), len(self.theta)))
        wanted[range(self.drags), range(self.drags)] = 1.0
        for flight, (place, knots) in enumerate(self.layout):
            for axis in range(2):
                own = place + 4 + axis * len(knots) + np.arange(len(knots))
                wanted[self.drags + 2 * flight + axis, own] = 1.0 / len(knots)
        groups = [[one] for one in pieces]
        if by_flight:
            groups = [[one for one in pieces if one.flight == flight] for flight in range(len(self.flights))]
        without = np.array([self._without(whole, pull, group) @ wanted.T for group in groups])
        told = np.array([sum(np.diag(one.information)[: self.drags] for one in group) for group in groups])
        share = np.hstack([told, np.ones((len(told), len(wanted) - self.drags))])
        value = wanted @ self.theta
        half = jackknife(value, without, share)[1] - value
        if by_flight:
            for flight in range(len(self.flights)):
                own = self.drags + 2 * flight + np.arange(2)
                half[own] = self._wind_half(whole, pull, groups[flight], wanted[own])
                others = np.delete(without, flight, axis=0)[:, own]
                half[own] = np.hypot(
                    half[own], jackknife(value[own], others, np.ones_like(others))[1] - value[own]
                )
        # Of the wind the pieces tell what the data do, and the information what was known before.
        known = np.einsum("mp,pm->m", wanted, np.linalg.solve(whole, wanted.T))
        half[self.drags :] = np.hypot(half, 2.0 * np.sqrt(known))[self.drags :]
        return value, np.stack([value - half, value + half], axis=1), effective_pieces(told)

    def _without(self, whole: Array, pull: Array, group: Sequence[_Information]) -> Array:
        """Parameters (P,) without some pieces, by one Newton step."""
        less, rest = whole.copy(), pull.copy()
        for one in group:
            less[np.ix_(one.columns, one.columns)] -= one.information
            rest[one.columns] -= one.gradient
        without: Array = self.theta - np.linalg.solve(less, rest)
        return without

    def _wind_half(self, whole: Array, pull: Array, group: Sequence[_Information], wanted: Array) -> Array:
        """Half the interval (2,) of the wind of a flight from its own pieces; not finite for too few."""
        if len(group) < PIECES_FEWEST.value:
            return np.full(2, np.inf)
        own, drags = group[0].columns[self.drags :], self.drags
        part, held, slope = wanted[:, own], whole[np.ix_(own, own)], pull[own]
        steps = [
            np.linalg.solve(held - one.information[drags:, drags:], slope - one.gradient[drags:])
            for one in group
        ]
        value = part @ self.theta[own]
        without = value - np.array(steps) @ part.T
        half: Array = jackknife(value, without, np.ones((len(group), 2)))[1] - value
        return half
