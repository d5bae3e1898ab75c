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

from quadpi_core.core import compiled
from quadpi_core.estimator.filter_run import ESTIMATED, Estimates, Segment, imu_records
from quadpi_core.estimator.filter_state import ERROR_STATES, ESTIMATE, SCALAR, TRANSITION
from quadpi_core.flight import ImuStream, Stamps
from quadpi_core.records import Records, record_dtype

# IMU samples between checkpoints: a second at the usual rate.
CHUNK = 500


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
        applied[chunk + 1] = compiled.forward(inputs, estimate, first, last, int(applied[chunk]), no_tape)

    smoothed = np.empty(len(inputs.imu), ESTIMATED)
    adjoint, information = np.zeros(ERROR_STATES), np.zeros((ERROR_STATES, ERROR_STATES))
    tape = Tape.empty(CHUNK, int(np.diff(applied).max(initial=0)))
    for chunk, (first, last) in reversed(list(enumerate(chunks))):
        compiled.forward(inputs, checkpoints[chunk : chunk + 1], first, last, int(applied[chunk]), tape)
        compiled.backward(tape, adjoint, information, smoothed[first:last])
    smoothed["time_ns"] = inputs.imu["time_ns"]
    return smoothed[segment.first :]
