# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Why a sample cannot be judged or trusted: evidence of BAD_DATA, one bit per fault, O(1) per sample.

Some faults make a sample unusable: it is not finite, not plausible, or its stamp does not advance. The others
are reported of samples that are used: a sensor that repeats its reading for longer than noise allows, a rotor
whose speed contradicts the other three.

The yaw moment of four rotors in flight is small, so the squared speeds of those turning one way and of those
turning the other have about the same sum. A rotor reads half its speed where these sums differ, its own speed
is far below that of the others, and doubling its reading makes the sums agree.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, TypeAlias

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.flight import MAX_GAP_NS, NO_STAMP
from quadpi_core.frames import Array
from quadpi_core.records import Records, Vector3, record_dtype
from quadpi_core.sample_limits import (
    RATE_MAX_RAD_S,
    SPECIFIC_FORCE_MAX_M_S2,
    unit_attitude,
    usable_airspeed,
    usable_rotor_speeds,
    within,
)
from quadpi_core.screening.rotors_in_flight import OTHERS_STEPS, STUCK_RAD_S, STUCK_S
from quadpi_core.signals.chain import ATTITUDE, RATES, ROTOR_SPEEDS, SPECIFIC_FORCE, VELOCITY, WIND
from quadpi_core.thresholds import Threshold
from quadpi_core.vehicle import ROTORS, Vehicle

NOT_FINITE, NOT_PLAUSIBLE = 1 << 0, 1 << 1
STAMP_REPEATED, STAMP_BACKWARD, GAP = 1 << 2, 1 << 3, 1 << 4
STATE_MISSING, ROTORS_MISSING = 1 << 5, 1 << 6
GYRO_FROZEN, ACCELEROMETER_FROZEN = 1 << 7, 1 << 8
# One bit per rotor from each of these on.
ROTOR_FROZEN, ROTOR_HALF, ROTOR_JUMPS, ROTOR_DIFFERS = 1 << 9, 1 << 13, 1 << 17, 1 << 21
# The IMU's rate: it is not the one given, is not known (any more), is too low for the model's low-pass.
RATE_DIFFERS, RATE_UNKNOWN, RATE_LOW = 1 << 25, 1 << 26, 1 << 27
# One bit per rotor from this on: it reads 0 while others turn. Whether it has stopped or its telemetry
# fails, `rotor_thrust` decides.
ROTOR_ZERO = 1 << 28
ROTOR_FAULTS = RATE_DIFFERS - ROTOR_FROZEN | ROTOR_ZERO * 15
# Faults that mean nothing on the ground, where motors start one after the other and sensors may rest.
IN_FLIGHT_ONLY = RATE_DIFFERS - GYRO_FROZEN | ROTOR_FAULTS

# An inertial sensor repeats a sample bit for bit once in a while, not for this long [s] and this many
# samples.
_FROZEN_S, _FROZEN_SAMPLES = 0.03, 8
# The estimator moves its biases at every correction, so the readings of a frozen sensor less its bias still
# creep, by at most this much per sample [rad/s, m/s²].
_CREEP_RAD_S, _CREEP_M_S2 = 0.01, 0.05
# Speed controllers may repeat a reading until the next one comes, for at most so long [s].
_ROTOR_FROZEN_S = STUCK_S.value
FINE_STEP = Threshold(
    "resolution in which a rotor that turns changes its reading within half a second",
    1e-3,
    "of the speed",
    "in half a second of flight a rotor's speed changes by 0.6 % or more, that of one of four by 1.1 %",
    "24 real flights of five vehicles, in steps of 0 to 0.05 %",
)
_FINE_STEP, _OTHERS_STEPS, _SAME_RAD_S = FINE_STEP.value, OTHERS_STEPS.value, STUCK_RAD_S.value
# A reading that is held follows another within so long [s]: from their difference the resolution is known.
_FOLLOWS_S = 0.1
# Time constant of the means of the squared rotor speeds [s].
_MEAN_S = 0.3
# Largest change of a rotor's speed between samples, as a share of it: a constant for the noise, and a rate;
# a motor changes its speed by less than 3 % in a millisecond.
_JUMP, _JUMP_PER_S = 0.15, 20.0
# Difference between the squares of the two directions of rotation over their sum: clearly unbalanced, and
# balanced again with one reading doubled. Such a rotor reads below this share of the others' speed.
_UNBALANCED, _BALANCED, _HALF_BELOW = 0.15, 0.07, 0.6
# A speed below or above these shares of the others' differs from them.
_DIFFERS_BELOW, _DIFFERS_ABOVE = 0.4, 1.9
# A rotor below this share of the second fastest reads 0: rotors idle in flight at a quarter of their speed in
# hover (indiflight), and a reading between two samples, one of which is 0, is none.
_ZERO_BELOW = 0.1
# Slower rotors [rad/s] are at rest or starting: nothing is said of them.
_TURNING_RAD_S = 50.0

PerRotor: TypeAlias = Annotated[Array, ROTORS]


class Quality:
    """What the checks know of the vehicle, and remember of the samples."""

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
    rotors_lowest: Annotated[Array, ROTORS, ROTORS]
    rotors_highest: Annotated[Array, ROTORS, ROTORS]
    # The last reading that a rotor held, for how long it has not, and the smallest step between two [rad/s].
    rotor_held: PerRotor
    rotor_moves_s: PerRotor
    rotor_step: float
    mean_squares: PerRotor  # of the rotor speeds, over _MEAN_S
    averaged_s: float  # since the means began


def quality(vehicle: Vehicle, rate_hz: float) -> Records:
    """The :class:`Quality` (1,) of a vehicle, and the sample rate of its IMU, before the first sample."""
    memory = np.zeros(1, record_dtype(Quality))
    memory["rotor_speed_max"] = vehicle.rotor_speed_spike_rad_s
    memory["rotor_spins"] = vehicle.rotor_spins
    memory["frozen_after_s"] = frozen_s(rate_hz)
    memory["rotor_step"] = np.inf
    memory["previous_ns"] = memory["followed_ns"] = NO_STAMP
    return memory


def frozen_s(rate_hz: float) -> float:
    """For how long an inertial sensor of that rate may repeat a reading [s]."""
    return max(_FROZEN_S, _FROZEN_SAMPLES / rate_hz)


def fault_words(faults: int) -> Iterator[str]:
    """What the bits of faults mean, in plain words."""
    words = {
        NOT_FINITE: "sample not finite",
        NOT_PLAUSIBLE: "sample not plausible",
        STAMP_REPEATED: "stamp repeated",
        STAMP_BACKWARD: "stamp runs backward",
        GAP: "gap in the samples",
        STATE_MISSING: "state missing",
        ROTORS_MISSING: "rotor speeds missing",
        GYRO_FROZEN: "gyro frozen",
        ACCELEROMETER_FROZEN: "accelerometer frozen",
        RATE_DIFFERS: "imu rate is not imu_rate_hz",
        RATE_UNKNOWN: "imu rate not known yet",
        RATE_LOW: "imu rate too low for the model",
    }
    if faults & STATE_MISSING and faults & ROTORS_MISSING:
        yield "state or rotor speeds missing"
        faults &= ~(STATE_MISSING | ROTORS_MISSING)
    yield from (text for bit, text in words.items() if faults & bit)
    for first, text in (
        (ROTOR_FROZEN, "frozen"),
        (ROTOR_HALF, "reads half"),
        (ROTOR_JUMPS, "jumps"),
        (ROTOR_DIFFERS, "differs from the others"),
        (ROTOR_ZERO, "reads 0"),
    ):
        for rotor in range(ROTORS):
            if faults & first << rotor:
                yield f"rotor {rotor + 1} {text}"


@njit(cache=True)
def judge(memory: Quality, time_ns: int, sample: Array) -> tuple[int, bool, bool]:
    """Judge one sample (20,), in the channels of :mod:`quadpi_core.signals.chain`.

    Returns:
        The bits of what is wrong; whether the sample can be used; whether it comes after a gap or a jump of
        the clock, so that nothing may be filtered across.
    """
    step_ns = time_ns - memory.previous_ns
    first = memory.previous_ns == NO_STAMP
    jump = not first and abs(step_ns) > MAX_GAP_NS
    faults = _stamp_faults(first, jump, step_ns)
    missing = _missing_channels(sample)
    faults |= missing
    plausible = False
    if np.all(np.isfinite(sample)):
        plausible = _plausible(sample, memory.rotor_speed_max)
        if not plausible:
            faults |= NOT_PLAUSIBLE
    elif missing == 0 or not np.all(np.isfinite(sample[SPECIFIC_FORCE])):
        faults |= NOT_FINITE
    usable = plausible and (first or jump or step_ns > 0)
    if usable:
        memory.previous_ns = memory.followed_ns = time_ns
        restarts = first or jump
        faults |= _sensor_faults(memory, sample, 0.0 if restarts else step_ns * 1e-9, restarts)
    return faults, usable, jump


@njit(cache=True)
def with_last_readings(memory: Quality, time_ns: int, sample: Array) -> tuple[int, Array]:
    """A sample (20,) that is not usable, with the last readings of the rotors that give none.

    Returns:
        A bit per such rotor, 0 if none gives a reading, the sample is not usable for other reasons too or
        comes after a gap; the sample.
    """
    absent = 0
    filled = sample.copy()
    for k in range(ROTORS):
        if not np.isfinite(filled[ROTOR_SPEEDS][k]):
            absent |= 1 << k
            filled[ROTOR_SPEEDS][k] = memory.rotor_speeds[k]
    continues = memory.followed_ns != NO_STAMP and 0 < time_ns - memory.followed_ns <= MAX_GAP_NS
    if absent in (0, (1 << ROTORS) - 1) or not continues or not np.all(np.isfinite(filled)):
        return 0, filled
    if not _plausible(filled, memory.rotor_speed_max):
        return 0, filled
    memory.followed_ns = time_ns
    return absent, filled


@njit(cache=True)
def _stamp_faults(first: bool, jump: bool, step_ns: int) -> int:
    """Bits of what is wrong with a stamp, by the step from the last usable one."""
    if first:
        return 0
    if step_ns == 0:
        return STAMP_REPEATED
    if step_ns < 0:
        return STAMP_BACKWARD
    return GAP if jump else 0


@njit(cache=True)
def _missing_channels(sample: Array) -> int:
    """Bits of the topics without which the sample was given up: all their channels are NaN."""
    missing = 0
    if np.all(np.isnan(sample[VELOCITY])) and np.all(np.isnan(sample[ATTITUDE])):
        missing |= STATE_MISSING
    if np.all(np.isnan(sample[ROTOR_SPEEDS])):
        missing |= ROTORS_MISSING
    return missing


@njit(cache=True)
def _plausible(sample: Array, rotor_speed_max: float) -> bool:
    """Whether a finite sample (20,) can be that of a flight."""
    return (
        unit_attitude(sample[ATTITUDE])
        and usable_airspeed(sample[VELOCITY])
        and usable_airspeed(sample[WIND])
        and within(sample[RATES], RATE_MAX_RAD_S)
        and within(sample[SPECIFIC_FORCE], SPECIFIC_FORCE_MAX_M_S2)
        and usable_rotor_speeds(sample[ROTOR_SPEEDS], rotor_speed_max)
    )


@njit(cache=True)
def _sensor_faults(memory: Quality, sample: Array, step_s: float, restarts: bool) -> int:
    """Bits of the faults of sensors in a usable sample, which is remembered."""
    faults = _rotor_faults(memory, sample[ROTOR_SPEEDS], step_s, restarts)
    rates, force = sample[RATES], sample[SPECIFIC_FORCE]
    memory.rates_still_s = _still_s(rates, memory.rates, memory.rates_still_s, _CREEP_RAD_S, step_s)
    memory.specific_force_still_s = _still_s(
        force, memory.specific_force, memory.specific_force_still_s, _CREEP_M_S2, step_s
    )
    memory.rates[:], memory.specific_force[:] = rates, force
    if memory.rates_still_s >= memory.frozen_after_s:
        faults |= GYRO_FROZEN
    if memory.specific_force_still_s >= memory.frozen_after_s:
        faults |= ACCELEROMETER_FROZEN
    return faults


@njit(cache=True)
def _still_s(reading: Array, last: Array, still_s: float, creep: float, step_s: float) -> float:
    """For how long an inertial sensor has repeated its reading [s], after one more reading."""
    equal, small = True, True
    for k in range(reading.size):
        change = abs(reading[k] - last[k])
        equal &= change == 0.0
        small &= change <= creep
    if equal:
        return still_s + step_s
    return max(0.0, still_s - 0.5 * step_s) if small else 0.0


@njit(cache=True)
def _rotor_faults(memory: Quality, speeds: Array, step_s: float, restarts: bool) -> int:
    """Bits of the faults of the rotors' readings (4,), which are remembered."""
    faults = 0
    share = 1.0 if restarts else step_s / (_MEAN_S + step_s)
    total, balance = 0.0, 0.0
    zero = _ZERO_BELOW * second_fastest(speeds)
    others_turn = zero > _ZERO_BELOW * _TURNING_RAD_S
    for k in range(ROTORS):
        before = memory.rotor_speeds[k]
        if others_turn and speeds[k] < zero:
            faults |= ROTOR_ZERO << k
        _take_reading(memory, k, speeds, step_s)
        if memory.rotor_still_s[k] >= _ROTOR_FROZEN_S and _would_change(memory, k):
            faults |= ROTOR_FROZEN << k
        larger = max(speeds[k], before)
        most = (_JUMP + _JUMP_PER_S * step_s) * larger
        jumps = not restarts and larger > _TURNING_RAD_S and abs(speeds[k] - before) > most
        if jumps and not faults & ROTOR_ZERO << k:
            faults |= ROTOR_JUMPS << k
        memory.rotor_speeds[k] = speeds[k]
        memory.mean_squares[k] += share * (speeds[k] * speeds[k] - memory.mean_squares[k])
        total += memory.mean_squares[k]
        balance += memory.rotor_spins[k] * memory.mean_squares[k]
    memory.averaged_s = 0.0 if restarts else memory.averaged_s + step_s
    if memory.averaged_s < 2.0 * _MEAN_S or total < 4.0 * _TURNING_RAD_S**2:
        return faults
    for k in range(ROTORS):
        if faults & ROTOR_ZERO << k:
            continue
        square = memory.mean_squares[k]
        relative = np.sqrt((ROTORS - 1) * square / max(total - square, 1.0))
        doubled = abs(balance + 3.0 * memory.rotor_spins[k] * square) / (total + 3.0 * square)
        if abs(balance) > _UNBALANCED * total and doubled < _BALANCED and relative < _HALF_BELOW:
            faults |= ROTOR_HALF << k
        elif relative < _DIFFERS_BELOW or relative > _DIFFERS_ABOVE:
            faults |= ROTOR_DIFFERS << k
    return faults


@njit(cache=True)
def _take_reading(memory: Quality, rotor: int, speeds: Array, step_s: float) -> None:
    """Note whether a rotor's reading is the one before, and the resolution that its changes tell."""
    speed, before = speeds[rotor], memory.rotor_speeds[rotor]
    lowest, highest = memory.rotors_lowest[rotor], memory.rotors_highest[rotor]
    if min(speed, before) <= _TURNING_RAD_S or speed != before:
        memory.rotor_still_s[rotor] = 0.0
        memory.rotor_moves_s[rotor] += step_s
        lowest[:], highest[:] = speeds, speeds
        return
    step = abs(speed - memory.rotor_held[rotor])
    if memory.rotor_moves_s[rotor] <= _FOLLOWS_S and step > _SAME_RAD_S:
        memory.rotor_step = min(memory.rotor_step, step)
    memory.rotor_held[rotor], memory.rotor_moves_s[rotor] = speed, 0.0
    memory.rotor_still_s[rotor] += step_s
    for k in range(ROTORS):
        lowest[k], highest[k] = min(lowest[k], speeds[k]), max(highest[k], speeds[k])


@njit(cache=True)
def _would_change(memory: Quality, rotor: int) -> bool:
    """Whether a rotor that turned would have changed its reading meanwhile, in the resolution of the stream.

    It would in a fine one, and wherever the others change by several steps.
    """
    if memory.rotor_step == np.inf or memory.rotor_step < _FINE_STEP * memory.rotor_speeds[rotor]:
        return True
    total, least, most = 0.0, np.inf, 0.0
    for k in range(ROTORS):
        if k != rotor:
            extent = memory.rotors_highest[rotor, k] - memory.rotors_lowest[rotor, k]
            total, least, most = total + extent, min(least, extent), max(most, extent)
    return bool(total - least - most >= _OTHERS_STEPS * memory.rotor_step)


@njit(cache=True)
def second_fastest(speeds: Array) -> float:
    """The second largest of the rotors' speeds (4,)."""
    first, second = 0.0, 0.0
    for rotor in range(ROTORS):
        if speeds[rotor] > first:
            first, second = speeds[rotor], first
        elif speeds[rotor] > second:
            second = speeds[rotor]
    return second
