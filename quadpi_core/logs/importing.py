# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flight logs of any known format to MCAP bags with the standard topics."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from quadpi_core.errors import LogError
from quadpi_core.flight import Recording
from quadpi_core.logs import read_recording
from quadpi_core.logs.bags import write_bag
from quadpi_core.logs.duplicates import refuse_duplicates
from quadpi_core.logs.plausibility import check_plausible
from quadpi_core.signals.alignment import Alignment, align_pose
from quadpi_core.vehicle import Vehicle


class Imported(NamedTuple):
    """A bag that was written, what it holds, and how its poses were moved in time, if they were."""

    bag: Path
    recording: Recording
    alignment: Alignment | None


def import_logs(
    logs: Sequence[Path], vehicle: Vehicle, folder: Path, mapping: str | None = None, *, align: bool = False
) -> Iterator[Imported]:
    """Write one bag per log into `folder`; gives each as soon as it is written.

    With `align`, the stamps of the poses are moved so that the turns they show match the gyro's.

    All logs are read and checked before the first bag is written.

    Raises:
        LogError: naming file, topic and sample, for a log that cannot be read or is not plausible, a flight
            present twice, two logs of the same name, and a bag that would replace its own log.
        SignalError: naming the log, if `align` finds no pose or no offset at which the turns match.
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
    aligned = [align_pose(recording) if align else (recording, None) for recording in recordings]
    for recording, alignment in aligned:
        bag = _bag(folder, recording)
        write_bag(bag, recording)
        yield Imported(bag, recording, alignment)


def _bag(folder: Path, recording: Recording) -> Path:
    return folder / f"{recording.name}.mcap"
