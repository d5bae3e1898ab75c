# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Evidence that a vehicle has changed, and of what, by the sizes of residuals; MISCOVERAGE counts misses.

Residuals are averaged over blocks of 0.1 s. On each axis what a sound flight leaves is a constant of the
flight that walks slowly, a process with memory and white noise; a Kalman filter foresees the next block, and
its error over its standard deviation has Student's distribution with 3 degrees of freedom
(`models.alarm_limits`). A change of known direction and size that begins at some block moves these errors by
known amounts: the product of the ratios of the densities is what a bet on it has won. Bets on all directions,
sizes and moments, weighted by a prior, are an e-process: under the null its supremum exceeds 1 / α with a
probability of α at most (Ville 1939; Ramdas et al. 2023, Game-theoretic statistics). Half of the prior is on
"since take-off", the rest on any later moment, with a sum that is finite, so that the rate is one of a flight
however long; none on take-off after an alarm of EXTRAPOLATION, or where it begins beyond its warning, as it
differs by itself. A moment is followed for 3 s, as later the walk has taken the change; what is won stays.
Within each half second a bet counts for e⁹ at most, on the first second of a flight for e⁸.

A load is weighed by Fz in bets of its own as well, within the inputs of the training flights and beyond,
against the likeliest offset of the model up to 6 % of the lift: each block by itself, so errors that last
must lie within it. A block whose moments are those of a rotor wins nothing. It raises the alarm at 400 to 1.
A rotor that gives less thrust changes the wrench by its own arm; one whose speed reads more than it is
changes the prediction by the arm that the model has for it. Both are said to give less than their speed says.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.models.alarm_limits import INPUT_CHANGES, ChangeLimits
from quadpi_core.records import ROTORS_MAX, PerRotor, Records, record_dtype
from quadpi_core.results import (
    CHANGED_CENTRE_FORWARD,
    CHANGED_CENTRE_RIGHT,
    CHANGED_FORCE_FORWARD,
    CHANGED_FORCE_RIGHT,
    CHANGED_MASS,
    CHANGED_ROTOR,
    UNCHANGED,
)
from quadpi_core.vehicle import Vehicle

BLOCK_S: float = compiled.BLOCK_S
BLOCK_FILLED_S: float = compiled.BLOCK_FILLED_S
_ONSETS, _DIRECTIONS, _SIZES = compiled.ONSETS, compiled.DIRECTIONS, compiled.SIZES
# Degrees of freedom of Student's distribution; the core has its power.
FREEDOM = 3
# Inputs (19,) beyond whose range samples are evidence all the same: those of a heavier one, however it flies.
OF_THRUST = np.array([bool(compiled.OF_THRUST & 1 << k) for k in range(len(INPUT_NAMES))])
# Half width of an interval of 95 %, in standard deviations.
_QUANTILE = 1.96

_PerDirection = Annotated[Array, _DIRECTIONS]
_Bets = Annotated[Array, _DIRECTIONS, _SIZES]


class AxisNoise:
    """What flights leave of a model on one axis, in N or Nm: see `models.alarm_limits.LeftOnAxis`."""

    mean: float
    between: float
    walk: float
    keep: float
    process: float
    white: float
    tail: float  # 3 times the squared scale
    loudest: float  # 0 for an axis that is not known


class Repeating:
    """What a model leaves in every flight where inputs change: see `models.alarm_limits.RepeatingPart`."""

    lower: Annotated[Array, len(INPUT_NAMES)]
    upper: Annotated[Array, len(INPUT_NAMES)]
    slopes: Annotated[Array, len(AXES), INPUT_CHANGES, len(INPUT_NAMES)]  # all 0 where no flights told


class SoundNoise:
    """What sound flights leave of a model, and the vehicle."""

    evidence: float  # of an alarm; 0 where no flights told what is sound
    weight: float  # N
    arm: float  # m, mean distance of the rotors
    lever: Annotated[Array, ROTORS_MAX, 3]  # change of Fz, Mx, My per newton that a rotor loses, by the model
    noise: Annotated[Records, AxisNoise, len(AXES)]
    repeating: Repeating


class ChangeBlock:
    """Mean of a block of samples."""

    number: int  # of blocks since the epoch
    residual: Annotated[Array, len(AXES)]  # measured − predicted
    lift: float  # N, predicted
    squares: PerRotor  # (rad/s)² of the rotors
    inputs: Annotated[Array, len(INPUT_NAMES)]


class Gathered:
    """A block and how far samples fill it."""

    sum: ChangeBlock
    filled_s: float
    samples: float


class BlockInputs:
    """Inputs of a block that has passed."""

    number: int
    inputs: Annotated[Array, len(INPUT_NAMES)]


class Parts:
    """Two parts of an axis: its constant and its process."""

    constant: float
    process: float


class AxisFilter:
    """Kalman filter of one axis, and how the last block looks to it."""

    mean: Parts
    gain: Parts
    of_constant: float  # covariance
    of_both: float
    of_process: float
    spread: float  # standard deviation of the block before it was seen
    surprise: float  # its error over `spread`
    loudness: float  # running mean of the squared surprises


class Onset:
    """A moment at which a change may have begun, with the evidence for each direction and size."""

    number: int  # of its block
    age: int  # in blocks
    prior: float
    moved: Annotated[Records, Parts, _DIRECTIONS, 3]
    wealth: _Bets  # at the end of the last half second
    gain: _Bets  # since then
    squares: _PerDirection
    products: _PerDirection


class ChangeFound:
    """What has changed, as it is published."""

    direction: int  # −1 for nothing
    since_ns: int
    from_start: int
    size: float  # in shares of what the direction changes
    deviation: float
    explained: float  # squared surprises that it explains


class Load:
    """What Fz says of a load, against a model that may be off."""

    blocks: int
    wealth: Annotated[Array, _SIZES]
    won: float  # less what was put on the bets
    since: int  # number of the block since which the bets have not been lost
    from_start: int
    squares: float
    products: float


class Change:
    """All that is remembered of a flight."""

    within: Gathered  # the inputs of the training flights
    beyond: Gathered
    load: Load
    blocks: int
    last: int
    before: Annotated[Records, BlockInputs, INPUT_CHANGES]  # the latest first
    filters: Annotated[Records, AxisFilter, len(AXES)]
    onsets: Annotated[Records, Onset, _ONSETS]
    settled: float  # evidence of moments that are no longer followed
    spent: float
    evidence: float
    score: float
    raised_number: int  # of the block after which the alarm was raised
    raised: bool
    loud: bool
    unlike_s: float
    found: ChangeFound


AXIS_NOISE, SOUND_NOISE = record_dtype(AxisNoise), record_dtype(SoundNoise)
CHANGE_BLOCK, CHANGE, CHANGE_FOUND = map(record_dtype, (ChangeBlock, Change, ChangeFound))


def sound_noise(limits: ChangeLimits | None, vehicle: Vehicle | None) -> Records:
    """The :class:`SoundNoise` (1,) of a vehicle; without limits or vehicle one that raises no evidence."""
    record = np.zeros(1, SOUND_NOISE)
    if limits is None or vehicle is None or len(limits.levers) != vehicle.rotor_count:
        return record
    record["evidence"] = limits.evidence
    record["weight"] = vehicle.mass_kg * vehicle.gravity_m_s2
    record["arm"] = mean_arm(vehicle)
    record["lever"][:, : vehicle.rotor_count] = limits.levers
    for axis, left in limits.axes.items():
        own = record["noise"][:, AXES.index(axis)]
        for name in ("mean", "between", "walk", "keep", "process", "white", "loudest"):
            own[name] = getattr(left, name)
        own["tail"] = FREEDOM * left.scale * left.scale
    if limits.repeating is not None:
        repeating = record["repeating"]
        for name in ("lower", "upper"):
            repeating[name] = [getattr(limits.repeating, name)[one] for one in INPUT_NAMES]
        for axis in limits.repeating.slopes:
            repeating["slopes"][:, AXES.index(axis)] = limits.repeating.of_axis(axis)
    return record


def mean_arm(vehicle: Vehicle) -> float:
    """Mean distance of the rotors from the centre, m."""
    return float(np.mean(np.sqrt(np.sum(np.square(vehicle.rotor_positions[:, :2]), axis=1))))


def nothing_found(rows: int) -> Records:
    """Records (M,) of :class:`ChangeFound` that say that nothing has changed."""
    found = np.zeros(rows, CHANGE_FOUND)
    found["direction"] = _NOTHING
    return found


def found_columns(found: Records, vehicle: Vehicle | None) -> dict[str, npt.NDArray[Any]]:
    """Columns (M,) of `results.AlarmRows` that say what has changed, from :class:`ChangeFound` (M,)."""
    direction = found["direction"]
    rotors = np.where(direction >= _LESS_1, (direction - _LESS_1) % ROTORS_MAX + 1, 0)
    kind = np.where(rotors > 0, CHANGED_ROTOR, _KINDS[np.minimum(direction, _LESS_1 - 1)])
    kind = np.where(direction == _NOTHING, UNCHANGED, kind)
    half = _QUANTILE * found["deviation"]
    low, size, high = (_in_units(kind, found["size"] + way * half, vehicle) for way in (-1.0, 0.0, 1.0))
    return {
        "changed": kind.astype(np.uint8),
        "changed_rotor": rotors.astype(np.uint8),
        "change_size": size,
        "change_lower": low,
        "change_upper": high,
        "change_since_ns": np.where(kind == UNCHANGED, 0, found["since_ns"]),
        "change_from_start": found["from_start"] > 0,
    }


_NOTHING, _LESS_1 = compiled.NOTHING, compiled.LESS_1
# What each direction before the rotors changes.
_KINDS = np.array(
    [CHANGED_MASS, CHANGED_FORCE_FORWARD, CHANGED_FORCE_RIGHT, CHANGED_CENTRE_FORWARD, CHANGED_CENTRE_RIGHT]
)


def _in_units(kind: Array, size: Array, vehicle: Vehicle | None) -> Array:
    """Sizes (M,) in kg, N, m, or as shares of a rotor's thrust."""
    if vehicle is None:
        return size
    lost = np.minimum(size, 0.99)
    force = size * vehicle.mass_kg * vehicle.gravity_m_s2
    distance = size * mean_arm(vehicle) / vehicle.rotor_count
    units = {
        # Force is measured as mass times specific force: with the mass m + d it is F m / (m + d).
        CHANGED_MASS: vehicle.mass_kg * lost / (1.0 - lost),
        **dict.fromkeys((CHANGED_FORCE_FORWARD, CHANGED_FORCE_RIGHT), force),
        **dict.fromkeys((CHANGED_CENTRE_FORWARD, CHANGED_CENTRE_RIGHT), distance),
    }
    return np.select([kind == one for one in units], list(units.values()), size)
