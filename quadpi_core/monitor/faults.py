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
from quadpi_core.flight import MAX_GAP_NS, RATE_MAX_RAD_S, SPECIFIC_FORCE_MAX_M_S2
from quadpi_core.frames import Array
from quadpi_core.vehicle import ROTORS, Vehicle

# Beyond these a sample is a broken sensor or a wrong unit, not flight.
AIRSPEED_MAX_M_S = 100.0
QUATERNION_NORM_TOLERANCE = 0.1

NOT_FINITE, NOT_PLAUSIBLE = 1 << 0, 1 << 1
STAMP_REPEATED, STAMP_BACKWARD, GAP = 1 << 2, 1 << 3, 1 << 4
STATE_MISSING, ROTORS_MISSING = 1 << 5, 1 << 6
GYRO_FROZEN, ACCELEROMETER_FROZEN = 1 << 7, 1 << 8
# One bit per rotor from each of these on.
ROTOR_FROZEN, ROTOR_HALF, ROTOR_JUMPS, ROTOR_DIFFERS = 1 << 9, 1 << 13, 1 << 17, 1 << 21
# On the ground motors start one after the other and sensors may rest: there these mean nothing.
IN_FLIGHT_ONLY = (1 << 25) - GYRO_FROZEN

_NO_STAMP = np.iinfo(np.int64).min
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


class Judgement(NamedTuple):
    """What is known of K samples before they are filtered.

    Attributes:
        usable: (K,) False for a sample that cannot be judged.
        restart: (K,) True where the low-pass starts anew.
        faults: (K,) bits of this module.
        used, restarts: how many are usable, and how many of these restart.
    """

    usable: npt.NDArray[np.bool_]
    restart: npt.NDArray[np.bool_]
    faults: npt.NDArray[np.int64]
    used: int
    restarts: int


class FaultFinder:
    """Judges the samples of one vehicle as they come.

    Args:
        vehicle: as in its vehicle file.
        rate_hz: sample rate of the IMU.
    """

    def __init__(self, vehicle: Vehicle, rate_hz: float) -> None:
        self._limits = np.array(
            [
                AIRSPEED_MAX_M_S,
                RATE_MAX_RAD_S,
                SPECIFIC_FORCE_MAX_M_S2,
                vehicle.rotor_speed_spike_rad_s,
                max(_FROZEN_S, _FROZEN_SAMPLES / rate_hz),
            ]
        )
        self._spins = np.asarray(vehicle.rotor_spins, dtype=float)
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._previous_ns = np.array([_NO_STAMP])
        self._state = np.zeros(STATE_SIZE)

    def step(
        self,
        time_ns: npt.NDArray[np.int64],
        velocity: Array,
        attitude: Array,
        rates: Array,
        specific_force: Array,
        rotor_speeds: Array,
        wind: Array,
    ) -> Judgement:
        """Judge K samples; arguments as of :meth:`quadpi_core.monitor.Monitor.step`."""
        usable = np.empty(len(time_ns), dtype=np.bool_)
        restart = np.empty(len(time_ns), dtype=np.bool_)
        faults = np.empty(len(time_ns), dtype=np.int64)
        used, restarts = _judge_kernel(
            time_ns,
            velocity,
            attitude,
            rates,
            specific_force,
            rotor_speeds,
            wind,
            self._limits,
            self._spins,
            self._previous_ns,
            self._state,
            usable,
            restart,
            faults,
        )
        return Judgement(usable, restart, faults, used, restarts)


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
def _count_missing(values: Any) -> int:
    missing = 0
    for value in values:
        missing += np.isnan(value)
    return missing


@njit(cache=True)
def _all_finite(values: Any) -> bool:
    finite = True
    for value in values:
        finite &= np.isfinite(value)
    return finite


@njit(cache=True)
def _within(values: Any, limit: float) -> bool:
    """Whether every magnitude is at most `limit`."""
    within = True
    for value in values:
        within &= abs(value) <= limit
    return within


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
def _judge_kernel(
    time_ns: Any,
    velocity: Any,
    attitude: Any,
    rates: Any,
    specific_force: Any,
    rotor_speeds: Any,
    wind: Any,
    limits: Any,
    spins: Any,
    previous_ns: Any,
    state: Any,
    usable: Any,
    restart: Any,
    faults: Any,
) -> tuple[int, int]:
    """Mark which samples can be used, where the low-pass must start anew and what is wrong; return counts."""
    used, restarts = 0, 0
    for i in range(time_ns.size):
        step_ns = time_ns[i] - previous_ns[0]
        first = previous_ns[0] == _NO_STAMP
        jump = not first and abs(step_ns) > MAX_GAP_NS
        found = 0
        if not first:
            if step_ns == 0:
                found |= STAMP_REPEATED
            elif step_ns < 0:
                found |= STAMP_BACKWARD
            elif jump:
                found |= GAP
        missing_state = _count_missing(velocity[i]) == 3 and _count_missing(attitude[i]) == 4
        missing_rotors = _count_missing(rotor_speeds[i]) == ROTORS
        if missing_state:
            found |= STATE_MISSING
        if missing_rotors:
            found |= ROTORS_MISSING
        finite = (
            _all_finite(velocity[i])
            and _all_finite(attitude[i])
            and _all_finite(rates[i])
            and _all_finite(specific_force[i])
            and _all_finite(rotor_speeds[i])
            and _all_finite(wind[i])
        )
        plausible = False
        if finite:
            norm_square = 0.0
            for component in attitude[i]:
                norm_square += component * component
            plausible = (
                abs(np.sqrt(norm_square) - 1.0) <= QUATERNION_NORM_TOLERANCE
                and _within(velocity[i], limits[0])
                and _within(wind[i], limits[0])
                and _within(rates[i], limits[1])
                and _within(specific_force[i], limits[2])
                and _within(rotor_speeds[i], limits[3])
                and rotor_speeds[i].min() >= 0.0
            )
            if not plausible:
                found |= NOT_PLAUSIBLE
        elif not missing_state and not missing_rotors:
            found |= NOT_FINITE
        usable[i] = plausible and (first or jump or step_ns > 0)
        restart[i] = jump
        if usable[i]:
            used += 1
            restarts += jump
            previous_ns[0] = time_ns[i]
            anew = first or jump
            step_s = 0.0 if anew else step_ns * 1e-9
            gyro_s = _still(rates[i], state, _GYRO, _CREEP_RAD_S, _STILL, step_s)
            force_s = _still(specific_force[i], state, _ACCELEROMETER, _CREEP_M_S2, _STILL + 1, step_s)
            if gyro_s >= limits[4]:
                found |= GYRO_FROZEN
            if force_s >= limits[4]:
                found |= ACCELEROMETER_FROZEN
            found |= _rotor_faults(rotor_speeds[i], spins, state, step_s, anew)
        faults[i] = found
    return used, restarts
