# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Why a sample cannot be judged or trusted: evidence of BAD_DATA, one bit per fault, O(1) per sample.

Some faults make a sample unusable: it is not finite, not plausible, or its stamp does not advance. The others
are reported of samples that are used: a sensor that repeats its reading for longer than noise allows, a rotor
whose speed contradicts the others.

The yaw moment of four rotors in flight is small, so the squared speeds of those turning one way and of those
turning the other have about the same sum. A rotor reads half its speed where these sums differ, its own speed
is far below that of the others, and doubling its reading makes the sums agree.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Annotated, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.flight import NO_STAMP
from quadpi_core.frames import Array
from quadpi_core.records import ROTORS_MAX, PerRotor, Records, Threshold, Vector3, record_dtype
from quadpi_core.vehicle import Vehicle

NOT_FINITE, NOT_PLAUSIBLE = compiled.NOT_FINITE, compiled.NOT_PLAUSIBLE
STAMP_REPEATED, STAMP_BACKWARD, GAP = compiled.STAMP_REPEATED, compiled.STAMP_BACKWARD, compiled.GAP
STATE_MISSING, ROTORS_MISSING = compiled.STATE_MISSING, compiled.ROTORS_MISSING
GYRO_FROZEN, ACCELEROMETER_FROZEN = compiled.GYRO_FROZEN, compiled.ACCELEROMETER_FROZEN
# One bit per rotor from each of these on, for rotors 1 to 4. Of `more_faults` the first has the bits of
# rotors 5 to 8 at the same places, the second those of rotors 9 to 12.
MoreFaults: TypeAlias = Annotated[npt.NDArray[np.int64], 2]
_OF_WORD = 4
ROTOR_FROZEN, ROTOR_HALF, ROTOR_JUMPS = compiled.ROTOR_FROZEN, compiled.ROTOR_HALF, compiled.ROTOR_JUMPS
ROTOR_DIFFERS, ROTOR_ZERO = compiled.ROTOR_DIFFERS, compiled.ROTOR_ZERO
# The IMU's rate.
RATE_DIFFERS, RATE_UNKNOWN, RATE_LOW = compiled.RATE_DIFFERS, compiled.RATE_UNKNOWN, compiled.RATE_LOW

# An inertial sensor repeats a sample bit for bit once in a while, not for this long [s] and this many
# samples.
_FROZEN_S, _FROZEN_SAMPLES = 0.03, 8
FINE_STEP = Threshold(
    "resolution in which a rotor that turns changes its reading within half a second",
    compiled.FINE_STEP,
    "of the speed",
    "in half a second of flight a rotor's speed changes by 0.6 % or more, that of one of four by 1.1 %",
    "24 real flights of five vehicles, in steps of 0 to 0.05 %",
)


class Quality:
    """What the checks know of the vehicle, and remember of the samples."""

    rotors: int
    rotor_speed_max: float  # rad/s, beyond which a reading is not plausible
    rotor_spins: PerRotor  # ±1
    frozen_after_s: float  # for which an inertial sensor may repeat a reading
    previous_ns: int  # stamp of the last usable sample; NO_STAMP before the first
    followed_ns: int  # of the last one that was usable but for readings of rotors
    # The last reading of each sensor, and for how long it has not changed.
    rates: Vector3
    rates_still_s: float
    specific_force: Vector3
    specific_force_still_s: float
    rotor_speeds: PerRotor
    rotor_still_s: PerRotor
    # Of all rotors, since each of them has not changed.
    rotors_lowest: Annotated[Array, ROTORS_MAX, ROTORS_MAX]
    rotors_highest: Annotated[Array, ROTORS_MAX, ROTORS_MAX]
    # The last reading that a rotor held, for how long it has not, and the smallest step between two [rad/s].
    rotor_held: PerRotor
    rotor_moves_s: PerRotor
    rotor_step: float
    mean_squares: PerRotor  # of the rotor speeds, over 0.3 s
    averaged_s: float  # since the means began


def quality(vehicle: Vehicle, rate_hz: float) -> Records:
    """The :class:`Quality` (1,) of a vehicle, and the sample rate of its IMU, before the first sample."""
    memory = np.zeros(1, record_dtype(Quality))
    memory["rotor_speed_max"] = vehicle.rotor_speed_spike_rad_s
    memory["rotors"] = vehicle.rotor_count
    memory["rotor_spins"][:, : vehicle.rotor_count] = vehicle.rotor_spins
    memory["frozen_after_s"] = frozen_s(rate_hz)
    memory["rotor_step"] = np.inf
    memory["previous_ns"] = memory["followed_ns"] = NO_STAMP
    return memory


def frozen_s(rate_hz: float) -> float:
    """For how long an inertial sensor of that rate may repeat a reading [s]."""
    return max(_FROZEN_S, _FROZEN_SAMPLES / rate_hz)


STATE_MISSING_WORDS, ROTORS_MISSING_WORDS = "state missing", "rotor speeds missing"
# Which of the two nobody can tell from a sample alone.
EITHER_MISSING_WORDS = "state or rotor speeds missing"


def fault_words(faults: int, more: Iterable[int] = ()) -> Iterator[str]:
    """What the bits of faults, and of those of more rotors than four, mean, in plain words."""
    words = {
        NOT_FINITE: "sample not finite",
        NOT_PLAUSIBLE: "sample not plausible",
        STAMP_REPEATED: "stamp repeated",
        STAMP_BACKWARD: "stamp runs backward",
        GAP: "gap in the samples",
        STATE_MISSING: STATE_MISSING_WORDS,
        ROTORS_MISSING: ROTORS_MISSING_WORDS,
        GYRO_FROZEN: "gyro frozen",
        ACCELEROMETER_FROZEN: "accelerometer frozen",
        RATE_DIFFERS: "imu rate is not imu_rate_hz",
        RATE_UNKNOWN: "imu rate not known yet",
        RATE_LOW: "imu rate too low for the model",
    }
    if faults & STATE_MISSING and faults & ROTORS_MISSING:
        yield EITHER_MISSING_WORDS
        faults &= ~(STATE_MISSING | ROTORS_MISSING)
    yield from (text for bit, text in words.items() if faults & bit)
    for first, text in (
        (ROTOR_FROZEN, "frozen"),
        (ROTOR_HALF, "reads half"),
        (ROTOR_JUMPS, "jumps"),
        (ROTOR_DIFFERS, "differs from the others"),
        (ROTOR_ZERO, "reads 0"),
    ):
        every = [bits & first << k for bits in (faults, *more) for k in range(_OF_WORD)]
        for rotor in np.flatnonzero(every).tolist():
            yield f"rotor {rotor + 1} {text}"
