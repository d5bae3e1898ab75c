# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of rotor speeds that are made of motor commands, as noise of a search, and what they hide.

Nothing measured these speeds: each flight has a gain of all of them, one of each rotor and a lag of its own,
known as well as motors predicted flights that they were not identified on. Motors that are known by thrust
alone, and of no other flights than those searched, take their scale from them: what scales all thrust
(a mass, a thrust coefficient) is then in the speeds already.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.simulations import Simulation
from quadpi_core.discrepancy.whitening import Columns, Noise, OfEachFlight, Part, rows_of
from quadpi_core.flight import Flight
from quadpi_core.frames import Array
from quadpi_core.motors import Motors
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.simulation.effect_registry import EFFECTS
from quadpi_core.thresholds import CONVENTION, DEVELOPMENT, Threshold
from quadpi_core.vehicle import Vehicle

if TYPE_CHECKING:
    from quadpi_core.discrepancy.closure import Found
    from quadpi_core.discrepancy.effect_regression import Regression

GAIN_LEAST = Threshold(
    "least standard deviation of the gain of all rotor speeds from commands",
    0.005,
    "",
    "another pack on another day; flights of one afternoon differ by less",
    "imrc_payload of ../shared/data by the motors of imrc_brushless",
)
ROTORS_DIFFER = Threshold(
    "standard deviation of the speed of a rotor at the command of the others, where no tachometer told it",
    0.03,
    "",
    "motors of one kind differ; motors known by thrust alone are taken as alike",
    "motors of imrc_brushed of ../shared/data by their tachometers",
)
LAG_ERROR = Threshold(
    "standard deviation of the lag of rotor speeds from commands",
    0.15,
    "of the lag",
    "a first-order lag is a simplification: rotors spool up faster than down",
    CONVENTION,
)
ALIKE = Threshold(
    "share of the squares of an effect that gains of rotor speeds explain, from which that is said",
    0.8,
    "",
    "what is left of the effect is then less than half of it",
    DEVELOPMENT,
)
HIDDEN = Threshold(
    "share of the evidence of an effect that errors of rotor speeds take, from which they hide it",
    0.9,
    "",
    "the effect would have to be three times as large to be seen as by measured speeds",
    CONVENTION,
)
# Thrust goes with the square of speed but for what airspeed adds: steps in which the scale converges.
_SCALE_STEPS = 4
# Of a scale that only the searched flights tell: larger than any effect.
_UNKNOWN_SCALE = 0.5
# Steps of the differences: 1 % of speed, 2 ms of lag.
_SHARE, _LATE_S = 0.01, 0.002


@dataclass(frozen=True)
class CommandedSpeeds:
    """That rotor speeds of a search are made of commands, how well they are known, and what that hides.

    Attributes:
        flights: names of the flights concerned.
        gain: standard deviation of a gain of all speeds, from flight to flight.
        rotors: standard deviation of a gain of each rotor beside, the largest.
        scale_known: whether other flights or tachometers tell the scale of the speeds.
        hidden: effects of which these speeds hide most of what measured ones would tell.
        alike: of each named effect that errors of speeds resemble, the gains (R) that would look the same.
    """

    flights: tuple[str, ...]
    gain: float
    rotors: float
    scale_known: bool
    hidden: tuple[str, ...] = ()
    alike: tuple[tuple[str, tuple[float, ...]], ...] = ()

    @property
    def sentences(self) -> tuple[str, ...]:
        """What a reader has to know."""
        told = [
            f"Rotor speeds are made of motor commands: from flight to flight their gain scatters by "
            f"{_percent(self.gain)}, that of single rotors by {_percent(self.rotors)} (standard deviations)."
        ]
        if not self.scale_known:
            told.append(
                "Their scale is that of the thrust of these flights: a mass, a thrust coefficient and a gain "
                "of all speeds cannot be told apart, and none of them is found."
            )
        told += [
            f"{name.replace('_', ' ').capitalize()} looks as if the motors turned by "
            f"{', '.join(f'{100.0 * gain:+.1f}' for gain in gains)} % (rotor 1 to {len(gains)}) off what the "
            "commands tell, in all flights: only its size speaks for it."
            for name, gains in self.alike
        ]
        return tuple(told)

    def to_json(self) -> dict[str, Any]:
        """As JSON holds it."""
        return {**asdict(self), "alike": dict(self.alike), "text": list(self.sentences)}


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"


def at_scale_of(simulation: Simulation, flights: Sequence[Flight]) -> list[Flight]:
    """The flights with rotor speeds of an assumed scale brought to that of a simulation, all by one factor.

    With it the simulated thrust along the body is on average the measured one.
    """

    def is_assumed(flight: Flight) -> bool:
        return flight.motors is not None and not _scale_is_known(flight.motors, simulation.vehicle)

    assumed, gain = [own for own in flights if is_assumed(own)], 1.0
    if not assumed or simulation.own_inputs:
        return list(flights)
    measured = sum(float(measured_wrench(own, simulation.vehicle)[:, 2].sum()) for own in assumed)
    for _ in range(_SCALE_STEPS):
        scaled = [replace(own, rotor_speeds=gain * own.rotor_speeds) for own in assumed]
        simulated = sum(float(simulation.wrench(own)[:, 2].sum()) for own in scaled)
        if simulated * measured <= 0.0:
            return list(flights)
        gain *= float(np.sqrt(measured / simulated))
    return [replace(own, rotor_speeds=gain * own.rotor_speeds) if is_assumed(own) else own for own in flights]


def errors_of_speeds(flights: Sequence[Compared]) -> tuple[OfEachFlight, ...]:
    """What flights have of their own as their rotor speeds are of commands; empty where all are measured."""
    if all(own.flight.motors is None for own in flights):
        return ()
    vehicle = flights[0].simulation.vehicle
    columns = Columns(tuple(own.spectrum(_columns(own)) for own in flights))
    each = [np.diag(_deviations(own.flight.motors, vehicle, len(flights))) for own in flights]
    return (OfEachFlight(columns, np.stack(each)),)


def _columns(flight: Compared) -> Array:
    """What a gain of all speeds, one of each rotor (by 1) and a lag [s] add to the residual (M, 6, K)."""
    scale, delay = EFFECTS["rotor_speed_scale"], EFFECTS["sensor_delay"]
    rotors = range(flight.flight.rotor_speeds.shape[1] + 1)
    gains = [flight.added(scale, np.array([rotor, _SHARE])) / _SHARE for rotor in rotors]
    return np.stack([*gains, flight.added(delay, np.array([_LATE_S, 0.0])) / _LATE_S], axis=2)


def _deviations(motors: Motors | None, vehicle: Vehicle, flights: int) -> Array:
    """Standard deviations (K,) of these of one of several flights; what flights share is in each of them."""
    rotors = vehicle.rotor_count
    if motors is None:
        return np.zeros(rotors + 2)
    gain, own, lag_s = max(motors.gain, GAIN_LEAST.value), np.zeros(rotors), LAG_ERROR.value * motors.lag_s
    # As many deviations as flights: their mean then deviates by as much as what they share.
    shared = np.sqrt(flights)
    own = np.array(motors.error) if motors.error else np.full(rotors, shared * ROTORS_DIFFER.value)
    if not _scale_is_known(motors, vehicle):
        gain = np.hypot(gain, shared * _UNKNOWN_SCALE)
    return np.concatenate(([gain], own, [lag_s]))


def _scale_is_known(motors: Motors, vehicle: Vehicle) -> bool:
    return bool(motors.error) or motors == vehicle.motors


def traces(regression: Regression, noise: Noise) -> dict[str, float]:
    """Evidence [nat] of each effect of the size that is looked for, of its best candidate, in some noise."""
    found: dict[str, float] = {}
    for candidate, block in zip(regression.candidates, regression.blocks, strict=True):
        squares = np.einsum("fkk->k", noise.gram(block.columns, block.columns))
        found[candidate.name] = max(
            found.get(candidate.name, 0.0), 0.5 * float(squares[: len(block.at)].sum())
        )
    return found


def commanded_speeds(found: Found) -> CommandedSpeeds | None:
    """What is to be said of rotor speeds from commands after a search; None where all are measured."""
    regression = found.regression
    by_commands = {own.flight.name: own.flight.motors for own in regression.flights if own.flight.motors}
    if not by_commands:
        return None
    vehicle, measured = regression.flights[0].simulation.vehicle, replace(regression.noise, own=())
    with_measured, with_these = traces(regression, measured), traces(regression, regression.noise)
    alike = []
    for index in found.chosen:
        share, gain = _as_gain(regression, regression.added((index,), found.fit))
        if share >= ALIKE.value:
            alike.append((regression.candidates[index].name, gain))
    return CommandedSpeeds(
        flights=tuple(by_commands),
        gain=max(GAIN_LEAST.value, *(own.gain for own in by_commands.values())),
        rotors=max(max(own.error, default=ROTORS_DIFFER.value) for own in by_commands.values()),
        scale_known=all(_scale_is_known(own, vehicle) for own in by_commands.values()),
        hidden=tuple(
            name for name, own in with_these.items() if own < (1.0 - HIDDEN.value) * with_measured[name]
        ),
        alike=tuple(alike),
    )


def _as_gain(regression: Regression, added: Sequence[Part]) -> tuple[float, tuple[float, ...]]:
    """Share of the squares that an effect adds which gains of rotor speeds explain, and these (R)."""
    (speeds,) = errors_of_speeds(regression.flights)
    weights, rotors = 1.0 / np.sqrt(regression.noise.variance), slice(1, speeds.columns.width - 1)
    of_effect, told, gains = 0.0, 0.0, []
    for place, (rows, band) in enumerate(speeds.columns.spectra):
        weighed = weights[place][:, band]
        effect = (weighed * rows_of(added, place)).ravel()
        columns = (weighed[:, :, np.newaxis] * rows[:, :, rotors]).reshape(len(effect), -1)
        fitted = np.linalg.lstsq(columns, effect, rcond=None)[0]
        of_effect += float(effect @ effect)
        told += float(np.sum(np.square(columns @ fitted)))
        gains.append(fitted)
    return told / of_effect if of_effect else 0.0, tuple(np.mean(gains, axis=0).tolist())
