# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Streams that were stamped by different clocks: the offset at which they tell of one motion."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from quadpi_core.errors import SignalError
from quadpi_core.findings import Finding
from quadpi_core.flight import ImuStream, Recording, RotorSpeedStream
from quadpi_core.screening.excerpt import Excerpt, Pose, cost, excerpt, innovation, rotor_excerpt
from quadpi_core.screening.rotor_consistency import rotor_evidence
from quadpi_core.signals.alignment import Alignment, rotor_offset, span_of, turn_offset
from quadpi_core.thresholds import Threshold
from quadpi_core.vehicle import Vehicle

SHARED_S = Threshold(
    "time that streams share",
    1.0,
    "s",
    "the shortest window that the consistency check can use; the estimator needs a second to start",
    "none: what the estimator needs",
)
LEAST_OFFSET_S = Threshold(
    "offset of clocks",
    0.05,
    "s",
    "the estimator finds smaller delays by itself, from its usual prior of 0.05 s",
    "none: the default of noise.mocap_delay_std_s",
)
EXPLAINED = Threshold(
    "accelerations that rotor speeds explain",
    0.25,
    "of their variance",
    "sound flights have 0.5 and more at the right offset, wrong ones 0.11",
    "bundled bags; real flights of imrc_brushless and neurobem",
)
NEAR_S = Threshold(
    "offset of clocks that are set",
    1.0,
    "s",
    "clocks of a network agree to less; a motion repeats after longer",
    "none: a convention",
)
EXPLAINS = Threshold(
    "cost of the innovations at an offset",
    0.5,
    "of that without it",
    "as for every other mistake",
    "bundled bags and real flights, moved by 0.3 to 40 s",
)


class ClockMistake(NamedTuple):
    """A finding on clocks, and the cost of the innovations at the offset that it names; 0 without windows."""

    finding: Finding
    cost: float


def clock_mistake(recording: Recording, state: Pose, sample: Excerpt | None) -> ClockMistake | None:
    """The mistake that a state was stamped by another clock than the IMU's; None if it does not look so.

    Args:
        recording: with finite values and increasing stamps.
        state: of it.
        sample: the windows in which both have samples; None if there are none.
    """
    imu = recording.imu
    if sample is None and (len(state) < 2 or shared_s(imu, state) >= SHARED_S.value):
        return None
    alignment = None
    with suppress(SignalError):
        alignment = turn_offset(imu, state, state.topic)
    if sample is None:
        apart = _apart(imu, state, alignment, "turns")
        return None if apart is None else ClockMistake(apart, 0.0)
    if alignment is None or abs(alignment.offset_s) < LEAST_OFFSET_S.value:
        return None
    moved = excerpt(recording, replace(state, time_ns=state.time_ns + alignment.offset_ns))
    if moved is None:
        return None
    before, after = innovation(sample), innovation(moved)
    price = cost(after, before.motion)
    if price >= EXPLAINS.value * cost(before, before.motion):
        return None
    text = (
        f"gyro and attitude disagree: {_said(alignment)}; that lowers the innovation of the attitude from "
        f"{before.turn_rad_s:.2g} to {after.turn_rad_s:.2g} rad/s"
    )
    return ClockMistake(Finding("clock offset", state.topic, text, leave_out=True), price)


def rotor_clock_finding(recording: Recording, vehicle: Vehicle | None) -> Finding | None:
    """The finding that rotor speeds share no time with the IMU; None if they do.

    Without a vehicle no offset is looked for, as the places of the rotors are not known.
    """
    imu, rotors = recording.imu, recording.rotor_speeds
    if rotors is None or len(rotors) < 2 or len(imu) < 2 or shared_s(imu, rotors) >= SHARED_S.value:
        return None
    alignment = None
    if vehicle is not None:
        with suppress(SignalError):
            alignment = rotor_alignment(recording, rotors, vehicle)
    return _apart(imu, rotors, alignment, "lift and moments")


def rotor_alignment(recording: Recording, rotors: RotorSpeedStream, vehicle: Vehicle) -> Alignment:
    """The offset at which rotor speeds explain the motion.

    Raises:
        SignalError: if there is none.
    """
    what = f"{recording.source}: imu and {rotors.topic}"
    alignment = rotor_offset(recording.imu, rotors, vehicle, what)
    there = replace(rotors, time_ns=rotors.time_ns + alignment.offset_ns)
    sample = rotor_excerpt(replace(recording, rotor_speeds=there))
    evidence = None if sample is None else rotor_evidence(sample, vehicle)
    if evidence is None or evidence.explained < EXPLAINED.value:
        raise SignalError(f"{what}: no offset at which the rotor speeds explain the motion")
    return alignment


def aligned(recording: Recording, vehicle: Vehicle) -> tuple[Recording, dict[str, Alignment]]:
    """The recording with the stamps of its streams moved to the clock of the IMU, and by how much, by topic.

    Poses are moved so that their turns match the gyro's, velocities of the same motion capture with them; a
    fused state and rotor speeds only where they were stamped by another clock.

    Raises:
        SignalError: naming file and topic, if there is neither pose nor odometry, and for an offset that is
            not found or ambiguous; one below NEAR_S is taken for the right one.
    """
    imu, moved, delays = recording.imu, recording, {}
    if recording.pose is None and recording.odometry is None:
        raise SignalError(f"{recording.source}: topic mocap/pose is missing: nothing to align")
    for name in ("pose", "odometry", "rotor_speeds"):
        stream = getattr(recording, name)
        if stream is None:
            continue
        what = f"{recording.source}: imu and {stream.topic}"
        if isinstance(stream, RotorSpeedStream):
            if rotor_clock_finding(recording, vehicle) is None:
                continue
            alignment = rotor_alignment(recording, stream, vehicle)
        elif name == "odometry" and clock_mistake(recording, stream, excerpt(recording, stream)) is None:
            continue
        else:
            alignment = turn_offset(imu, stream, what)
        if alignment.rival_s is not None and abs(alignment.offset_s) > NEAR_S.value:
            raise SignalError(
                f"{what}: offsets of {alignment.offset_s:+.3f} s and {alignment.rival_s:+.3f} s fit nearly "
                "alike, as the motion repeats: align the clocks otherwise"
            )
        delays[stream.topic] = alignment
        moving = {name: stream, "twist": recording.twist if name == "pose" else None}
        shifted: dict[str, Any] = {
            field: replace(one, time_ns=one.time_ns + alignment.offset_ns)
            for field, one in moving.items()
            if one is not None
        }
        moved = replace(moved, **shifted)
    return moved, delays


def shared_s(imu: ImuStream, other: Pose | RotorSpeedStream) -> float:
    """Time that a stream shares with the IMU [s]; negative if there is a gap between them."""
    first, last = (max(imu.time_ns[0], other.time_ns[0]), min(imu.time_ns[-1], other.time_ns[-1]))
    return 1e-9 * float(last - first)


def _apart(
    imu: ImuStream, other: Pose | RotorSpeedStream, found: Alignment | None, what: str
) -> Finding | None:
    """The finding on streams that share no time; None where one is too short to."""
    if min(np.ptp(imu.time_ns), np.ptp(other.time_ns)) < 1e9 * SHARED_S.value:
        return None
    share = max(0.0, shared_s(imu, other))
    text = (
        f"spans {span_of(other.time_ns)}, imu {span_of(imu.time_ns)}: they share "
        f"{f'{share:.3f} s' if share else 'no time'}; "
        f"{f'no offset makes their {what} alike' if found is None else _said(found)}"
    )
    return Finding("clocks apart" if found is None else "clock offset", other.topic, text, leave_out=True)


def _said(found: Alignment) -> str:
    """The offset of the stamps, in words."""
    late, alike = -found.offset_s, f"correlation {found.correlation:.2f} over {found.overlap_s:.1f} s"
    if found.rival_s is None:
        return f"the stamps look {late:+.3f} s off, which `import --align` corrects ({alike})"
    return (
        f"the stamps look {late:+.3f} s or {-found.rival_s:+.3f} s off, which is ambiguous as the motion "
        f"repeats ({alike})"
    )
