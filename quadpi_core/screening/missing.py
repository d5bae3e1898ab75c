# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a recording lacks, and what cannot be done with it for that reason."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from quadpi_core.flight import Recording
from quadpi_core.signals.resample import nominal_rate

# Of rotors and airframe nothing is left in samples further apart.
_SLOWEST_IMU_HZ = 50.0
_MARGIN = 0.9


def missing(recording: Recording) -> Iterator[str]:
    """One sentence for each thing that is absent and rules something out."""
    if recording.rotor_speeds is None:
        yield "no rotor speeds: rules out identification, prediction and replay"
    mocap = recording.pose or recording.twist
    if mocap is None and recording.odometry is None:
        yield "neither pose nor odometry: rules out everything that needs velocity or attitude"
    elif mocap is None:
        yield "no motion-capture pose: the state is the logged odometry; rules out the live estimator"
    if len(recording.imu) > 1:
        with np.errstate(divide="ignore"):  # stamps that all repeat are reported elsewhere
            rate_hz = nominal_rate(recording.imu.time_ns)
        if rate_hz < _MARGIN * _SLOWEST_IMU_HZ:
            yield f"imu at {rate_hz:.3g} Hz: rules out identification, prediction and replay: too slow"
