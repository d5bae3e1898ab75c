# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The same flight is recognised under another name, in another container, on another clock."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from quadpi_core.flight import ImuStream, Recording, RotorSpeedStream
from quadpi_core.frames import body_flu_to_frd, body_frd_to_flu
from quadpi_core.logs.readers import RunningHash, recording_hash


def with_speeds(recording: Recording, change: Callable[[np.ndarray], object]) -> Recording:
    speeds = recording.rotor_speeds.speeds.copy()
    change(speeds)
    return replace(recording, rotor_speeds=replace(recording.rotor_speeds, speeds=speeds))


def with_imu(recording: Recording, **scale: float) -> Recording:
    scaled = {name: getattr(recording.imu, name) * factor for name, factor in scale.items()}
    return replace(recording, imu=replace(recording.imu, **scaled))


def test_copies_are_recognised_across_conversions(hover: Recording):
    there_and_back = body_flu_to_frd(body_frd_to_flu(hover.imu.specific_force)) * (1.0 + 1e-13)
    copy = replace(
        hover,
        source="copy.mcap",
        name="copy",
        imu=replace(hover.imu, time_ns=hover.imu.time_ns + 5_000_000_000, specific_force=there_and_back),
        rotor_speeds=replace(hover.rotor_speeds, time_ns=hover.rotor_speeds.time_ns + 5_000_000_000),
    )
    assert recording_hash(copy) == recording_hash(hover)


def test_different_flights_are_not_duplicates(hover: Recording):
    other = with_imu(hover, specific_force=1.0 + 1e-5)
    faster = with_speeds(hover, lambda speeds: np.add(speeds, 1.0, out=speeds))
    assert len(set(map(recording_hash, (hover, other, faster)))) == 3


def test_the_hash_is_that_of_the_documented_bytes(hover: Recording):
    """Model folders hold it: stamps in µs since the first sample, then values in single precision."""
    imu, rotors = hover.imu, hover.rotor_speeds
    late = replace(hover, rotor_speeds=replace(rotors, time_ns=rotors.time_ns + 1_999))
    stamps = (imu.time_ns - imu.time_ns[0]) // 1000
    content = (stamps.astype("<i8"), imu.angular_velocity.astype("<f4"), imu.specific_force.astype("<f4"))
    speeds = ((stamps + 1).astype("<i8"), rotors.speeds.astype("<f4"))
    expected = hashlib.sha256(b"".join(part.tobytes() for part in (*content, *speeds))).hexdigest()
    assert recording_hash(late) == expected
    alone = hashlib.sha256(b"".join(part.tobytes() for part in content)).hexdigest()
    assert recording_hash(replace(hover, rotor_speeds=None)) == alone


def test_a_recording_in_parts_has_the_hash_of_the_whole(hover: Recording):
    """More of a column waits for its turn than is held in memory."""
    parts = 60
    whole = replace(
        hover,
        imu=ImuStream.join([hover.imu] * parts),
        rotor_speeds=RotorSpeedStream.join([hover.rotor_speeds] * parts),
    )
    with RunningHash(whole.imu.time_ns, whole.rotor_speeds.time_ns) as running:
        for _ in range(parts):
            running.add(hover)
        assert running.hexdigest() == recording_hash(whole)
