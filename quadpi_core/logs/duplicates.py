# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights recognised by what their sensors saw: a copy of a flight must not leak across a split."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable

from quadpi_core.errors import LogError
from quadpi_core.flight import Recording, Stamps
from quadpi_core.frames import Array


def recording_hash(recording: Recording) -> str:
    """SHA-256 of the IMU and rotor-speed samples: the same for a log, its bag and a copy of either.

    Stamps count from the first IMU sample in microseconds and values are rounded to single precision, so
    neither a shifted clock nor the rounding of a conversion tells copies apart.
    """
    digest = hashlib.sha256()
    imu, rotors = recording.imu, recording.rotor_speeds
    start = int(imu.time_ns[0]) if len(imu) else 0
    _update(digest, imu.time_ns - start, imu.angular_velocity, imu.specific_force)
    if rotors is not None:
        _update(digest, rotors.time_ns - start, rotors.speeds)
    return digest.hexdigest()


def _update(digest: hashlib._Hash, time_ns: Stamps, *signals: Array) -> None:
    digest.update((time_ns // 1000).astype("<i8").tobytes())
    for values in signals:
        # Adding zero makes -0.0, which a change of axes leaves behind, the same as 0.0.
        digest.update((values + 0.0).astype("<f4").tobytes())


def refuse_duplicates(flights: Iterable[tuple[str, str]]) -> None:
    """Refuse a flight that is present twice, of flights as source and hash (see :func:`recording_hash`).

    Raises:
        LogError: naming both files.
    """
    seen: dict[str, str] = {}
    for source, digest in flights:
        if digest in seen:
            raise LogError(f"{source}: the same flight as {seen[digest]}; give each flight once")
        seen[digest] = source
