# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Motors that work harder than in earlier flights, and motors that follow no more, by their commands.

Of a rotor that gives less thrust the command rises, and those of the others stay as they were. So does the
command of one near which the vehicle has become heavier: commands alone do not tell one from the other. Wind
shifts work between the motors as well, by 4 to 14 % for 1 m/s² of specific force across the body: they are
compared without it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from quadpi_core.field.airborne import Averages, Flown, averages, pieces
from quadpi_core.field.estimates import CONFIDENCE, Estimate, not_identified, slope_of_pieces, within
from quadpi_core.field.field_log import FieldLog, Series
from quadpi_core.field.motor_use import FULL_COMMAND, PIECE_S
from quadpi_core.frames import Array
from quadpi_core.records import CONVENTION, Threshold
from quadpi_core.screening.rotors_in_flight import runs_of

SCATTER = Threshold(
    "standard deviation of a motor's command over that of the others, between good flights of a vehicle",
    0.02,
    "",
    "mountings of battery and payload, trim, wear",
    "good flights of imrc_brushless, imrc_brushed and indiflight of ../shared/data: 0.006 to 0.027",
)
# As many flights as that deviation is worth beside those given.
WORTH_FLIGHTS = 4
THRUST_EXPONENT = Threshold(
    "power of the command with which thrust goes: the least, the usual and the greatest",
    (1.0, 1.5, 2.0),
    "",
    "speed controllers are between linear in thrust and linear in speed",
    CONVENTION,
)
FROZEN_S = Threshold(
    "time for which a command between rest and full throttle stays the same, of a motor that follows no more",
    0.8,
    "s",
    "controllers in flight change each command at each step, but of a motor at the end of its range",
    "flights of ../shared/data but those of rrc_sitl",
)
# Of the command's range: what controllers step by in a second, and no more than logs and idling differ by.
_NEAR = 0.02
# Of a command that falls by so much a power law of thrust tells nothing: the motor hardly turns.
_HALF = 0.5
# Commands and forces are averaged over it, s: over less, noise of the accelerometer hides what wind does.
_STEP_S = 1.0


@dataclass(frozen=True)
class RotorLoss:
    """A rotor against earlier flights.

    Attributes:
        excess: its command over that of the others, by how much more than in those, as a share.
        thrust: share of thrust at the same command that it lacks, if that is the cause.
        beyond_chance: whether `excess` is above 0 at the confidence of all rotors together (Bonferroni).
    """

    excess: Estimate
    thrust: Estimate
    beyond_chance: bool


@dataclass(frozen=True)
class Sharing:
    """How the motors share the work without airspeed, in a flight and in earlier ones.

    Attributes:
        shares: (F, R) command over the mean of all, less 1; the flight first.
        error: (R,) standard error of what airspeed makes between the flight and the mean of the others.
    """

    shares: Array
    error: Array


def sharing(flights: Sequence[tuple[FieldLog, Flown]]) -> Sharing | str:
    """The sharing in flights of one vehicle, the one that is held against the others first, or why none is.

    Shares grow with the specific force across the body, along straight lines that all flights have in common.
    """
    blind = any(log.imu is None for log, _ in flights if log.commands is not None)
    own, *before = (_shares(*one, blind=blind) for one in flights)
    rotors = None if own is None else own.means[0].shape[1]
    known = [one for one in before if one is not None and one.means[0].shape[1] == rotors]
    if own is None or not known:
        return "the flight, or those before, have no commands"
    known = [own, *known]
    count, flight = len(known), np.repeat(range(len(known)), [len(one.time) for one in known])
    shares, across = (np.vstack([one.means[place] for one in known]) for place in range(2))
    piece = flight + count * np.concatenate([one.stretch for one in known])
    columns = np.hstack([np.eye(count)[flight], across])
    # The scatter between flights holds all else that they err by.
    means = np.linalg.lstsq(columns[:, :count], across, rcond=None)[0]
    wanted = np.concatenate([np.zeros(count), means[0] - means[1:].mean(axis=0)])
    told = [slope_of_pieces(columns, one, piece, wanted, "") for one in shares.T]
    halves = [np.inf if one.half_width is None else one.half_width for one, _ in told]
    usual = stats.norm.ppf(0.5 + 0.5 * CONFIDENCE.value)
    return Sharing(np.stack([fitted[:count] for _, fitted in told], axis=1), np.array(halves) / usual)


def _shares(log: FieldLog, flight: Flown, *, blind: bool) -> Averages | None:
    """Commands over the mean of all, less 1 (N, R), force across (N, 2), 0 if `blind`; None without any."""
    if log.commands is None or log.commands.values.shape[1] < 2:
        return None
    across = Series(log.commands.time, np.zeros((len(log.commands), 2)))
    if log.imu is not None and not blind:
        across = Series(log.imu.time, log.imu.values[:, 3:5])
    told = averages(pieces(flight.stretches, PIECE_S), _STEP_S, log.commands, across)
    commands, forces = told.means
    if not commands.any():
        return None
    return told._replace(means=((commands - commands.mean(axis=1, keepdims=True)) / commands.mean(), forces))


def losses(told: Sharing) -> tuple[RotorLoss, ...] | str:
    """Each rotor of a flight against earlier ones, or why it cannot be told."""
    rotors = told.shares.shape[1]
    if np.any(told.shares >= rotors - 1.0):
        return "one motor has all the command"
    if not np.isfinite(told.error).all():
        return "the flights are too short"
    # Over the others: a motor that works harder by itself leaves theirs as they were.
    over = (1.0 + told.shares) / ((rotors - 1.0 - told.shares) / (rotors - 1.0)) - 1.0
    values, deviation, freedom = against(
        over[0], over[1:], SCATTER.value, rotors / (rotors - 1.0) * told.error
    )
    tail = 0.5 * (1.0 - CONFIDENCE.value)
    alone, together = (stats.t.ppf(1.0 - tail / count, freedom) * deviation for count in (1, rotors))
    before = len(over) - 1
    said = f"against {before} flight{'s' * (before > 1)}"
    found = []
    for value, width, widest in zip(values, alone, together, strict=True):
        ends = [float(end) for end in (value, value - width, value + width)]
        thrust = not_identified("", "its command is half of what it was, or less")
        if min(ends) > -_HALF:
            thrust = within([_thrust(*pair) for pair in zip(ends, (1, 0, 2), strict=True)], "", said)
        found.append(RotorLoss(within(ends, "", said), thrust, bool(value > widest)))
    return tuple(found)


def against(
    value: Array, before: Array, scatter: float, error: Array | float = 0.0
) -> tuple[Array, Array, int]:
    """Difference from the mean of earlier flights, its standard deviation, and degrees of freedom.

    Args:
        value: of the flight.
        before: of the earlier ones, along the first axis.
        scatter: standard deviation between good flights.
        error: of the difference, beside that.
    """
    count = len(before)
    freedom = WORTH_FLIGHTS + count - 1
    squares = np.sum((before - np.mean(before, axis=0)) ** 2, axis=0)
    pooled = (WORTH_FLIGHTS * scatter**2 + squares) / freedom
    return value - np.mean(before, axis=0), np.sqrt(pooled * (1.0 + 1.0 / count) + error**2), freedom


def _thrust(excess: float, power: int) -> float:
    """Thrust that is lacking where so much more is commanded; the exponent is the worse at either end."""
    exponents = THRUST_EXPONENT.value
    exponent = exponents[power] if excess > 0.0 else exponents[2 - power]
    return float(1.0 - (1.0 + excess) ** -exponent)


def frozen_motors(log: FieldLog, flight: Flown) -> list[tuple[int, float]]:
    """Motors, from 1, whose command stays what it is in the air, each with the time [s] from which."""
    if log.commands is None or log.commands.values.shape[1] < 2:
        return []
    found: dict[int, float] = {}
    # Nor is a motor off at the most that the controller gives, as two motors reach it.
    tops = log.commands.values.max(axis=0)
    shared = np.sum(tops >= tops.max() - 1e-6) > 1
    most = min(FULL_COMMAND.value, float(tops.max()) if shared else 1.0)
    for one in flight.stretches:
        part = log.commands.during(one.begin, one.end)
        if len(part) < 2:
            continue
        for motor, own in enumerate(part.values.T):
            others = np.delete(part.values, motor, axis=1)
            # Motors at the least that controllers give stay there in hard turns; one that is off gets less.
            least = others[others > _NEAR].min(initial=1.0) + _NEAR
            stands = (np.diff(own) == 0.0) & (own[1:] > least) & (own[1:] < most)
            for begin, end in runs_of(stands):
                if part.time[end] - part.time[begin] < FROZEN_S.value:
                    continue
                # Saturation is reached slowly, and a disarmed vehicle has no motor that moves.
                goes_out = own[min(end + 1, len(own) - 1)] < _NEAR
                leaps = begin > 0 and abs(own[begin] - own[begin - 1]) > _NEAR
                if (leaps or goes_out) and np.median(np.ptp(others[begin:end], axis=0)) > _NEAR:
                    found.setdefault(motor + 1, float(part.time[begin]))
    return sorted(found.items(), key=lambda pair: pair[1])
