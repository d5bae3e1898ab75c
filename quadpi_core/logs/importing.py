# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flight logs of any known format to MCAP bags with the standard topics."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from quadpi_core.errors import LogError
from quadpi_core.flight import Recording
from quadpi_core.logs import read_recording
from quadpi_core.logs.bags import write_bag
from quadpi_core.logs.duplicates import refuse_duplicates
from quadpi_core.logs.plausibility import check_plausible
from quadpi_core.vehicle import Vehicle


def import_logs(
    logs: Sequence[Path], vehicle: Vehicle, folder: Path, mapping: str | None = None
) -> Iterator[tuple[Path, Recording]]:
    """Write one bag per log into `folder`; gives each bag's path and what it holds, once written.

    All logs are read and checked before the first bag is written.

    Raises:
        LogError: naming file, topic and sample, for a log that cannot be read or is not plausible, a flight
            present twice, two logs of the same name, and a bag that would replace its own log.
    """
    recordings = [read_recording(log, vehicle, mapping) for log in logs]
    stems: dict[str, Path] = {}
    for log, recording in zip(logs, recordings, strict=True):
        if recording.name in stems:
            raise LogError(f"{log}: would be written to the same bag as {stems[recording.name]}")
        stems[recording.name] = log
        if _bag(folder, recording).resolve() == log.resolve():
            raise LogError(f"{log}: its own bag would replace it; choose another folder")
        check_plausible(recording, vehicle)
    refuse_duplicates(recordings)
    for recording in recordings:
        bag = _bag(folder, recording)
        write_bag(bag, recording)
        yield bag, recording


def _bag(folder: Path, recording: Recording) -> Path:
    return folder / f"{recording.name}.mcap"
