# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The part of the residual that no effect of the library explains, but that other flights predict.

Noise cannot be predicted. So the residual after the effects is fitted by many generic functions of motion,
rotors, place, heading and time. If coefficients fitted on all other flights predict a flight, the search has
missed something.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter
from scipy.special import ndtri

from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.whitening import EDGES_HZ, Columns, Spectrum, band_means, settled_noise
from quadpi_core.flight import AXES
from quadpi_core.frames import Array, rotation_matrix
from quadpi_core.models.interval_rules import inside_interval
from quadpi_core.records import CONVENTION, DEVELOPMENT, Threshold

LAGS_S = Threshold(
    "lags of generic functions",
    (0.1, 0.4),
    "s",
    "the memory of air and rotors: longer than the delay of the low-pass, shorter than a manoeuvre",
    DEVELOPMENT,
)
# A force that depends on the place alone, such as a draught, is looked for at points of the ground.
SPACING = Threshold(
    "spacing of points of the ground",
    7.0,
    "arms of the vehicle",
    "a metre for the Bebop 2, the width of a draught; points that are closer are shared by fewer flights",
    DEVELOPMENT,
)
STAY_S = Threshold(
    "stay at a point of the ground",
    0.25,
    "s of at least two flights",
    "what one flight saw at a point can be predicted only where another has been there",
    DEVELOPMENT,
)
MOST_POINTS = Threshold(
    "points of the ground",
    60,
    "points",
    "those where flights stayed longest; each is three functions of every axis, and the time grows with them",
    DEVELOPMENT,
)
RIDGES = Threshold(
    "ridges of generic functions",
    (1e-4, 1e-3, 1e-2, 0.1),
    "of the squares of each function",
    "from hardly any shrinkage to a tenth; the one that predicts flights left out best is used",
    CONVENTION,
)
_CORNERS = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
WANDER_M_S = Threshold(
    "wander of an onboard velocity",
    0.03,
    "m/s",
    "no log states the slow error of a velocity that an onboard estimator gave, and nobody who flies with it "
    "would call it a force",
    CONVENTION,
)
WANDER_HZ = Threshold("frequency of that wander", 0.5, "Hz", "slower than any manoeuvre", CONVENTION)
SHORT_OF = Threshold(
    "shortfall of the coverage of flights",
    2.0,
    "standard errors over flights",
    "flights of a few seconds differ by several percent; less than this is no shortfall that they show",
    CONVENTION,
)
MISSED = Threshold(
    "samples of a flight that intervals miss",
    4.0,
    "times as many as they state",
    "flights without anything new had up to three and a half times as many; one that has something alone "
    "must not be lost among others",
    "real flights of a Crazyflie with a load, docs/discrepancy.md: moments, which the load hardly changes",
)


def slow_state_noise(flights: Sequence[Compared], bands: int) -> Array:
    """Variance (6, C), in C bands, that slow errors of the velocity add to rows; 0 for smoothed states.

    They are proportional to the slope of the simulated wrench over the velocity, in every simulation, and
    those of a process of first order.
    """
    simulation = flights[0].simulation
    if not simulation.own_inputs and all(own.flight.biases_estimated for own in flights):
        return np.zeros((len(AXES), bands))
    loads = np.concatenate([np.square(own.quiet.rotor_speeds[:: own.step]).sum(axis=1) for own in flights])
    velocity = np.concatenate([own.quiet.velocity[:: own.step] for own in flights])
    wrench = np.concatenate([own.quiet_wrench[:: own.step] for own in flights])
    known = np.column_stack((np.ones_like(loads), loads / loads.mean(), velocity))
    slopes = np.linalg.norm(np.linalg.lstsq(known, wrench, rcond=None)[0][2:], axis=0)
    slowest = np.square(WANDER_M_S.value * slopes) * flights[0].thinned.rate_hz / (2.0 * WANDER_HZ.value)
    # The lower edge of a band is where most of its noise is.
    share = 1.0 / (1.0 + np.square(np.array(EDGES_HZ.value[:bands]) / WANDER_HZ.value))
    return slowest[:, None] * share


class Inside(NamedTuple):
    """What the simulation's own intervals hold.

    Attributes:
        shares: (F, 6) of the samples of each flight.
        confidence: share that they state.
    """

    shares: Array
    confidence: float

    @property
    def held(self) -> npt.NDArray[np.bool_]:
        """Axes (6,) of which they hold as many samples as they say, flight by flight.

        An identified model states by its intervals how well it knows a wrench. What stays inside is no
        discrepancy, even where other flights predict it.
        """
        return as_many_as_stated(self.shares, self.confidence)


def inside_intervals(flights: Sequence[Compared]) -> Inside | None:
    """What the intervals of the simulation hold of the flights; None without intervals."""
    margins = [own.margins for own in flights if own.margins is not None]
    if not margins:
        return None
    pairs = zip(flights, margins, strict=True)
    shares = [inside_interval(own.whole_residual, *bounds[:2]).mean(axis=0) for own, bounds in pairs]
    return Inside(np.array(shares), margins[0].confidence)


def held_axes(inside: Inside | None) -> npt.NDArray[np.bool_]:
    """See :attr:`Inside.held`; none without intervals."""
    return np.zeros(len(AXES), dtype=np.bool_) if inside is None else inside.held


def stated_squares(flights: Sequence[Compared]) -> Array:
    """Mean squares (6,) of the errors that the simulation's own intervals state; 0 without intervals.

    They are those of a normal distribution of which the intervals hold what they say.
    """
    margins = [own.margins for own in flights if own.margins is not None]
    if not margins:
        return np.zeros(len(AXES))
    sigmas = 2.0 * float(ndtri(0.5 + 0.5 * margins[0].confidence))
    values = np.concatenate([np.square((own.upper - own.lower) / sigmas) for own in margins])
    known = np.isfinite(values)
    return np.sum(values, axis=0, where=known) / np.maximum(known.sum(axis=0), 1)


def as_many_as_stated(shares: Array, confidence: float) -> npt.NDArray[np.bool_]:
    """Columns (C,) of shares (F, C) of samples inside, of F flights, that agree with a confidence."""
    error = np.std(shares, axis=0, ddof=1) / np.sqrt(len(shares))
    enough = np.mean(shares, axis=0) + SHORT_OF.value * error >= confidence
    return enough & (1.0 - np.min(shares, axis=0) <= MISSED.value * (1.0 - confidence))


class Unpredicted(NamedTuple):
    """How well generic functions predict flights that they were not fitted on.

    Attributes:
        gain: (6,) squares by which prediction reduces flights left out, in variances of `noise`.
        functions: per axis, names of the functions that predict most, best first.
        noise: (6, C) variance, in C bands of frequency, of the residual after the functions.
    """

    gain: Array
    functions: list[list[str]]
    noise: Array


def functions(compared: Compared) -> tuple[list[str], Array]:
    """Names and values (M, J) of the generic functions for one flight."""
    flight = compared.expected.slice(slice(None, None, compared.step))
    states = compared.states
    vehicle = compared.simulation.vehicle
    hover = compared.simulation.hover_rotor_speed
    velocity = states["velocity_air"] / vehicle.hover_induced_velocity
    u, v, w = velocity.T
    p, q, r = (states["rates"] / 3.0).T
    speed = np.linalg.norm(velocity, axis=1)
    loads = np.square(flight.rotor_speeds / hover)
    load = loads.mean(axis=1)
    rotation = rotation_matrix(flight.attitude)
    height = np.maximum(-flight.position[:, 2], vehicle.rotor_radius_m)
    named: dict[str, Array] = {
        "u": u, "v": v, "w": w, "|V|u": speed * u, "|V|v": speed * v, "|V|w": speed * w,
        "|u|": np.abs(u), "|v|": np.abs(v), "|w|": np.abs(w), "u²": u * u, "v²": v * v, "w²": w * w,
        "uv": u * v, "uw": u * w, "vw": v * w, "u³": u**3, "v³": v**3, "w³": w**3,
        "p": p, "q": q, "r": r, "|p|p": np.abs(p) * p, "|q|q": np.abs(q) * q, "|r|r": np.abs(r) * r,
        "pq": p * q, "qr": q * r, "pr": p * r, "qu": q * u, "pv": p * v, "ru": r * u, "rv": r * v,
        "load": load, "load·u": load * u, "load·v": load * v, "load·w": load * w,
        "load·|V|": load * speed, "load·speed²": load * speed**2,
        "1/height": vehicle.rotor_radius_m / height, "1/height²": (vehicle.rotor_radius_m / height) ** 2,
        "time": flight.time / 20.0, "load·time": load * flight.time / 20.0,
    }  # fmt: skip
    for rotor in range(4):
        named[f"load {rotor + 1}"] = loads[:, rotor] - load
        named[f"spin-up {rotor + 1}"] = states["rotor_accelerations"][:, rotor] / (10.0 * hover)
    for axis, name in enumerate(("north", "east", "down")):
        for body, letter in enumerate("xyz"):
            named[f"{name} along {letter}"] = rotation[:, axis, body]
            place = flight.position[:, axis] / 3.0
            named[f"{name} place along {letter}"] = rotation[:, axis, body] * place
        named[f"place {name}"] = flight.position[:, axis] / 3.0
        named[f"place {name} squared"] = np.square(flight.position[:, axis] / 3.0)
    heading = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
    for name, turned in (("cos", np.cos(heading)), ("sin", np.sin(heading))):
        named[f"{name} heading"] = turned
        for letter, moved in (("u", u), ("v", v), ("|V|", speed)):
            named[f"{name} heading·{letter}"] = turned * moved
    # No derivative of velocity or rates: the estimator's velocity follows the noise of the accelerometer, and
    # its derivative would predict the noise of the measured force.
    for body, letter in enumerate("xyz"):
        named[f"force {letter}"] = flight.specific_force[:, body] / vehicle.gravity_m_s2
    for lag in LAGS_S.value:
        keep = np.exp(-1.0 / (lag * flight.rate_hz))
        for name in ("u", "v", "w", "load"):
            start = [keep * named[name][0]]
            named[f"{name} {lag:g} s ago"] = lfilter([1.0 - keep], [1.0, -keep], named[name], zi=start)[0]
    return list(named), np.stack(list(named.values()), axis=1)


def functions_of_place(flights: Sequence[Compared]) -> tuple[list[str], list[Array]]:
    """Generic functions of place: names and, per flight, values (M, 3, 3 P), at P points of the ground.

    Each is a constant vector of the world that decreases linearly to zero at the neighbouring points. Its
    components in body axes are functions for the axes of the force, and for those of the moment.
    """
    arm = np.linalg.norm(flights[0].simulation.vehicle.rotor_positions[:, :2], axis=1).mean()
    positions = [flight.thinned.position[:, :2] / (SPACING.value * arm) for flight in flights]
    corners = [(np.floor(position)[:, None] + _CORNERS).reshape(-1, 2) for position in positions]
    points, which = np.unique(np.concatenate(corners), axis=0, return_inverse=True)
    ends = np.cumsum([len(own) for own in corners])[:-1]
    stays = [
        np.bincount(at, _hats(np.repeat(position, 4, axis=0) - own), len(points)) / flight.thinned.rate_hz
        for at, position, own, flight in zip(
            np.split(which.ravel(), ends), positions, corners, flights, strict=True
        )
    ]
    second = np.sort(stays, axis=0)[-2]
    known = np.argsort(-second, kind="stable")[: MOST_POINTS.value]
    known = known[second[known] > STAY_S.value]
    names = [f"place {axis}" for axis in ("north", "east", "down") for _ in known]
    values = []
    for flight, position in zip(flights, positions, strict=True):
        near = _hats(position[:, None] - points[known])
        seen = np.swapaxes(rotation_matrix(flight.thinned.attitude), 1, 2)
        values.append((seen[:, :, :, None] * near[:, None, None]).reshape(len(near), 3, -1))
    return names, values


def functions_of_course(flight: Compared) -> tuple[list[str], Array]:
    """Generic functions of course: names and values (M, 3, 18).

    They are vectors of the world in proportion to the velocity through the air. Examples are the force of a
    cable that unrolls, and of air that one direction of flight stirs up.
    """
    rotation = rotation_matrix(flight.thinned.attitude)
    scale = flight.simulation.vehicle.hover_induced_velocity
    velocity = np.einsum("nij,nj->ni", rotation, flight.states["velocity_air"]) / scale
    going = np.concatenate((velocity, np.abs(velocity)), axis=1)
    parts = [f"{way} {axis}" for way in ("flight", "speed") for axis in ("north", "east", "down")]
    names = [f"{part} along {axis}" for axis in ("north", "east", "down") for part in parts]
    values = np.swapaxes(rotation, 1, 2)[:, :, :, None] * going[:, None, None]
    return names, values.reshape(len(values), 3, -1)


def _hats(away: Array) -> Array:
    """Weights (…,) of distances (…, 2) in spacings: 1 at a point, falling linearly to 0 at one spacing."""
    return np.prod(np.maximum(1.0 - np.abs(away), 0.0), axis=-1)


def generic_spectra(flights: Sequence[Compared]) -> tuple[list[str], list[Spectrum]]:
    """Names of the functions and their spectra for each flight: rows (6, B, J)."""
    place_names, place_values = functions_of_place(flights)
    names: list[str] = []
    spectra = []
    for flight, place in zip(flights, place_values, strict=True):
        names, values = functions(flight)
        course_names, course = functions_of_course(flight)
        alike = flight.spectrum(values[:, None, :])
        local = flight.spectrum(np.concatenate((course, place), axis=2))
        rows = (np.tile(alike.rows, (len(AXES), 1, 1)), np.tile(local.rows, (2, 1, 1)))
        spectra.append(Spectrum(np.concatenate(rows, axis=2), alike.band))
    return [*names, *course_names, *place_names], spectra


def predicted(left: Sequence[Array], spectra: Sequence[Spectrum], names: list[str]) -> Unpredicted:
    """Prediction of each flight by generic functions fitted on the others.

    The noise is that of the residual after the functions.

    Args:
        left: per flight, rows (6, B) of the residual after the effects.
        spectra: spectra of the functions, see :func:`generic_spectra`.
        names: names of the functions.
    """
    bands = [flight.band for flight in spectra]
    noise = band_means([np.square(rows) for rows in left], bands)
    counts = np.bincount(np.concatenate(bands))
    gain, best = np.zeros(len(AXES)), []
    for axis in range(len(AXES)):
        columns = Columns(
            tuple(
                Spectrum(np.column_stack((rows[axis], flight.rows[axis]))[None], flight.band)
                for rows, flight in zip(left, spectra, strict=True)
            )
        )
        products = columns.products(columns)
        noise[axis] = settled_noise(products.sum(axis=0), counts, noise[axis : axis + 1], _penalty)[0]
        grams = np.tensordot(products[:, 0], 1.0 / noise[axis], axes=(1, 0))
        gain[axis], coefficients = left_out_gain(grams[:, 1:, 1:], grams[:, 1:, 0])
        size = np.abs(coefficients) * np.sqrt(np.einsum("fjj->j", grams[:, 1:, 1:]))
        best.append([names[index] for index in np.argsort(-size)[:3]])
    return Unpredicted(gain, best, noise)


def left_out_gain(grams: Array, projections: Array) -> tuple[float, Array]:
    """Squares by which prediction reduces flights left out, and coefficients (J,), with the best ridge.

    Args:
        grams: (F, J, J) of whitened functions.
        projections: (F, J) of the residual on them.
    """
    total, aim = grams.sum(axis=0), projections.sum(axis=0)
    best, kept = -np.inf, np.zeros(len(total))
    for ridge in RIDGES.value:
        penalty = _penalty(total, ridge)
        gain = 0.0
        for own, projection in zip(grams, projections, strict=True):
            coefficients = np.linalg.solve(total - own + penalty, aim - projection)
            gain += float(2.0 * coefficients @ projection - coefficients @ own @ coefficients)
        if gain > best:
            best, kept = gain, np.linalg.solve(total + penalty, aim)
    return best, kept


def _penalty(total: Array, ridge: float = RIDGES.value[0]) -> Array:
    # A function that stays zero, such as a force that a simulation lacks, must leave the matrix regular.
    scale = np.sqrt(np.diag(total))
    return np.diag(ridge * np.maximum(scale, 1e-6 * scale.max()) ** 2)
