# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Forces as a recording has them whose specific force ends at a lower frequency than its other signals.

The specific force of some data sets is the derivative of a smoothed velocity. A force that follows from
rotor speeds then holds what that of the recording lacks, and the two compare only once it is smoothed alike.
"""

from __future__ import annotations

import numpy as np

from quadpi_core.core import compiled
from quadpi_core.flight import mean_rate_hz
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_INDEX
from quadpi_core.rotations import rotation_matrix

_ORDER = 2
_RATES = slice(INPUT_INDEX["p"], INPUT_INDEX["r"] + 1)


def band_limited(time: Array, rates: Array, forces: Array, bandwidth_hz: float | None) -> Array:
    """Forces (N, 3, K) in body axes as a measurement of this bandwidth has them: smoothed without delay.

    Smoothing is done in axes that do not turn, as that of a velocity in the world.

    Args:
        time: (N,) s.
        rates: (N, 3) rad/s.
        forces: (N, 3, K), K at a time.
        bandwidth_hz: of a second-order low-pass, forward and backward; None or beyond half the sample rate
            leaves the forces as they are.
    """
    if bandwidth_hz is None or bandwidth_hz >= 0.5 * (rate_hz := mean_rate_hz(time)):
        return forces
    # Slow to import, and most importers of this module smooth nothing.
    from scipy.signal import butter, sosfiltfilt

    # Attitudes since the first sample, by the rates alone: they hardly drift in a smoothing time.
    attitude = np.empty((len(time), 4))
    compiled.turn_by_rates(np.ascontiguousarray(time), np.ascontiguousarray(rates), attitude)
    rotation = rotation_matrix(attitude)
    still = (rotation @ forces).reshape(len(forces), -1)
    smooth = sosfiltfilt(butter(_ORDER, bandwidth_hz, fs=rate_hz, output="sos"), still, axis=0)
    body: Array = rotation.transpose(0, 2, 1) @ smooth.reshape(forces.shape)
    return body


def as_recorded(time: Array, inputs: Array, wrench: Array, bandwidth_hz: float | None) -> Array:
    """A predicted wrench (N, 6) with forces as a measurement of this bandwidth has them.

    Args:
        time: (N,) s.
        inputs: (N, 19) input vectors.
        wrench: (N, 6) N and Nm.
        bandwidth_hz: see :func:`band_limited`.
    """
    forces = band_limited(time, inputs[:, _RATES], wrench[:, :3, np.newaxis], bandwidth_hz)
    return np.concatenate((forces[:, :, 0], wrench[:, 3:]), axis=1)
