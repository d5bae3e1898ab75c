# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Rotor speed from command and battery voltage, and what that says of the tachometers.

    n = c · (1, u, u², V, u V),      followed by a first-order lag and a dead time,

of each rotor, by least squares on some flights and judged on others. A rotor whose tachometer reads another
multiple of what its command gives than the others' do is named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from quadpi_core.field.airborne import Flown
from quadpi_core.field.field_log import FieldLog
from quadpi_core.frames import Array
from quadpi_core.thresholds import Threshold

_GRID_HZ = 100.0
_SLOWEST_HZ = 20.0
_LAGS_S = (0.0, 0.01, 0.02, 0.025, 0.03, 0.035, 0.04, 0.05, 0.06, 0.07, 0.08, 0.1, 0.12, 0.15, 0.2)
_DEAD_S = (0.0, 0.004, 0.008, 0.012, 0.016, 0.02, 0.03)
# Flights on which lag and dead time are chosen.
_CHOSEN_ON = 3
HALF_READING = Threshold(
    "speed of a rotor over that of the others at the same command from which its tachometer counts otherwise",
    (0.6, 1.6),
    "",
    "counting every second pulse, or one twice, gives 0.5 or 2; rotors of one vehicle differ by up to 15 %",
    "eckart51 to 54 of imrc_payload in ../shared/data read 0.502",
)


# As many fits, each without its share of the flights.
_FOLDS_MOST = 5
_Part = tuple[Array, Array, Array]  # commands (N, R), volts (N, 1) or (N, 0), speeds (N, R)


@dataclass(frozen=True)
class MotorModel:
    """Motors of one vehicle.

    Attributes:
        error: root mean square on what was left out, over the mean speed, all rotors together.
        error_scaled: the same after one gain for each flight, as a battery that is not logged asks for.
        by_rotor: `error` of each rotor.
        lag_s: of the first order, the best of a grid; None at its ends, where it is not told.
        dead_s: before it, transport and the filter of the tachometer together; None at the end of its grid.
        with_battery: whether voltage is in it.
        flights: number; each fifth of them is judged by a fit on the others, of a single flight each half.
    """

    error: float
    error_scaled: float
    by_rotor: tuple[float, ...]
    lag_s: float | None
    dead_s: float | None
    with_battery: bool
    flights: int


@dataclass(frozen=True)
class Tachometers:
    """Rotor speeds of one flight against its commands.

    Attributes:
        gain: speed over command of the middle rotor, rad/s.
        ratio: (R) speed of each rotor over that of the others at the same command.
        odd: rotors, from 1, whose tachometers read another multiple.
    """

    gain: float
    ratio: tuple[float, ...]
    odd: tuple[int, ...]


def tachometers(log: FieldLog, flight: Flown) -> Tachometers | str:
    """Whether the tachometers of one flight read what the commands give, or why it cannot be told."""
    parts = _parts(log, flight)
    if isinstance(parts, str):
        return parts
    commands, speeds = (np.vstack([part[place] for part in parts]) for place in (0, 2))
    # Around hover speed grows about linearly with command, the same for motors of one kind.
    gains = np.median(speeds / np.maximum(commands, 1e-6), axis=0)
    ratios = [gains[rotor] / max(np.median(np.delete(gains, rotor)), 1e-9) for rotor in range(len(gains))]
    low, high = HALF_READING.value
    odd = tuple(rotor + 1 for rotor, ratio in enumerate(ratios) if not low < ratio < high)
    return Tachometers(float(np.median(gains)), tuple(map(float, ratios)), odd)


def motor_model(flights: Sequence[tuple[FieldLog, Flown]]) -> MotorModel | str:
    """The motors of one vehicle, or why they cannot be told."""
    usable = [(log, flight) for log, flight in flights if not isinstance(_parts(log, flight), str)]
    if not usable:
        return str(_parts(*flights[0]))
    volts = all(log.battery is not None for log, _ in usable)
    lag, dead = _lag_and_dead_time(usable[:: max(1, len(usable) // _CHOSEN_ON)], with_battery=volts)
    known = [_known(log, flight, dead, with_battery=volts) for log, flight in usable]
    if len(known) == 1:
        folds = [[[_half(part, which) for part in known[0]]] for which in (0, 1)]
    else:
        folds = [known[first::_FOLDS_MOST] for first in range(min(len(known), _FOLDS_MOST))]
    fits = [
        [part for other, fold in enumerate(folds) if other != one for parts in fold for part in parts]
        for one in range(len(folds))
    ]
    judged = [
        [_errors(_fitted(fit, lag), fold, lag, scaled=scaled) for fit, fold in zip(fits, folds, strict=True)]
        for scaled in (False, True)
    ]
    mean = float(np.mean(np.concatenate([part[2].ravel() for fit in fits for part in fit])))
    squares = [
        np.sum([square for square, _ in own], axis=0) / sum(count for _, count in own) for own in judged
    ]
    by_rotor = np.sqrt(squares[0]) / mean
    return MotorModel(
        error=float(np.sqrt(np.mean(by_rotor**2))),
        error_scaled=float(np.sqrt(np.mean(squares[1])) / mean),
        by_rotor=tuple(map(float, by_rotor)),
        lag_s=lag if _LAGS_S[0] < lag < _LAGS_S[-1] else None,
        dead_s=dead if dead < _DEAD_S[-1] else None,
        with_battery=volts,
        flights=len(known),
    )


def _lag_and_dead_time(
    flights: Sequence[tuple[FieldLog, Flown]], *, with_battery: bool
) -> tuple[float, float]:
    """Those of the grid that leave the smallest error."""
    errors = {}
    for dead in _DEAD_S:
        parts = [part for own in flights for part in _known(*own, dead, with_battery=with_battery)]
        for lag in _LAGS_S:
            errors[lag, dead] = float(np.sum(_errors(_fitted(parts, lag), [parts], lag, scaled=False)[0]))
    return min(errors, key=lambda pair: errors[pair])


def _known(log: FieldLog, flight: Flown, dead_s: float, *, with_battery: bool) -> list[_Part]:
    parts = _parts(log, flight, dead_s)
    assert not isinstance(parts, str)
    return parts if with_battery else [(commands, own[:, :0], speeds) for commands, own, speeds in parts]


def _parts(log: FieldLog, flight: Flown, dead_s: float = 0.0) -> list[_Part] | str:
    """Stretches of a flight on one grid, commands by the dead time late, or why there are none."""
    if log.commands is None or log.rotor_speeds is None:
        return "the log has not both commands and rotor speeds"
    rotors = log.rotor_speeds.values.shape[1]
    if log.commands.values.shape[1] != rotors:
        return f"the log has {log.commands.values.shape[1]} commands for {rotors} rotor speeds"
    slow = min(log.commands.rate_hz, log.rotor_speeds.rate_hz)
    if slow < _SLOWEST_HZ:
        return f"commands and rotor speeds are logged at {slow:.0f} Hz, slower than motors are"
    parts = [_gridded(log, one.begin, one.end, dead_s) for one in flight.stretches]
    return [part for part in parts if len(part[0]) > 2 * _GRID_HZ] or "the flight is too short"


def _gridded(log: FieldLog, begin: float, end: float, dead_s: float) -> _Part:
    assert log.commands is not None
    assert log.rotor_speeds is not None
    edges = np.arange(begin, end, 1.0 / _GRID_HZ)
    time = 0.5 * (edges[1:] + edges[:-1])
    speeds = log.rotor_speeds.filled_means(edges)
    # The same samples for every dead time: errors compare, and a short flight is short for all of them.
    latest, commands = (log.commands.filled_means(edges - late) for late in (_DEAD_S[-1], dead_s))
    volts = np.empty((len(time), 0)) if log.battery is None else log.battery.at(time)
    good = np.isfinite(np.hstack([latest, commands, speeds, volts])).all(axis=1)
    return commands[good], volts[good], speeds[good]


def _half(part: _Part, which: int) -> _Part:
    cut = len(part[0]) // 2
    return tuple(own[:cut] if which == 0 else own[cut:] for own in part)  # type: ignore[return-value]


def _columns(part: _Part, rotor: int, lag_s: float) -> Array:
    u, volts = part[0][:, rotor], part[1]
    terms = [np.ones_like(u), u, u * u]
    if volts.shape[1]:
        terms += [volts[:, 0], u * volts[:, 0]]
    columns = np.stack(terms, axis=1)
    if lag_s > 0.0:
        keep = np.exp(-1.0 / (_GRID_HZ * lag_s))
        columns = lfilter([1.0 - keep], [1.0, -keep], columns, axis=0, zi=keep * columns[:1])[0]
    lagged: Array = columns
    return lagged


def _fitted(parts: Sequence[_Part], lag_s: float) -> list[Array]:
    """Coefficients of each rotor."""
    fits = []
    for rotor in range(parts[0][2].shape[1]):
        columns = np.vstack([_columns(part, rotor, lag_s) for part in parts])
        speeds = np.concatenate([part[2][:, rotor] for part in parts])
        # A ridge of a millionth: a battery that holds its voltage is no reason to fail.
        scale = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-9)
        scaled = columns / scale
        gram = scaled.T @ scaled / len(scaled) + 1e-6 * np.eye(columns.shape[1])
        fits.append(np.linalg.solve(gram, scaled.T @ speeds / len(scaled)) / scale)
    return fits


def _errors(
    fits: Sequence[Array], flights: Sequence[Sequence[_Part]], lag_s: float, *, scaled: bool
) -> tuple[Array, int]:
    """Sums of squared errors (R,), after a gain for each flight if `scaled`, and the number of samples."""
    squares, count = np.zeros(len(fits)), 0
    for parts in flights:
        speeds = np.vstack([part[2] for part in parts])
        told = np.stack(
            [
                np.concatenate([_columns(part, rotor, lag_s) @ own for part in parts])
                for rotor, own in enumerate(fits)
            ],
            axis=1,
        )
        gain = np.sum(told * speeds) / np.sum(told * told) if scaled else 1.0
        squares += np.sum((speeds - gain * told) ** 2, axis=0)
        count += len(speeds)
    return squares, count
