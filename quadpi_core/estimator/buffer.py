# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What each sample does to the filter's memory of the last half second.

Motion capture is late: a measurement is fused at the instant that it was taken, and the estimates since then
are computed again. So that the order of arrival hardly matters, and replay equals live, a measurement stamped
s is held until the first IMU sample that is stamped s + HOLD_NS or later; one that arrives after that is
fused at the next IMU sample.
"""

from __future__ import annotations

from quadpi_core.compiled import njit
from quadpi_core.estimator import corrections
from quadpi_core.estimator.corrections import POSE_GATE, VELOCITY_GATE
from quadpi_core.estimator.filter_state import (
    ACCELEROMETER_BIAS,
    BUFFER_S,
    POSE,
    VELOCITY,
    Correction,
    Estimate,
    EstimatorStatus,
    Filter,
    ImuSample,
    Measurement,
    Outcome,
    copy_sample,
    copy_state,
    interpolate_sample,
)
from quadpi_core.estimator.imu_rate import NOTICED_NS, off_for
from quadpi_core.estimator.propagate import propagate_between
from quadpi_core.flight import MAX_GAP_NS, MAX_JUMP_BACK_NS, NO_STAMP
from quadpi_core.frames import Array
from quadpi_core.records import Records
from quadpi_core.sample_limits import usable_imu, usable_pose, usable_velocity
from quadpi_core.signals.resample import RATE_SPAN

HOLD_NS = 10_000_000
_BUFFER_NS = round(BUFFER_S * 1e9)
# Rejections that persist for this long, and agree among themselves, are taken for the truth.
_PERSISTENCE_NS = 400_000_000
_PERSISTENCE_COUNT = 5
# A sensor with noise never repeats a value this often; one that does, after this many changes, is frozen.
_REPEATS_MAX = 12

# Without a correction for this long the state is DEGRADED, then LOST.
DEGRADED_NS = 250_000_000
LOST_NS = 2_000_000_000
_DEGRADED_REJECTIONS = 3
# Standard deviation beyond which a velocity is of no use as an input of a model.
VELOCITY_STD_MAX_M_S = 2.0
# Standard deviations beyond which the state is DEGRADED: it has not settled after its start, or after a jump
# of motion capture that was accepted. Up to this velocity predictions differ from those of a settled state by
# no more than half of the half width of their intervals; this specific force is 1 % of the weight.
SETTLED_VELOCITY_STD_M_S = 0.05
SETTLED_BIAS_STD_M_S2 = 0.1


@njit(cache=True)
def predict(memory: Filter, ring: Records, sample: ImuSample) -> int:
    """Move the newest estimate to the stamp of an IMU sample; :func:`fuse_due` is next.

    Gives the value of an :class:`Outcome`. A sample that is not USED changes only what tells a jump of the
    stamps or another rate.
    """
    if not usable_imu(sample.rates, sample.specific_force):
        return Outcome.UNUSABLE.value
    outcome = _stamp_outcome(memory, ring, sample.time_ns)
    if outcome != Outcome.USED.value:
        return outcome
    before, following = memory.newest, _after(ring, memory.newest)
    copy_sample(sample, ring[following])
    _load_latest(memory, ring, before)
    _advance(memory, ring, memory.prior, before, sample.time_ns)
    copy_state(memory.prior, ring[following])
    memory.newest = following
    memory.filled = min(memory.filled + 1, len(ring))
    memory.status = status_of(memory, ring)
    memory.counts[0, outcome] += 1
    return outcome


@njit(cache=True)
def catch_up(memories: Records, ring: Records, samples: Records) -> None:
    """Move the initial estimate on over the IMU samples (K,) since then, which have been counted before."""
    memory = memories[0]
    counted = memory.counts[0, Outcome.USED.value]
    for index in range(len(samples)):
        predict(memory, ring, samples[index])
    memory.counts[0, Outcome.USED.value] = counted
    memory.accepted_ns = ring[memory.newest].time_ns
    memory.status = status_of(memory, ring)


@njit(cache=True)
def _stamp_outcome(memory: Filter, ring: Records, time_ns: int) -> int:
    """USED, or why an IMU sample of that stamp cannot be."""
    since = time_ns - ring[memory.newest].time_ns
    if since > MAX_GAP_NS or since < -MAX_JUMP_BACK_NS:
        # One stamp alone may be broken; two that agree are a pause or another clock.
        if 0 < time_ns - memory.jumped_ns <= MAX_GAP_NS:
            return Outcome.RESET.value
        memory.jumped_ns = time_ns
        return Outcome.STAMP_JUMPED.value
    memory.jumped_ns = NO_STAMP
    if since <= 0:
        return Outcome.STAMP_NOT_ADVANCING.value
    if memory.rate_span_ns > 0 and memory.filled >= RATE_SPAN:
        first = ring[(memory.newest + 1 - RATE_SPAN) % len(ring)]
        span_ns = time_ns - first.time_ns
        memory.rate_off_ns = off_for(memory.rate_off_ns, span_ns, memory.rate_span_ns, since)
        if memory.rate_off_ns > NOTICED_NS:
            return Outcome.RESET.value
    return Outcome.USED.value


@njit(cache=True)
def hold(memories: Records, ring: Records, measurements: Records) -> int:
    """Take one measurement (1,); it is fused when its time has come.

    Returns:
        The value of an :class:`Outcome`, which is counted: COLLECTED, or why it is refused.
    """
    return hold_one(memories[0], ring, measurements[0])


@njit(cache=True)
def hold_one(memory: Filter, ring: Records, measurement: Measurement) -> int:
    """:func:`hold` for kernels."""
    place = source_of(measurement)
    source, time_ns = memory.sources[place], measurement.time_ns
    outcome = Outcome.COLLECTED.value
    if not usable(measurement):
        outcome = Outcome.UNUSABLE.value
    elif time_ns > ring[memory.newest].time_ns + MAX_GAP_NS or memory.held_count == len(memory.held):
        outcome = Outcome.TOO_EARLY.value
    elif source.arrived_ns - MAX_JUMP_BACK_NS <= time_ns <= source.arrived_ns:
        outcome = Outcome.STAMP_NOT_ADVANCING.value
    if outcome != Outcome.COLLECTED.value:
        memory.counts[1 + place, outcome] += 1
        return outcome
    source.arrived_ns = time_ns
    # In the order of stamps: an odometry's two parts, and sources that overtake each other.
    size = len(memory.held)
    at = (memory.held_first + memory.held_count) % size
    for _ in range(memory.held_count):
        previous = (at - 1) % size
        if memory.held[previous].time_ns <= time_ns:
            break
        memory.held[at] = memory.held[previous]
        at = previous
    memory.held[at] = measurement
    memory.held_count += 1
    return outcome


@njit(cache=True)
def source_of(measurement: Measurement) -> int:
    """Place of the source of a measurement: poses, then velocities."""
    return 0 if measurement.kind == POSE else 1


@njit(cache=True)
def usable_measurement(measurements: Records) -> bool:
    """Whether a measurement (1,) can be one."""
    return usable(measurements[0])


@njit(cache=True)
def usable(measurement: Measurement) -> bool:
    """Whether a measurement can be one."""
    if measurement.kind == POSE:
        return usable_pose(measurement.vector, measurement.attitude)
    return usable_velocity(measurement.vector)


@njit(cache=True)
def fuse_due(memory: Filter, ring: Records, journal: Records) -> None:
    """Fuse the measurements whose time has come.

    Args:
        memory: after :func:`predict`.
        ring: of estimates.
        journal: (J,) filled with each :class:`Correction` as it was applied, while there is room.
    """
    now_ns = ring[memory.newest].time_ns
    while memory.held_count > 0 and memory.held[memory.held_first].time_ns + HOLD_NS <= now_ns:
        measurement = memory.held[memory.held_first]
        memory.held_first = (memory.held_first + 1) % len(memory.held)
        memory.held_count -= 1
        outcome = _fuse(memory, ring, measurement)
        memory.counts[1 + source_of(measurement), outcome] += 1
        if outcome == Outcome.USED.value and memory.journalled < len(journal):
            journal[memory.journalled] = memory.correction
            memory.journalled += 1
    memory.status = status_of(memory, ring)


@njit(cache=True)
def _fuse(memory: Filter, ring: Records, measurement: Measurement) -> int:
    """Fuse one measurement at the instant that it was taken; the value of an :class:`Outcome`.

    Instants before the last correction, or after the newest IMU sample, are not corrected: the measurement is
    compared with what the motion of the nearest estimate makes of them.
    """
    newest = ring[memory.newest]
    taken_ns = corrections.taken_ns(newest, measurement)
    if taken_ns < newest.time_ns - _BUFFER_NS:
        return Outcome.TOO_LATE.value
    oldest = ring[(memory.newest - memory.filled + 1) % len(ring)]
    instant_ns = min(max(taken_ns, memory.corrected.time_ns, oldest.time_ns), newest.time_ns)
    before = _recall(memory, ring, instant_ns)
    if _frozen(memory, measurement):
        return Outcome.FROZEN.value
    correction = memory.correction
    correction.time_ns, correction.measurement = instant_ns, measurement
    if not _corrected(memory, correction):
        return Outcome.REJECTED.value
    memory.sources[source_of(measurement)].refusals = 0
    memory.accepted_ns = newest.time_ns
    memory.corrected = memory.trial
    _recompute(memory, ring, before)
    return Outcome.USED.value


@njit(cache=True)
def _recall(memory: Filter, ring: Records, instant_ns: int) -> int:
    """Set `memory.prior` to the estimate at an instant; the place of the one at or before it."""
    before = memory.newest
    while ring[before].time_ns > instant_ns:
        before = (before - 1) % len(ring)
    _load_latest(memory, ring, before)
    _advance(memory, ring, memory.prior, before, instant_ns)
    interpolate_sample(memory.prior, ring[before], ring[_after(ring, before)])
    return before


@njit(cache=True)
def _corrected(memory: Filter, correction: Correction) -> bool:
    """Correct `memory.prior` into `memory.trial`; False if the measurement is rejected.

    One beyond its gate is accepted once rejections persist, by an estimate that is widened for it first.
    """
    noise, measurement, widening = memory.noise, correction.measurement, correction.widening
    gate = POSE_GATE if measurement.kind == POSE else VELOCITY_GATE
    widening.position, widening.velocity, widening.attitude, widening.delay = 0.0, 0.0, 0.0, 0.0
    memory.trial = memory.prior
    correction.nis = corrections.fuse(memory.trial, noise, measurement, memory.scalars)
    if correction.nis <= gate:
        return True
    if not _rejections_persist(memory, measurement):
        return False
    corrections.fill_widening(widening, memory.prior, noise, measurement)
    memory.trial = memory.prior
    corrections.widen(memory.trial, widening)
    correction.nis = corrections.fuse(memory.trial, noise, measurement, memory.scalars)
    return True


@njit(cache=True)
def _recompute(memory: Filter, ring: Records, before: int) -> None:
    """Compute the estimates after `memory.trial` again, which lies at or after the one at `before`."""
    estimate = memory.trial
    if ring[before].time_ns == estimate.time_ns:
        copy_state(estimate, ring[before])
    while before != memory.newest:
        following = _after(ring, before)
        _advance(memory, ring, estimate, before, ring[following].time_ns)
        copy_state(estimate, ring[following])
        before = following


@njit(cache=True)
def _load_latest(memory: Filter, ring: Records, before: int) -> None:
    """Set `memory.prior` to the last estimate before the IMU sample that follows the one at `before`.

    That is the last correction, if it is that late.
    """
    if memory.corrected.time_ns >= ring[before].time_ns:
        memory.prior = memory.corrected
    else:
        memory.prior = ring[before]


@njit(cache=True)
def _advance(memory: Filter, ring: Records, estimate: Estimate, before: int, to_ns: int) -> None:
    """Propagate an estimate between the IMU sample at `before` and the one that follows."""
    if to_ns > estimate.time_ns:
        first, second = ring[before], ring[_after(ring, before)]
        propagate_between(estimate, memory.noise, first, second, to_ns, memory.transition)


@njit(cache=True)
def _after(ring: Records, place: int) -> int:
    return (place + 1) % len(ring)


@njit(cache=True)
def _frozen(memory: Filter, measurement: Measurement) -> bool:
    """Whether a measurement only repeats the previous one although the vehicle moves, or for too long."""
    source = memory.sources[source_of(measurement)]
    if not _same_value(source.last, measurement):
        source.last = measurement
        source.repeats = 0
        source.changes = min(source.changes + 1, _REPEATS_MAX)
        return False
    source.repeats += 1
    if source.repeats >= _REPEATS_MAX and source.changes >= _REPEATS_MAX:
        return True
    elapsed = 1e-9 * (measurement.time_ns - source.last.time_ns)
    return corrections.motion_shows(memory.prior, memory.noise, measurement.kind, elapsed)


@njit(cache=True)
def _same_value(first: Measurement, second: Measurement) -> bool:
    same = True
    for axis in range(3):
        same = same and first.vector[axis] == second.vector[axis]
    for component in range(4):
        same = same and first.attitude[component] == second.attitude[component]
    return same


@njit(cache=True)
def _rejections_persist(memory: Filter, measurement: Measurement) -> bool:
    """Note a rejection; whether rejections that agree among themselves have lasted long enough."""
    source, time_ns = memory.sources[source_of(measurement)], measurement.time_ns
    agrees = source.refusals > 0 and corrections.same_motion(
        source.refused, measurement, memory.prior, memory.noise
    )
    if not agrees:
        source.refusals = 0
        source.refused_since_ns = time_ns
    source.refusals += 1
    source.refused = measurement
    lasted = time_ns - source.refused_since_ns >= _PERSISTENCE_NS
    return bool(lasted and source.refusals >= _PERSISTENCE_COUNT)


@njit(cache=True)
def status_of(memory: Filter, ring: Records) -> int:
    """How far the newest estimate can be used: the value of an :class:`EstimatorStatus`."""
    newest = ring[memory.newest]
    since = newest.time_ns - memory.accepted_ns
    velocity = _largest_variance(newest.covariance, VELOCITY.start)
    bias = _largest_variance(newest.covariance, ACCELEROMETER_BIAS.start)
    if since > LOST_NS or velocity > VELOCITY_STD_MAX_M_S**2:
        return EstimatorStatus.LOST.value
    rejections = max(memory.sources[0].refusals, memory.sources[1].refusals)
    settled = velocity <= SETTLED_VELOCITY_STD_M_S**2 and bias <= SETTLED_BIAS_STD_M_S2**2
    if since > DEGRADED_NS or rejections >= _DEGRADED_REJECTIONS or not settled:
        return EstimatorStatus.DEGRADED.value
    return EstimatorStatus.OK.value


@njit(cache=True)
def _largest_variance(covariance: Array, first: int) -> float:
    """The largest of three variances."""
    largest: float = max(
        covariance[first, first], covariance[first + 1, first + 1], covariance[first + 2, first + 2]
    )
    return largest
