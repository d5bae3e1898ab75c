# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flight logs of any known format to MCAP bags with the standard topics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from quadpi_core.findings import NOTHING_TO_SAY, DataQuality
from quadpi_core.flight import PoseStream, ValueCheck, check_stamps
from quadpi_core.flight_files import FlightFile, LeftOutFlights, bags_in, for_each_flight, once_each
from quadpi_core.logs.bags import recording_topics, recording_writer, write_bag, written_streams
from quadpi_core.logs.readers import (
    RunningHash,
    blocks_of,
    flights_of,
    identify_format,
    open_in_blocks,
    read_recording,
    recording_hash,
)
from quadpi_core.parallel import DEFAULT_WORKERS, Workers
from quadpi_core.paths import staged, whole_outputs
from quadpi_core.reading_options import MappingOrOptions, ReadingOptions, streams_by_field
from quadpi_core.screening.clock_consistency import aligned
from quadpi_core.screening.consistency import checked
from quadpi_core.screening.flight_runs import (
    Excerpting,
    Selection,
    in_order,
    require_imu_in,
    survey,
    survey_quality,
)
from quadpi_core.screening.plausibility import check_plausible, missing_topics
from quadpi_core.screening.sample_order import require_usable
from quadpi_core.screening.wild_samples import Screening
from quadpi_core.signals.alignment import Alignment
from quadpi_core.vehicle import Vehicle


@dataclass(frozen=True)
class Imported:
    """The bag of a log: what it holds and lacks, and how its streams were moved in time, by topic."""

    log: Path
    bag: Path
    imu_samples: int
    topics: tuple[str, ...]
    alignments: Mapping[str, Alignment]
    missing: tuple[str, ...] = ()
    quality: DataQuality = NOTHING_TO_SAY

    def to_json(self) -> dict[str, Any]:
        """As JSON holds it."""
        pose = PoseStream.topic
        return {
            "log": str(self.log),
            "bag": str(self.bag),
            "imu_samples": self.imu_samples,
            "topics": list(self.topics),
            "alignment": asdict(self.alignments[pose]) if pose in self.alignments else None,
            "alignments": {topic: asdict(one) for topic, one in self.alignments.items()},
            "missing": list(self.missing),
            "data_quality": self.quality.to_json(),
        }


def import_logs(
    logs: Sequence[Path],
    vehicle: Vehicle,
    folder: Path,
    mapping: MappingOrOptions = None,
    *,
    align: bool = False,
    workers: Workers = DEFAULT_WORKERS,
    left_out: LeftOutFlights = None,
) -> list[Imported]:
    """Write one bag per flight into `folder`, named as `flight_files.named_files` says; or none.

    Of a file with several flights each gets its bag: NAME_1, NAME_2 and so on.

    All logs are read and checked before the first bag appears there.

    Args:
        logs: of any known format.
        vehicle: that flew.
        folder: bags of the same names in it are replaced.
        mapping: see :func:`quadpi_core.logs.read_recording`.
        align: move the stamps of other clocks so that what the streams tell matches the IMU.
        workers: that convert the logs; the bytes do not depend on them.
        left_out: the list to which logs that cannot be used are added; without it, the first is an error.

    Raises:
        LogError: naming file, topic and sample, for a log that cannot be read or is not plausible, a flight
            present twice, and a bag that would replace a log.
        SignalError: naming the log, if `align` finds no pose or no offset at which the turns match.
        OutputError: if the bags cannot be written.
        ParallelError: see :meth:`quadpi_core.parallel.Workers.map`.
    """
    logs = [flight for log in logs for flight in flights_of(log)]
    bags_in(folder, logs)
    with whole_outputs(folder) as staging:
        task = _Conversion(vehicle, workers.found_by(mapping), align, staging.absolute())
        converted = for_each_flight(
            _convert, logs, shared=task, task="Importing logs", workers=workers, left_out=left_out
        )
        kept = once_each(converted, itemgetter(1), left_out)
        names = {file.name for file, _ in kept}
        for file, (imported, _) in converted:
            if file.name not in names:
                imported.bag.unlink()
    return [replace(imported, log=file.path, bag=folder / imported.bag.name) for file, (imported, _) in kept]


@dataclass(frozen=True)
class _Conversion:
    """What the conversion of each log needs."""

    vehicle: Vehicle
    mapping: ReadingOptions
    align: bool
    staging: Path


def _convert(task: _Conversion, file: FlightFile) -> tuple[Imported, str]:
    """The bag of a log in the temporary folder, and the hash of the flight."""
    log = file.path
    # To align clocks takes all turns of the flight at once.
    if identify_format(log).container is not None and not task.align:
        converted = _convert_in_blocks(task, file)
        if converted is not None:
            return converted
    recording = read_recording(log, task.vehicle, task.mapping)
    sha256 = recording_hash(recording)
    alignments: dict[str, Alignment] = {}
    if task.align:
        # Of units and axes that cannot be right, no offset tells.
        check_plausible(recording, task.vehicle)
        recording, alignments = aligned(recording, task.vehicle)
    recording = checked(recording, task.vehicle)
    bag = staged(task.staging, f"{file.name}.mcap")
    write_bag(bag, recording)
    topics = tuple(stream.topic for stream in written_streams(recording))
    lacking = tuple(missing_topics(recording))
    return Imported(log, bag, len(recording.imu), topics, alignments, lacking, recording.quality), sha256


# Streams that are few, and are written with the whole flight.
_BESIDE = {"commands", "battery", "pressure", "temperature"}


def _convert_in_blocks(task: _Conversion, file: FlightFile) -> tuple[Imported, str] | None:
    """Like :func:`_convert`, of a bag, which is read twice and never held whole; None for others.

    Where a clock falls, or there are commands, battery or air, a bag is read whole.

    Which samples of other topics belong to a run of the IMU, their order of arrival tells, of the whole.
    """
    part = task.mapping.part
    with ExitStack() as opened:
        bag = opened.enter_context(open_in_blocks(file.path, task.vehicle, task.mapping))
        if _BESIDE & set(bag.streams):
            return None
        surveyed = survey(partial(blocks_of, bag), task.vehicle, part)
        require_usable(bag.source, surveyed)
        if any(len(stream.order.starts) > 1 for stream in surveyed.values()):
            return None
        imu = surveyed["imu"]
        require_imu_in(bag.source, part, len(imu.time_ns), 1e-9 * float(np.ptp(imu.stored_ns)))
        quality_of_order = survey_quality(surveyed, part)
        streams = {name: stream for name, stream in surveyed.items() if len(stream.time_ns)}
        absent: dict[str, Any] = dict.fromkeys(surveyed.keys() - streams.keys())
        stamps = {name: stream.usable_ns for name, stream in streams.items()}
        wheres = {name: f"{bag.source}: topic {stream.topic}" for name, stream in streams.items()}
        for name, where in wheres.items():
            check_stamps(where, stamps[name])
        values = {name: ValueCheck(where) for name, where in wheres.items()}
        excerpting = Excerpting(stamps)
        screening = Screening(task.vehicle, readings=False)
        running = opened.enter_context(RunningHash(stamps["imu"], stamps.get("rotor_speeds")))
        topics = tuple(stream.topic for stream in streams.values())
        path = staged(task.staging, f"{file.name}.mcap")
        with recording_writer(path, bag.vehicle, bag.source, topics) as writer:
            written = dict.fromkeys(streams, 0)
            usable = Selection({name: stream.usable for name, stream in streams.items()})
            for every in map(usable.of, in_order(blocks_of(bag), streams)):
                block = replace(every, **absent)
                excerpting.add(block)
                running.add(block)
                screening.add(block)
                for topic in recording_topics(block):
                    writer.add(topic)
                for name, stream in streams_by_field(block).items():
                    values[name].add(stream)
                    written[name] += len(stream)
                coming = [stamps[name][count] for name, count in written.items() if count < len(stamps[name])]
                if coming:
                    writer.flush(int(min(coming)) - 1)
            for check in values.values():
                check.finish()
            excerpt = excerpting.finish()
            quality = excerpt.quality.joined(quality_of_order)
            beyond = {streams[name].topic: found for name, found in screening.finish(stamps).items()}
            recording = checked(replace(excerpt, quality=quality), task.vehicle, beyond)
        imported = Imported(
            file.path,
            path,
            len(stamps["imu"]),
            topics,
            {},
            tuple(missing_topics(recording)),
            recording.quality,
        )
        return imported, running.hexdigest()
