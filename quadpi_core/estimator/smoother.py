# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Fixed-interval smoother over the model of the EKF, for identification: every state from the whole flight.

The result is that of Rauch, Tung and Striebel; the form is Bierman's modification of the Bryson-Frazier
smoother, a recursion of the adjoint state that needs no inverse: G. J. Bierman, "Fixed interval smoothing
with discrete measurements" (1973). The forward pass repeats the corrections of the causal filter in the order
of their instants. It is kept at checkpoints only; between two of them it runs again when the backward pass
comes there, so that memory stays bounded.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.estimator import corrections
from quadpi_core.estimator.buffer import step_between
from quadpi_core.estimator.corrections import KIND, LAG, POSE, SCALAR, VALUE, VALUES, WIDENED
from quadpi_core.estimator.ekf import Ekf, Estimates, Segment
from quadpi_core.estimator.filter_memory import noise_of
from quadpi_core.estimator.propagate import (
    ERROR_STATES,
    TRANSITION,
    Row,
    back,
    copy,
    covariance_of,
    inject,
)
from quadpi_core.flight import Recording, Stamps
from quadpi_core.frames import Array

# IMU samples between checkpoints: a second of the usual rate.
CHUNK = 500
_WIDTH = Row.WIDTH
_STATE_BEGIN, _COVARIANCE_BEGIN = Row.NOMINAL.start, Row.COVARIANCE.start


class _Inputs(NamedTuple):
    """What the kernels run over: IMU samples used and corrections, both in the order of their instants."""

    imu_ns: Stamps
    samples: Array
    begin_ns: int
    journal_ns: Stamps
    journal: Array
    noise: Array


class _Tape(NamedTuple):
    """What a forward pass over a chunk leaves for the backward pass.

    Attributes:
        kinds: (T,) what each entry is: a step, a scalar measurement or an estimate at an IMU stamp.
        entries: (T, 34) transitions and scalars.
        rows: (CHUNK, 279) the estimates.
    """

    kinds: Stamps
    entries: Array
    rows: Array


_STEP, _SCALAR, _ESTIMATE = range(3)


def smooth(recording: Recording, ekf: Ekf) -> Estimates:
    """Smoothed estimates over a whole recording, at the IMU samples that a fresh EKF uses.

    Args:
        recording: with poses or velocities of motion capture.
        ekf: fresh; it runs over the recording first.

    Raises:
        SignalError: as :meth:`Ekf.run`.
    """
    imu = recording.imu
    samples = np.concatenate((imu.angular_velocity, imu.specific_force), axis=1)
    noise = np.array(ekf.noise, dtype=np.float64)
    parts = [_smooth(imu.time_ns, samples, segment, noise) for segment in ekf.segments(recording)]
    time_ns, nominal, variance = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return Estimates(time_ns, nominal, variance)


def _smooth(imu_ns: Stamps, samples: Array, segment: Segment, noise: Array) -> tuple[Stamps, Array, Array]:
    """Stamps, nominal states (M, 17) and variances (M, 16) of one segment."""
    used = segment.samples
    inputs = _Inputs(
        imu_ns=imu_ns[used],
        samples=np.ascontiguousarray(samples[used]),
        begin_ns=segment.initial.time_ns,
        journal_ns=segment.journal_ns,
        journal=segment.journal,
        noise=noise,
    )
    count = len(used)
    chunks = -(-count // CHUNK)
    checkpoints = np.empty((chunks, _WIDTH))
    applied = np.zeros(chunks + 1, dtype=np.int64)
    row = segment.initial.row.copy()
    no_tape = _tape(0, 0)
    for chunk in range(chunks):
        checkpoints[chunk] = row
        first, last = chunk * CHUNK, min((chunk + 1) * CHUNK, count)
        applied[chunk + 1], _ = _forward(inputs, row, first, last, int(applied[chunk]), no_tape)

    stamps = inputs.imu_ns
    nominal, variance = np.empty((count, _COVARIANCE_BEGIN - _STATE_BEGIN)), np.empty((count, ERROR_STATES))
    adjoint, information = np.zeros(ERROR_STATES), np.zeros((ERROR_STATES, ERROR_STATES))
    tape = _tape(CHUNK, int(np.diff(applied).max(initial=0)))
    for chunk in reversed(range(chunks)):
        first, last = chunk * CHUNK, min((chunk + 1) * CHUNK, count)
        _, entries = _forward(inputs, checkpoints[chunk], first, last, int(applied[chunk]), tape)
        _backward(
            tape, entries, adjoint, information, last - first, nominal[first:last], variance[first:last]
        )
    live = slice(segment.first, None)
    return stamps[live], nominal[live], variance[live]


def _tape(samples: int, corrected: int) -> _Tape:
    # A step and an estimate per sample; a step and up to six scalars per correction.
    entries = 2 * samples + 7 * corrected
    return _Tape(
        np.empty(entries, dtype=np.int64),
        np.empty((entries, max(SCALAR, TRANSITION))),
        np.empty((samples, _WIDTH)),
    )


@njit(cache=True)
def _forward(
    inputs: _Inputs, row: Array, first: int, last: int, applied: int, tape: _Tape
) -> tuple[int, int]:
    """Filter from just after IMU sample `first - 1` to IMU sample `last - 1`, in the order of instants.

    Args:
        inputs: of the segment.
        row: estimate at the beginning, renewed.
        first: IMU sample that comes next; the one before it is where `row` stands, but for the beginning.
        last: after the IMU samples to go through.
        applied: corrections applied so far.
        tape: to be filled, unless empty.

    Returns:
        Corrections applied, and entries on the tape.
    """
    noise = noise_of(inputs.noise)
    transition, scalars = np.empty(TRANSITION), np.empty((6, SCALAR))
    taped = len(tape.kinds) > 0
    at = 0
    for index in range(first, last):
        begin = max(index - 1, 0)
        begin_ns, end_ns = inputs.imu_ns[begin], inputs.imu_ns[index]
        now_ns = max(begin_ns, inputs.begin_ns) if index > 0 else end_ns
        while now_ns < end_ns or (applied < len(inputs.journal_ns) and inputs.journal_ns[applied] <= end_ns):
            to_ns = end_ns
            corrected = applied < len(inputs.journal_ns) and inputs.journal_ns[applied] <= end_ns
            if corrected:
                to_ns = max(inputs.journal_ns[applied], now_ns)
            if to_ns > now_ns:
                step_between(
                    row,
                    noise,
                    inputs.samples[begin],
                    inputs.samples[index],
                    now_ns - begin_ns,
                    to_ns - begin_ns,
                    end_ns - begin_ns,
                    transition,
                )
                now_ns = to_ns
                if taped:
                    tape.kinds[at] = _STEP
                    copy(transition, tape.entries[at], 0, TRANSITION)
                    at += 1
            if corrected:
                share = (to_ns - begin_ns) / max(end_ns - begin_ns, 1)
                for place in range(6):
                    before, after = inputs.samples[begin, place], inputs.samples[index, place]
                    row[place] = before + share * (after - before)
                entry = inputs.journal[applied]
                kind = int(entry[KIND])
                corrections.widen(row, entry[WIDENED : WIDENED + 4])
                corrections.fuse(row, noise, kind, entry[LAG], entry[VALUE : VALUE + VALUES], scalars)
                applied += 1
                if taped:
                    for scalar in range(6 if kind == POSE else 3):
                        tape.kinds[at] = _SCALAR
                        copy(scalars[scalar], tape.entries[at], 0, SCALAR)
                        at += 1
        if taped:
            copy(row, tape.rows[index - first], 0, _WIDTH)
            tape.kinds[at] = _ESTIMATE
            at += 1
    return applied, at


@njit(cache=True)
def _backward(
    tape: _Tape,
    entries: int,
    adjoint: Array,
    information: Array,
    count: int,
    nominal: Array,
    variance: Array,
) -> None:
    """Run the adjoint state (16,) and its information (16, 16) back over a tape; smooth its estimates."""
    error = np.empty(ERROR_STATES)
    index = count
    for at in range(entries - 1, -1, -1):
        entry = tape.entries[at]
        if tape.kinds[at] == _STEP:
            back(entry, adjoint)
            for column in range(ERROR_STATES):
                back(entry, information[column])
            for column in range(ERROR_STATES):
                for other in range(column):
                    upper, lower = information[other, column], information[column, other]
                    information[other, column], information[column, other] = lower, upper
            for column in range(ERROR_STATES):
                back(entry, information[column])
        elif tape.kinds[at] == _SCALAR:
            _backward_scalar(entry, adjoint, information)
        else:
            index -= 1
            row = tape.rows[index]
            covariance = covariance_of(row)
            for i in range(ERROR_STATES):
                total, spread = 0.0, 0.0
                for j in range(ERROR_STATES):
                    total -= covariance[i, j] * adjoint[j]
                    inner = 0.0
                    for k in range(ERROR_STATES):
                        inner += information[j, k] * covariance[k, i]
                    spread += covariance[i, j] * inner
                error[i] = total
                variance[index, i] = max(covariance[i, i] - spread, 0.0)
            inject(row, error)
            for place in range(nominal.shape[1]):
                nominal[index, place] = row[_STATE_BEGIN + place]


@njit(cache=True)
def _backward_scalar(entry: Array, adjoint: Array, information: Array) -> None:
    """λ ← (I − k hᵀ)ᵀ λ − h y/s and Λ ← (I − k hᵀ)ᵀ Λ (I − k hᵀ) + h hᵀ/s."""
    innovation, expected = entry[2 * ERROR_STATES], entry[2 * ERROR_STATES + 1]
    turned = np.empty(ERROR_STATES)
    along, inner = innovation / expected, 1.0 / expected
    for i in range(ERROR_STATES):
        total = 0.0
        for j in range(ERROR_STATES):
            total += information[i, j] * entry[ERROR_STATES + j]
        turned[i] = total
        along += entry[ERROR_STATES + i] * adjoint[i]
        inner += entry[ERROR_STATES + i] * total
    for i in range(ERROR_STATES):
        adjoint[i] -= entry[i] * along
        for j in range(ERROR_STATES):
            information[i, j] += entry[i] * entry[j] * inner - entry[i] * turned[j] - turned[i] * entry[j]
