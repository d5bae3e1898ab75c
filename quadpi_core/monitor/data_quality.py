# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Why a sample cannot be judged, or not be trusted: evidence of BAD_DATA, one bit each, O(1) per sample.

Some of it makes a sample unusable (not finite, not plausible, a stamp that does not advance). The rest is
said of samples that are used: a sensor that stands still for longer than noise lets it, a rotor that reads
what the other three rule out.

The yaw moment of four rotors in flight is small, so the squares of the speeds of those turning one way and of
those turning the other have about the same sum. A rotor reads half where these sums differ, its own speed is
far below that of the others, and twice its reading makes the sums agree.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.compiled import njit
from quadpi_core.flight import MAX_GAP_NS, NO_STAMP
from quadpi_core.frames import Array
from quadpi_core.sample_limits import (
    RATE_MAX_RAD_S,
    SPECIFIC_FORCE_MAX_M_S2,
    unit_attitude,
    usable_airspeed,
    usable_rotor_speeds,
    within,
)
from quadpi_core.signals.chain import ATTITUDE, RATES, ROTOR_SPEEDS, SPECIFIC_FORCE, VELOCITY, WIND
from quadpi_core.vehicle import ROTORS, Vehicle

NOT_FINITE, NOT_PLAUSIBLE = 1 << 0, 1 << 1
STAMP_REPEATED, STAMP_BACKWARD, GAP = 1 << 2, 1 << 3, 1 << 4
STATE_MISSING, ROTORS_MISSING = 1 << 5, 1 << 6
GYRO_FROZEN, ACCELEROMETER_FROZEN = 1 << 7, 1 << 8
# One bit per rotor from each of these on.
ROTOR_FROZEN, ROTOR_HALF, ROTOR_JUMPS, ROTOR_DIFFERS = 1 << 9, 1 << 13, 1 << 17, 1 << 21
# Of the IMU's rate: another than was given, not known (any more), too low for the model's low-pass.
RATE_DIFFERS, RATE_UNKNOWN, RATE_LOW = 1 << 25, 1 << 26, 1 << 27
# On the ground motors start one after the other and sensors may rest: there these mean nothing.
IN_FLIGHT_ONLY = RATE_DIFFERS - GYRO_FROZEN

# An inertial sensor repeats a sample bit for bit once in a while, not for this long (and not this often).
_FROZEN_S, _FROZEN_SAMPLES = 0.03, 8
# The estimator moves its biases at every correction: a frozen sensor less a bias creeps by this much at most.
_CREEP_RAD_S, _CREEP_M_S2 = 0.01, 0.05
# Speed controllers may repeat a reading until the next one.
_ROTOR_FROZEN_S = 0.5
# Of the means of the squared rotor speeds.
_MEAN_S = 0.3
# A motor changes its speed by less than 3 % in a millisecond.
_JUMP, _JUMP_PER_S = 0.15, 20.0
_UNBALANCED, _BALANCED, _HALF_BELOW = 0.15, 0.07, 0.6
_DIFFERS_BELOW, _DIFFERS_ABOVE = 0.4, 1.9
_TURNING_RAD_S = 50.0

# State: numbers.
_GYRO, _ACCELEROMETER, _SPEEDS, _SQUARES, _STILL, _ROTOR_STILL, _SETTLED = 0, 3, 6, 10, 14, 16, 20
STATE_SIZE = 21


class FaultMemory(NamedTuple):
    """What the search for faults knows of the vehicle, and remembers; arrays that the kernel changes.

    Attributes:
        limits: largest rotor speed [rad/s], and for how long an inertial sensor may stand still [s].
        spins: (4,) ±1 per rotor.
        previous_ns: (1,) stamp of the last usable sample.
        state: (21,) numbers.
    """

    limits: Array
    spins: Array
    previous_ns: npt.NDArray[np.int64]
    state: Array

    def retune(self, rate_hz: float) -> None:
        """Go on with samples of another rate."""
        self.limits[1] = frozen_s(rate_hz)

    @classmethod
    def empty(cls, vehicle: Vehicle, rate_hz: float) -> FaultMemory:
        """The memory for a vehicle, and the sample rate of its IMU, that has seen nothing."""
        return cls(
            np.array([vehicle.rotor_speed_spike_rad_s, frozen_s(rate_hz)]),
            np.asarray(vehicle.rotor_spins, dtype=float),
            np.array([NO_STAMP]),
            np.zeros(STATE_SIZE),
        )

    def forget(self) -> None:
        """Forget the past."""
        self.previous_ns[0] = NO_STAMP
        self.state[:] = 0.0


def frozen_s(rate_hz: float) -> float:
    """For how long an inertial sensor of that rate may stand still."""
    return max(_FROZEN_S, _FROZEN_SAMPLES / rate_hz)


def fault_words(faults: int) -> Iterator[str]:
    """What the bits mean, in plain words."""
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
    ):
        for rotor in range(ROTORS):
            if faults & first << rotor:
                yield f"rotor {rotor + 1} {text}"


@njit(cache=True)
def _all_missing(values: Any) -> bool:
    return bool(np.all(np.isnan(values)))


@njit(cache=True)
def _plausible(sample: Any, rotor_speed_max: float) -> bool:
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
def _still(sample: Any, state: Any, start: int, creep: float, timer: int, step_s: float) -> float:
    """Time for which a sensor stood still; also takes the sample."""
    equal, small = True, True
    for k in range(sample.size):
        change = abs(sample[k] - state[start + k])
        equal &= change == 0.0
        small &= change <= creep
        state[start + k] = sample[k]
    if equal:
        state[timer] += step_s
    elif small:
        state[timer] = max(0.0, state[timer] - 0.5 * step_s)
    else:
        state[timer] = 0.0
    return float(state[timer])


@njit(cache=True)
def _rotor_faults(speeds: Any, spins: Any, state: Any, step_s: float, first: bool) -> int:
    """Bits of the rotors' faults after one more sample."""
    faults = 0
    share = 1.0 if first else step_s / (_MEAN_S + step_s)
    total, balance = 0.0, 0.0
    for k in range(ROTORS):
        before = state[_SPEEDS + k]
        turning = min(speeds[k], before) > _TURNING_RAD_S
        state[_ROTOR_STILL + k] = state[_ROTOR_STILL + k] + step_s if turning and speeds[k] == before else 0.0
        if state[_ROTOR_STILL + k] >= _ROTOR_FROZEN_S:
            faults |= ROTOR_FROZEN << k
        larger = max(speeds[k], before)
        most = (_JUMP + _JUMP_PER_S * step_s) * larger
        if not first and larger > _TURNING_RAD_S and abs(speeds[k] - before) > most:
            faults |= ROTOR_JUMPS << k
        state[_SPEEDS + k] = speeds[k]
        state[_SQUARES + k] += share * (speeds[k] * speeds[k] - state[_SQUARES + k])
        total += state[_SQUARES + k]
        balance += spins[k] * state[_SQUARES + k]
    state[_SETTLED] = 0.0 if first else state[_SETTLED] + step_s
    if state[_SETTLED] < 2.0 * _MEAN_S or total < 4.0 * _TURNING_RAD_S**2:
        return faults
    for k in range(ROTORS):
        square = state[_SQUARES + k]
        relative = np.sqrt((ROTORS - 1) * square / max(total - square, 1.0))
        doubled = abs(balance + 3.0 * spins[k] * square) / (total + 3.0 * square)
        if abs(balance) > _UNBALANCED * total and doubled < _BALANCED and relative < _HALF_BELOW:
            faults |= ROTOR_HALF << k
        elif relative < _DIFFERS_BELOW or relative > _DIFFERS_ABOVE:
            faults |= ROTOR_DIFFERS << k
    return faults


@njit(cache=True)
def judge(time_ns: int, sample: Any, memory: Any) -> tuple[int, bool, bool]:
    """Judge one sample (20,), in the channels of :mod:`quadpi_core.signals.chain`.

    Gives the bits of what is wrong, whether the sample can be used, and whether the low-pass starts anew.
    """
    limits, state = memory.limits, memory.state
    step_ns = time_ns - memory.previous_ns[0]
    first = memory.previous_ns[0] == NO_STAMP
    jump = not first and abs(step_ns) > MAX_GAP_NS
    found = 0
    if not first:
        if step_ns == 0:
            found |= STAMP_REPEATED
        elif step_ns < 0:
            found |= STAMP_BACKWARD
        elif jump:
            found |= GAP
    missing_state = _all_missing(sample[VELOCITY]) and _all_missing(sample[ATTITUDE])
    missing_rotors = _all_missing(sample[ROTOR_SPEEDS])
    if missing_state:
        found |= STATE_MISSING
    if missing_rotors:
        found |= ROTORS_MISSING
    plausible = False
    if np.all(np.isfinite(sample)):
        plausible = _plausible(sample, limits[0])
        if not plausible:
            found |= NOT_PLAUSIBLE
    elif not (missing_state or missing_rotors) or not np.all(np.isfinite(sample[SPECIFIC_FORCE])):
        found |= NOT_FINITE
    usable = plausible and (first or jump or step_ns > 0)
    if usable:
        memory.previous_ns[0] = time_ns
        anew = first or jump
        step_s = 0.0 if anew else step_ns * 1e-9
        gyro_s = _still(sample[RATES], state, _GYRO, _CREEP_RAD_S, _STILL, step_s)
        force_s = _still(sample[SPECIFIC_FORCE], state, _ACCELEROMETER, _CREEP_M_S2, _STILL + 1, step_s)
        if gyro_s >= limits[1]:
            found |= GYRO_FROZEN
        if force_s >= limits[1]:
            found |= ACCELEROMETER_FROZEN
        found |= _rotor_faults(sample[ROTOR_SPEEDS], memory.spins, state, step_s, anew)
    return found, usable, jump
