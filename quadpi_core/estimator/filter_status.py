# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How far an estimate can be used, by its own covariance and by what became of the corrections."""

from __future__ import annotations

from quadpi_core.compiled import njit
from quadpi_core.estimator.filter_memory import Clock, Memory, Source
from quadpi_core.estimator.propagate import ACCELEROMETER_BIAS, VELOCITY, EstimatorStatus, covariance_of
from quadpi_core.frames import Array

# Without a correction for this long the state is DEGRADED, then LOST.
DEGRADED_NS = 250_000_000
LOST_NS = 2_000_000_000
_DEGRADED_REJECTIONS = 3
# Standard deviation beyond which a velocity is of no use as an input of a model.
VELOCITY_STD_MAX_M_S = 2.0
# Standard deviations beyond which the state is DEGRADED: it has not settled after its start or a jump of
# motion capture that was believed. Up to this velocity predictions are those of a settled state to half of
# the half width of their intervals; this specific force is one per cent of the weight.
SETTLED_VELOCITY_STD_M_S = 0.05
SETTLED_BIAS_STD_M_S2 = 0.1

_HEAD, _ACCEPTED_NS, _REFUSED = Clock.HEAD, Clock.ACCEPTED_NS, Source.REFUSED
_VELOCITY, _ACCELEROMETER_BIAS = VELOCITY.start, ACCELEROMETER_BIAS.start


@njit(cache=True)
def status_of(memory: Memory, now_ns: int) -> int:
    """How far the newest estimate can be used, at its stamp: a value of :class:`EstimatorStatus`."""
    since = now_ns - memory.clock[_ACCEPTED_NS]
    covariance = covariance_of(memory.rows[memory.clock[_HEAD]])
    velocity, bias = _worst(covariance, _VELOCITY), _worst(covariance, _ACCELEROMETER_BIAS)
    if since > LOST_NS or velocity > VELOCITY_STD_MAX_M_S**2:
        return EstimatorStatus.LOST.value
    rejections = max(memory.sources[0, _REFUSED], memory.sources[1, _REFUSED])
    settled = velocity <= SETTLED_VELOCITY_STD_M_S**2 and bias <= SETTLED_BIAS_STD_M_S2**2
    if since > DEGRADED_NS or rejections >= _DEGRADED_REJECTIONS or not settled:
        return EstimatorStatus.DEGRADED.value
    return EstimatorStatus.OK.value


@njit(cache=True)
def _worst(covariance: Array, begin: int) -> float:
    """The largest of three variances."""
    worst: float = max(
        covariance[begin, begin], covariance[begin + 1, begin + 1], covariance[begin + 2, begin + 2]
    )
    return worst
