# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Recognition of duplicate flights by their sensor values: a copy must not leak across a split."""

from __future__ import annotations

import hashlib
import tempfile
from contextlib import ExitStack
from dataclasses import replace
from typing import IO

from quadpi_core.flight import Recording, RotorSpeedStream, Stamps
from quadpi_core.frames import Array

# For a column that is hashed later: bytes held in memory before a file takes them, and bytes read at once.
_WAITING_BYTES, _READ_AT_ONCE = 1 << 22, 1 << 20


def recording_hash(recording: Recording) -> str:
    """SHA-256 of the IMU and rotor-speed samples: the same for a log, its bag and a copy of either.

    Stamps count from the first IMU sample in microseconds and values are rounded to single precision, so
    neither a shifted clock nor the rounding of a conversion makes copies differ.
    """
    rotors = recording.rotor_speeds
    if recording.commanded and recording.commands is not None:
        # As measured: the flight is the same whatever motors its speeds are made by.
        rotors = RotorSpeedStream(recording.commands.time_ns, recording.commands.commands)
        recording = replace(recording, rotor_speeds=rotors)
    with RunningHash(recording.imu.time_ns, None if rotors is None else rotors.time_ns) as running:
        running.add(recording)
        return running.hexdigest()


class RunningHash(ExitStack):
    """The hash of a recording that comes in parts; see :func:`recording_hash`.

    Columns that are hashed last wait in temporary files without a name.

    Args:
        imu_ns: (N,) stamps of all IMU samples.
        rotors_ns: (M,) stamps of the rotor speeds; None for a recording without them.
    """

    def __init__(self, imu_ns: Stamps, rotors_ns: Stamps | None) -> None:
        super().__init__()
        self._digest = hashlib.sha256()
        self._start_ns = int(imu_ns[0]) if len(imu_ns) else 0
        self._rotors_ns = rotors_ns
        self._force = self.enter_context(_waiting())
        self._speeds = self.enter_context(_waiting())
        self._hash_stamps(imu_ns)

    def add(self, part: Recording) -> None:
        """Add the next samples."""
        self._digest.update(_bytes(part.imu.angular_velocity))
        self._force.write(_bytes(part.imu.specific_force))
        if part.rotor_speeds is not None:
            self._speeds.write(_bytes(part.rotor_speeds.speeds))

    def hexdigest(self) -> str:
        """Hash of all samples; none can be added afterwards."""
        self._hash_file(self._force)
        if self._rotors_ns is not None:
            self._hash_stamps(self._rotors_ns)
            self._hash_file(self._speeds)
        return self._digest.hexdigest()

    def _hash_stamps(self, time_ns: Stamps) -> None:
        self._digest.update(((time_ns - self._start_ns) // 1000).astype("<i8").tobytes())

    def _hash_file(self, file: IO[bytes]) -> None:
        file.seek(0)
        while part := file.read(_READ_AT_ONCE):
            self._digest.update(part)


def _waiting() -> IO[bytes]:
    """A temporary file without a name, so that it never remains."""
    return tempfile.SpooledTemporaryFile(_WAITING_BYTES)


def _bytes(values: Array) -> bytes:
    # Adding zero makes -0.0, which a change of axes leaves behind, the same as 0.0.
    return (values + 0.0).astype("<f4").tobytes()
