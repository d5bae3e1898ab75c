# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Windows of a recording on one grid, of known signals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadpi_core.screening.excerpt import WINDOWS, excerpt


def test_the_cost_does_not_grow_with_the_flight(flown):
    """A flight of any length gives windows of the same number and size."""
    recording = flown["train_2"]
    imu, pose = recording.imu, recording.pose
    period = int(imu.time_ns[-1] - imu.time_ns[0] + np.diff(imu.time_ns).min())

    def repeated(stream, times):
        columns = {name: np.concatenate([getattr(stream, name)] * times) for name in vars(stream)}
        shifts = np.repeat(period * np.arange(times), len(stream))
        return replace(stream, **{**columns, "time_ns": columns["time_ns"] + shifts})

    sizes = []
    for times in (4, 8):
        long = replace(recording, imu=repeated(imu, times), pose=repeated(pose, times))
        sample = excerpt(long, long.pose)
        assert sample is not None
        sizes.append(sample.rates.shape)
    assert sizes[0] == sizes[1]
    assert 0.9 * WINDOWS < sizes[0][0] <= WINDOWS
