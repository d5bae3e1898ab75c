# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Motors that work harder than in earlier flights, and motors that follow no more, by their commands.

Of a rotor that gives less thrust the command rises, and those of the others stay as they were. So does the
command of one near which the vehicle has become heavier: commands alone do not tell one from the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from quadpi_core.field.airborne import Flown
from quadpi_core.field.estimates import CONFIDENCE, Estimate, not_identified, within
from quadpi_core.field.field_log import FieldLog
from quadpi_core.field.motor_use import FULL_COMMAND, MotorUse
from quadpi_core.frames import Array
from quadpi_core.records import CONVENTION, Threshold
from quadpi_core.screening.rotors_in_flight import runs_of

SCATTER = Threshold(
    "standard deviation of a motor's command over that of the others, between good flights of a vehicle",
    0.02,
    "",
    "mountings of battery and payload, trim, wear",
    "good flights of imrc_brushless, imrc_brushed and indiflight of ../shared/data: 0.006 to 0.021",
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


def losses(use: MotorUse, references: Sequence[MotorUse]) -> tuple[RotorLoss, ...] | str:
    """Each rotor of a flight against earlier ones, or why it cannot be told.

    Args:
        use: of the flight.
        references: of good flights of the same vehicle.
    """
    shares = [_over_others(one) for one in (use, *references)]
    count = len(shares[0])
    known = [one for one in shares[1:] if len(one) == count]
    if not count or not known:
        return "the flight, or those before, have no commands"
    values, deviation, freedom = against(shares[0], np.array(known), SCATTER.value)
    alone, together = (
        stats.t.ppf(1.0 - 0.5 * (1.0 - CONFIDENCE.value) / rotors, freedom) * deviation
        for rotors in (1, count)
    )
    said = f"against {len(known)} flight{'s' * (len(known) > 1)}"
    found = []
    for value, width, widest in zip(values, alone, together, strict=True):
        ends = [float(end) for end in (value, value - width, value + width)]
        thrust = not_identified("", "its command is half of what it was, or less")
        if min(ends) > -_HALF:
            thrust = within([_thrust(*pair) for pair in zip(ends, (1, 0, 2), strict=True)], "", said)
        found.append(RotorLoss(within(ends, "", said), thrust, bool(value > widest)))
    return tuple(found)


def against(value: Array, before: Array, scatter: float) -> tuple[Array, Array, int]:
    """Difference from the mean of earlier flights, its standard deviation, and degrees of freedom.

    Args:
        value: of the flight.
        before: of the earlier ones, along the first axis.
        scatter: standard deviation between good flights.
    """
    count = len(before)
    freedom = WORTH_FLIGHTS + count - 1
    squares = np.sum((before - np.mean(before, axis=0)) ** 2, axis=0)
    pooled = (WORTH_FLIGHTS * scatter**2 + squares) / freedom
    return value - np.mean(before, axis=0), np.sqrt(pooled * (1.0 + 1.0 / count)), freedom


def _over_others(use: MotorUse) -> Array:
    """Command (R,) of each motor over the mean of the others, less 1; empty where they do not compare."""
    over_all = 1.0 + np.array([one.value for one in use.motors], dtype=np.float64)
    count = len(over_all)
    if count < 2 or not np.all(over_all < count):
        return over_all[:0]
    return over_all / ((count - over_all) / (count - 1)) - 1.0


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
