# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What sound flights leave of a model, from flights left out in turn: see `quadpi_core.monitor.change`.

On each axis the variances are those of the greatest likelihood over the flights, each with a constant of its
own, with the distribution of Student that the evidence has: by a normal one a few bursts of the residuals
make constant and process look steadier than they are. A dozen flights know little of how constants differ and
walk, and often put both at nothing: they are taken at the upper end of their interval of 50 % by the
likelihood ratio, and what flights differ by never below what Student's distribution says of one more.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize
from scipy.stats import chi2, norm, t

from quadpi_core.core import compiled
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.identification.alarm_calibration import Judged, LeftOut, LiveErrors, ranges_of_others
from quadpi_core.identification.repeating_part import GROUPS, learn_repeating
from quadpi_core.inputs import INPUT_INDEX, VELOCITY_INPUTS, aerodynamic_inputs
from quadpi_core.models.alarm_limits import (
    BOUND_CONFIDENCE,
    CHANGE_AXES,
    FEWEST_FLIGHTS,
    ChangeLimits,
    LeftOnAxis,
)
from quadpi_core.models.envelope import Envelope
from quadpi_core.models.interval_rules import FEWEST_INSIDE
from quadpi_core.models.model_kind import Evaluation
from quadpi_core.monitor.alarm_kernel import geometry_record
from quadpi_core.monitor.change import (
    AXIS_NOISE,
    BLOCK_FILLED_S,
    BLOCK_S,
    CHANGE,
    CHANGE_BLOCK,
    FREEDOM,
    OF_THRUST,
    nothing_found,
    sound_noise,
)
from quadpi_core.records import Records
from quadpi_core.vehicle import Vehicle

# Fewest blocks of a flight that counts: 2 s.
_FEWEST_BLOCKS = 20
# Where the search for the variances begins: shares of the variance of the blocks, and s of the process.
_START = {"between": 1e-3, "walk": 1e-3, "process": 0.6, "white": 0.3}
_START_S = 0.2
# Evaluations of the likelihood, and its change, and that of logarithms, at which it ends.
_EVALUATIONS, _CLOSE = 600, 0.02
# Logarithms that a variance is searched in about its start, and bisections of that.
_WIDE, _HALVINGS = 6.0, 14
# Of the interval of a variance.
_SURE = 0.5
# Squared scale of the distribution of errors over their deviation, times its degrees of freedom: with it the
# filter's deviations are about those of the errors.
_TAIL = 1.27
# Steps by which the scale of Student's distribution converges.
_STEPS = 50
# Samples that the levers are averaged over, and the change of a rotor's speed.
_SAMPLES, _FASTER = 2000, 1.005


def calibrate_change(
    flights: Sequence[Judged],
    live: Sequence[LiveErrors],
    signals: Sequence[LeftOut],
    margin: Array,
    vehicle: Vehicle,
    evaluate: Callable[[Array, Records], Evaluation],
) -> ChangeLimits | None:
    """What flights leave of a model; None where there are too few of them, or the model lacks Fz.

    Args:
        flights: of the identification.
        live: errors that the live path would make on each, left out; see `alarm_calibration.live_errors`.
        signals: of the alarm on each; see `alarm_calibration.left_out`.
        margin: (19,) of a warning, beyond the range of the inputs.
        vehicle: that flew.
        evaluate: the model of all flights, of inputs (M, 19) and derivatives (M,).
    """
    if not live or "Fz" not in live[0].errors:
        return None
    # As in flight: no samples beyond the warning, but for inputs that a heavier vehicle has however it flies.
    within = [
        np.all((Envelope.outside(signal.inputs, *others) <= margin) | OF_THRUST, axis=1)
        for signal, others in zip(signals, ranges_of_others(signals), strict=True)
    ]
    usual = [
        _blocks(flight, errors, inside, vehicle.rotor_count)
        for flight, errors, inside in zip(flights, live, within, strict=True)
        if len(inside) and np.mean(inside) >= FEWEST_INSIDE
    ]
    usual = [blocks for blocks in usual if len(blocks) >= _FEWEST_BLOCKS]
    axes = tuple(axis for axis in CHANGE_AXES if axis in live[0].errors)
    if len(usual) < FEWEST_FLIGHTS:
        return None
    levers = _levers(flights, vehicle, evaluate)
    hours = BLOCK_S * sum(map(len, usual)) / 3600.0

    def limits(of: Sequence[Records], largest: float) -> ChangeLimits:
        repeating, rest = learn_repeating(of, axes)
        residuals = {axis: _left_on_axis(rest, AXES.index(axis)) for axis in axes}
        return ChangeLimits(residuals, levers, len(usual), hours, largest, repeating)

    largest = 0.0
    groups = min(GROUPS, len(usual))
    for group in range(groups):
        others = limits([blocks for k, blocks in enumerate(usual) if k % groups != group], 0.0)
        peaks = [float(evidence(others, vehicle, blocks).max()) for blocks in usual[group::groups]]
        largest = max(largest, *peaks)
    return limits(usual, largest)


def evidence(limits: ChangeLimits, vehicle: Vehicle, blocks: Records) -> Array:
    """The evidence (N,) after each of the blocks (N,) of a flight, as the monitor gathers it."""
    memory, gathered = np.zeros(1, CHANGE), np.empty(len(blocks))
    memory["found"] = nothing_found(1)
    noise, rotors = sound_noise(limits, vehicle), geometry_record(vehicle, 0.0)
    compiled.gather_evidence(noise, rotors, blocks, memory, gathered)
    return gathered


def _blocks(flight: Judged, live: LiveErrors, inside: npt.NDArray[np.bool_], rotors: int) -> Records:
    """Means of the errors of a flight over blocks of time, of the samples (M,) that are inside."""
    time, rows = flight.time[live.rows][inside], live.rows[inside]
    if len(time) < 2:
        return np.empty(0, CHANGE_BLOCK)
    numbers, starts = np.unique(np.floor(time / BLOCK_S).astype(np.int64), return_index=True)
    counts = np.diff(starts, append=len(time))

    def means(of_samples: Array) -> Array:
        sums: Array = np.add.reduceat(of_samples, starts, axis=0).T / counts
        return sums.T

    blocks = np.zeros(len(numbers), CHANGE_BLOCK)
    blocks["number"] = numbers
    for axis, errors in live.errors.items():
        blocks["residual"][:, AXES.index(axis)] = means(errors.error[inside])
    lift = live.errors["Fz"].error[inside] - flight.judged.wrench[rows, AXES.index("Fz")]
    blocks["lift"] = means(lift)
    blocks["inputs"] = means(flight.judged.inputs[rows])
    blocks["squares"][:, :rotors] = means(np.square(flight.judged.derivatives["rotor_speeds"][rows]))
    filled = counts * float(np.median(np.diff(flight.time[live.rows]))) >= BLOCK_FILLED_S
    return blocks[filled & (blocks["lift"] > 0.0)]


class _Whitened(NamedTuple):
    """Errors of blocks of all flights over their standard deviations, these, and the answer to a constant.

    Attributes:
        loudness: running mean of the squared errors before each.
    """

    errors: Array
    spreads: Array
    ones: Array
    loudness: Array

    @property
    def mean(self) -> float:
        """The constant that fits all flights best."""
        return float(self.ones @ self.errors / (self.ones @ self.ones))


class _Axis:
    """Residuals of an axis, by flight, and the likelihood of what they are made of."""

    def __init__(self, flights: Sequence[Records], axis: int) -> None:
        self._residuals = [np.ascontiguousarray(blocks["residual"][:, axis]) for blocks in flights]
        self._numbers = [np.ascontiguousarray(blocks["number"]) for blocks in flights]
        self._room = np.empty((4, sum(map(len, flights))))
        self.noise = np.zeros(1, AXIS_NOISE)
        self.variance = float(np.mean([np.var(residuals) for residuals in self._residuals]))
        self.of_means = float(np.var([np.mean(residuals) for residuals in self._residuals]))

    def whitened(self) -> _Whitened:
        """The residuals as the noise has them."""
        start = 0
        for residuals, numbers in zip(self._residuals, self._numbers, strict=True):
            out = self._room[:, start : start + len(residuals)]
            compiled.whiten_blocks(self.noise, residuals, numbers, *out)
            start += len(residuals)
        return _Whitened(*self._room)

    def set_logarithms(self, logarithms: Array) -> None:
        """Take the noise from logarithms of its variances and of the time of its process."""
        between, walk, time_s, process, white = np.exp(logarithms)
        for name, value in {
            "between": between,
            "walk": walk,
            "keep": np.exp(-BLOCK_S / time_s),
            "process": process,
            "white": white,
        }.items():
            self.noise[name] = value

    def minus_log_likelihood(self, logarithms: Array) -> float:
        """Restricted (Patterson and Thompson 1971): of the residuals less a mean of all flights."""
        self.set_logarithms(logarithms)
        whitened = self.whitened()
        ones = whitened.ones
        squares = np.square(whitened.errors - whitened.mean * ones)
        tails = 0.5 * (FREEDOM + 1.0) * np.log1p(squares / _TAIL).sum()
        return float(np.log(whitened.spreads).sum() + tails + 0.5 * np.log(ones @ ones))


def _left_on_axis(flights: Sequence[Records], axis: int) -> LeftOnAxis:
    statistics = _Axis(flights, axis)
    least = np.finfo(float).tiny + 1e-12 * statistics.variance
    start = np.log(
        [
            statistics.of_means + _START["between"] * statistics.variance + least,
            _START["walk"] * statistics.variance + least,
            _START_S,
            _START["process"] * statistics.variance + least,
            _START["white"] * statistics.variance + least,
        ]
    )

    def cost(logarithms: Array) -> float:
        far = float(np.max(np.abs(logarithms - start)))
        return statistics.minus_log_likelihood(logarithms) if far <= 2.0 * _WIDE else np.inf

    optimum = minimize(
        cost,
        start,
        method="Nelder-Mead",
        options={"maxfev": _EVALUATIONS, "xatol": _CLOSE, "fatol": _CLOSE},
    )
    own_between = float(np.exp(optimum.x[0]))
    sure = BOUND_CONFIDENCE.value
    # Both ends at once: the second may fall by as much again.
    drop, upper = 0.5 * float(chi2.ppf(_SURE, 1)), optimum.x.copy()
    for place, falls in ((1, drop), (0, 2.0 * drop)):
        upper[place] = _upper_end(cost, upper, place, start[place], optimum.fun + falls)
    count = len(flights)
    # As far as one more flight may lie from the mean of them.
    wider = (1.0 + 1.0 / count) * (t.ppf(0.5 + 0.5 * sure, count - 1) / norm.ppf(0.5 + 0.5 * sure)) ** 2
    statistics.set_logarithms(upper)
    mean = statistics.whitened().mean
    statistics.noise["mean"], statistics.noise["between"] = (
        mean,
        max(statistics.noise["between"][0], wider * own_between),
    )
    whitened = statistics.whitened()
    # As the evidence scales them.
    errors = whitened.errors / np.sqrt(np.maximum(whitened.loudness, compiled.LOUDNESS_LEAST))
    loudest = max(1.0, float(whitened.loudness.max()))
    left = {
        name: float(statistics.noise[name][0]) for name in ("between", "walk", "keep", "process", "white")
    }
    return LeftOnAxis(mean=mean, **left, scale=_student_scale(errors), loudest=loudest)


def _upper_end(cost: Callable[[Array], float], at: Array, place: int, start: float, most: float) -> float:
    """Largest of one of the logarithms at which the cost is no more than that."""
    low, high = max(float(at[place]), start - _WIDE), start + _WIDE
    for _ in range(_HALVINGS):
        tried = at.copy()
        tried[place] = 0.5 * (low + high)
        if cost(tried) < most:
            low = tried[place]
        else:
            high = tried[place]
    return low


def _student_scale(errors: Array) -> float:
    """Scale of Student's distribution by the likelihood (Lange, Little and Taylor 1989)."""
    squares = np.square(errors)
    scale = float(squares.mean())
    for _ in range(_STEPS):
        scale = float(np.mean((FREEDOM + 1.0) * squares / (FREEDOM + squares / scale)))
    return float(np.sqrt(scale))


def _levers(
    flights: Sequence[Judged], vehicle: Vehicle, evaluate: Callable[[Array, Records], Evaluation]
) -> tuple[tuple[float, float, float], ...]:
    """For each rotor, by what the model has Fz, Mx and My change per newton that it gives less."""
    known = [flight.judged.known for flight in flights]
    inputs = np.concatenate([f.judged.inputs[own] for f, own in zip(flights, known, strict=True)])
    moving = np.concatenate([f.judged.derivatives[own] for f, own in zip(flights, known, strict=True)])
    step = -(-len(inputs) // _SAMPLES)
    inputs, moving = inputs[::step], moving[::step].copy()
    attitude = _attitudes(inputs)
    velocity, rates = (inputs[:, columns] for columns in (VELOCITY_INPUTS, _RATES))

    def centre(speeds: Array) -> Array:
        moving["rotor_speeds"] = speeds
        evaluation = evaluate(aerodynamic_inputs(velocity, attitude, rates, speeds, vehicle), moving)
        return 0.5 * (evaluation.lower + evaluation.upper)

    speeds = moving["rotor_speeds"].copy()
    squares = np.square(speeds)
    before = centre(speeds)
    shown = [AXES.index(axis) for axis in ("Fz", "Mx", "My")]
    levers = []
    for k in range(vehicle.rotor_count):
        faster = speeds.copy()
        faster[:, k] *= _FASTER
        thrust = -before[:, 2] * (np.square(faster[:, k]) - squares[:, k]) / squares.sum(axis=1)
        change = (before - centre(faster))[:, shown]
        lever = (change * thrust[:, np.newaxis]).sum(axis=0) / float(np.square(thrust).sum())
        levers.append((float(lever[0]), float(lever[1]), float(lever[2])))
    return tuple(levers)


_RATES = [INPUT_INDEX[name] for name in ("p", "q", "r")]


def _attitudes(inputs: Array) -> Array:
    """Quaternions (N, 4) of the roll and pitch angles of input vectors, without yaw."""
    columns: Mapping[str, Array] = {name: inputs[:, k] for name, k in INPUT_INDEX.items()}
    roll = 0.5 * np.arctan2(columns["sin_phi"], columns["cos_phi"])
    pitch = 0.5 * np.arctan2(columns["sin_theta"], columns["cos_theta"])
    cos_roll, sin_roll, cos_pitch, sin_pitch = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    return np.stack(
        (cos_roll * cos_pitch, sin_roll * cos_pitch, cos_roll * sin_pitch, -sin_roll * sin_pitch), axis=1
    )
