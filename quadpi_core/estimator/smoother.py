# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Fixed-interval smoother over the model of the EKF, for identification: every state from the whole flight.

The result is that of Rauch, Tung and Striebel; the form is Bierman's modification of the Bryson-Frazier
smoother, a recursion of the adjoint state that needs no inverse: G. J. Bierman, "Fixed interval smoothing
with discrete measurements" (1973). The forward pass repeats the corrections of the causal filter in the order
of their instants. It is stored at checkpoints only; between two of them it runs again when the backward pass
gets there, so that memory stays bounded.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.estimator import corrections
from quadpi_core.estimator.filter_run import (
    ESTIMATED,
    EstimatedSample,
    Estimates,
    Segment,
    imu_records,
)
from quadpi_core.estimator.filter_state import (
    ERROR_STATES,
    ESTIMATE,
    POSE,
    SCALAR,
    TRANSITION,
    Correction,
    Estimate,
    ImuSample,
    Scalar,
    Transition,
    copy_nominal,
    interpolate_sample,
)
from quadpi_core.estimator.propagate import apply_transposed, inject, propagate_between
from quadpi_core.flight import ImuStream, Stamps
from quadpi_core.frames import Array
from quadpi_core.records import Records, record_dtype

# IMU samples between checkpoints: a second at the usual rate.
CHUNK = 500

# What happened in a forward pass: a step of the IMU, a scalar correction, an estimate at an IMU stamp.
STEP, SCALAR_CORRECTION, ESTIMATE_HERE = range(3)


class Inputs(NamedTuple):
    """What the forward pass runs over.

    Attributes:
        imu: (M,) each :class:`ImuSample` that the filter used.
        journal: (J,) each :class:`Correction`, by its instant.
        noise: (1,) the :class:`Noise`.
    """

    imu: Records
    journal: Records
    noise: Records


class Length:
    """How much of a tape is in use."""

    events: int
    steps: int
    scalars: int
    estimates: int


class Tape(NamedTuple):
    """A forward pass over a chunk, for the backward pass.

    Attributes:
        length: (1,) see :class:`Length`.
        events: (T,) what happened, in order; the details are in the next array's order of each kind.
        steps: each :class:`Transition`.
        scalars: each :class:`Scalar`.
        estimates: each :class:`Estimate`.
    """

    length: Records
    events: Stamps
    steps: Records
    scalars: Records
    estimates: Records

    @classmethod
    def empty(cls, samples: int, corrections: int) -> Tape:
        """Room for a pass over that many IMU samples and corrections; without any, a pass is not recorded."""
        return cls(
            np.zeros(1, record_dtype(Length)),
            np.empty(2 * samples + 7 * corrections, dtype=np.int64),
            # With room for one more step and correction: a pass works there.
            np.empty(samples + corrections + 1, TRANSITION),
            np.empty(6 * corrections + 6, SCALAR),
            np.empty(samples, ESTIMATE),
        )


def smooth(imu_stream: ImuStream, segments: Sequence[Segment]) -> Estimates:
    """Smoothed estimates over a whole recording, at the IMU samples that the filter used.

    Args:
        imu_stream: of the recording.
        segments: at least one, see :meth:`.ekf.Ekf.segments`.
    """
    imu = imu_records(imu_stream)
    rows = np.concatenate([_smooth(imu, segment) for segment in segments])
    return Estimates(rows["time_ns"].copy(), rows)


def _smooth(imu: Records, segment: Segment) -> Records:
    """Smoothed estimates (M,) of one segment."""
    inputs = Inputs(imu[segment.samples], segment.journal, segment.noise)
    bounds = [*range(0, len(inputs.imu), CHUNK), len(inputs.imu)]
    chunks = list(pairwise(bounds))
    checkpoints = np.empty(len(chunks), ESTIMATE)
    applied = np.zeros(len(chunks) + 1, dtype=np.int64)
    estimate, no_tape = segment.initial.estimate.copy(), Tape.empty(0, 0)
    for chunk, (first, last) in enumerate(chunks):
        checkpoints[chunk] = estimate[0]
        applied[chunk + 1] = forward(inputs, estimate, first, last, int(applied[chunk]), no_tape)

    smoothed = np.empty(len(inputs.imu), ESTIMATED)
    adjoint, information = np.zeros(ERROR_STATES), np.zeros((ERROR_STATES, ERROR_STATES))
    tape = Tape.empty(CHUNK, int(np.diff(applied).max(initial=0)))
    for chunk, (first, last) in reversed(list(enumerate(chunks))):
        forward(inputs, checkpoints[chunk : chunk + 1], first, last, int(applied[chunk]), tape)
        _backward(tape, adjoint, information, smoothed[first:last])
    smoothed["time_ns"] = inputs.imu["time_ns"]
    return smoothed[segment.first :]


@njit(cache=True)
def forward(inputs: Inputs, estimates: Records, first: int, last: int, applied: int, tape: Tape) -> int:
    """Filter up to IMU sample `last - 1`, the corrections in the order of their instants.

    Args:
        inputs: of the segment.
        estimates: (1,) at IMU sample `first - 1`, or where the segment begins; updated.
        first: IMU sample that comes next.
        last: after the IMU samples of this pass.
        applied: corrections applied before this pass.
        tape: filled, if it has room.

    Returns:
        Corrections applied after this pass.
    """
    estimate, journal, length = estimates[0], inputs.journal, tape.length[0]
    length.events, length.steps, length.scalars, length.estimates = 0, 0, 0, 0
    for index in range(first, last):
        before, after = inputs.imu[max(index - 1, 0)], inputs.imu[index]
        while applied < len(journal) and journal[applied].time_ns <= after.time_ns:
            _advance(inputs, estimate, before, after, journal[applied].time_ns, tape)
            interpolate_sample(estimate, before, after)
            _correct(inputs, estimate, journal[applied], tape)
            applied += 1
        _advance(inputs, estimate, before, after, after.time_ns, tape)
        if len(tape.events) > 0:
            tape.estimates[length.estimates] = estimate
            length.estimates += 1
            _note(tape, ESTIMATE_HERE)
    return applied


@njit(cache=True)
def _advance(
    inputs: Inputs, estimate: Estimate, before: ImuSample, after: ImuSample, to_ns: int, tape: Tape
) -> None:
    """Propagate an estimate between two IMU samples."""
    if to_ns > estimate.time_ns:
        transition = tape.steps[tape.length[0].steps]
        propagate_between(estimate, inputs.noise[0], before, after, to_ns, transition)
        if len(tape.events) > 0:
            tape.length[0].steps += 1
            _note(tape, STEP)


@njit(cache=True)
def _correct(inputs: Inputs, estimate: Estimate, correction: Correction, tape: Tape) -> None:
    """Apply a correction as the filter did, at the filter's instant."""
    length, measurement = tape.length[0], correction.measurement
    scalars = tape.scalars[length.scalars : length.scalars + 6]
    corrections.widen(estimate, correction.widening)
    corrections.fuse(estimate, inputs.noise[0], measurement, scalars)
    if len(tape.events) > 0:
        for _ in range(6 if measurement.kind == POSE else 3):
            length.scalars += 1
            _note(tape, SCALAR_CORRECTION)


@njit(cache=True)
def _note(tape: Tape, event: int) -> None:
    """Record what happened."""
    length = tape.length[0]
    tape.events[length.events] = event
    length.events += 1


@njit(cache=True)
def _backward(tape: Tape, adjoint: Array, information: Array, smoothed: Records) -> None:
    """Run the adjoint state (16,) and its information (16, 16) back over a tape; smooth its estimates."""
    length = tape.length[0]
    while length.events > 0:
        length.events -= 1
        event = tape.events[length.events]
        if event == STEP:
            length.steps -= 1
            _step_back(tape.steps[length.steps], adjoint, information)
        elif event == SCALAR_CORRECTION:
            length.scalars -= 1
            _scalar_back(tape.scalars[length.scalars], adjoint, information)
        else:
            length.estimates -= 1
            _smooth_estimate(
                tape.estimates[length.estimates], adjoint, information, smoothed[length.estimates]
            )


@njit(cache=True)
def _step_back(transition: Transition, adjoint: Array, information: Array) -> None:
    """λ ← Fᵀ λ and Λ ← Fᵀ Λ F."""
    apply_transposed(transition, adjoint)
    for column in range(ERROR_STATES):
        apply_transposed(transition, information[column])
    for column in range(ERROR_STATES):
        for other in range(column):
            upper, lower = information[other, column], information[column, other]
            information[other, column], information[column, other] = lower, upper
    for column in range(ERROR_STATES):
        apply_transposed(transition, information[column])


@njit(cache=True)
def _scalar_back(scalar: Scalar, adjoint: Array, information: Array) -> None:
    """λ ← (I − k hᵀ)ᵀ λ − h y/s and Λ ← (I − k hᵀ)ᵀ Λ (I − k hᵀ) + h hᵀ/s."""
    by, gain = scalar.jacobian, scalar.gain
    turned = np.empty(ERROR_STATES)
    along = scalar.innovation / scalar.innovation_variance
    inner = 1.0 / scalar.innovation_variance
    for i in range(ERROR_STATES):
        total = 0.0
        for j in range(ERROR_STATES):
            total += information[i, j] * gain[j]
        turned[i] = total
        along += gain[i] * adjoint[i]
        inner += gain[i] * total
    for i in range(ERROR_STATES):
        adjoint[i] -= by[i] * along
        for j in range(ERROR_STATES):
            information[i, j] += by[i] * by[j] * inner - by[i] * turned[j] - turned[i] * by[j]


@njit(cache=True)
def _smooth_estimate(
    estimate: Estimate, adjoint: Array, information: Array, smoothed: EstimatedSample
) -> None:
    """X ← x − P λ, of variance P − P Λ P."""
    covariance = estimate.covariance
    error = np.empty(ERROR_STATES)
    for i in range(ERROR_STATES):
        total, reduction = 0.0, 0.0
        for j in range(ERROR_STATES):
            total -= covariance[i, j] * adjoint[j]
            inner = 0.0
            for k in range(ERROR_STATES):
                inner += information[j, k] * covariance[k, i]
            reduction += covariance[i, j] * inner
        error[i] = total
        smoothed.variance[i] = max(covariance[i, i] - reduction, 0.0)
    inject(estimate, error)
    copy_nominal(estimate, smoothed)
