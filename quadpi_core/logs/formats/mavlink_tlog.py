# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reader for telemetry logs (.tlog): MAVLink packets, each behind its arrival time in µs since 1970."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np

from quadpi_core.errors import LogError
from quadpi_core.findings import CLOCK_FALLS, NOTHING_TO_SAY, Break, DataQuality, UsedPart
from quadpi_core.flight import ImuStream, OdometryStream, PoseStream, Recording, RotorSpeedStream, Stream
from quadpi_core.frames import Array
from quadpi_core.logs.airframes import Airframe, has_quadrotor
from quadpi_core.logs.clocks import Line, line_below
from quadpi_core.logs.formats import ardupilot, px4
from quadpi_core.logs.log_format import LogFormat
from quadpi_core.logs.mavlink_frames import MARKERS, Frame, FrameCounts, Framer, MessageDecoder, frame_length
from quadpi_core.logs.mavlink_samples import (
    ARDUPILOT,
    PX4,
    SOURCES,
    MavlinkSamples,
    Sample,
    is_epoch,
    stream_of,
)
from quadpi_core.logs.reader_steps import note, require_imu
from quadpi_core.rotor_order import RPM, RotorOrder
from quadpi_core.vehicle import Vehicle

_STAMP_BYTES = 8
_YEAR_2000_US, _YEAR_2100_US = 946_684_800_000_000, 4_102_444_800_000_000
# Packets overtake each other by less.
_RESTART_US = 10_000_000
# A worse kind of message is taken only if the best one has fewer than this share of its samples.
_FEW = 0.5
_NO_TELEMETRY = {ARDUPILOT: ardupilot.NO_TELEMETRY, PX4: px4.NO_TELEMETRY}


class TlogRecord(NamedTuple):
    """A packet and when it arrived, in ns since 1970."""

    arrival_ns: int
    frame: Frame


@dataclass
class TlogCounts(FrameCounts):
    """Also the bytes that belong to no record."""

    damaged_bytes: int = 0


class _Arrived(NamedTuple):
    sample: Sample
    arrival_ns: int
    sender: tuple[int, int, bool]


def read_records(data: bytes, counts: TlogCounts) -> Iterator[TlogRecord]:
    """The packets of a telemetry log; what is damaged is passed over and counted, and so is a cut end."""
    framer = Framer(counts=counts)
    position = 0
    while position < len(data):
        start = position + _STAMP_BYTES
        length = (frame_length(data, start) or 0) if _is_record(data, position) else 0
        known = counts.frames + counts.unknown
        frame = framer.packet(data[start : start + length])
        if counts.frames + counts.unknown == known:
            counts.damaged_bytes += 1
            position += 1
            continue
        if frame is not None:
            arrival_ns = int.from_bytes(data[position:start], "big") * 1000
            yield TlogRecord(arrival_ns, frame)
        position = start + length


def _is_record(data: bytes, position: int) -> bool:
    """Whether a plausible stamp and the first byte of a packet are there."""
    if len(data) <= position + _STAMP_BYTES or data[position + _STAMP_BYTES] not in MARKERS:
        return False
    return (
        _YEAR_2000_US < int.from_bytes(data[position : position + _STAMP_BYTES], "big") & ~0x3 < _YEAR_2100_US
    )


def read_tlog(path: Path, vehicle: Vehicle | None, order: RotorOrder | None = None) -> Recording:
    """Read a telemetry log by the clock of the computer that wrote it.

    Stamps of the autopilot are moved to that clock by the line that no message arrives before; messages
    without a stamp have their arrival. Of several vehicles the one that sends the most IMU samples is read.

    Args:
        path: the log.
        vehicle: as for every reader.
        order: of the rotors; by default that of PX4's and ArduPilot's standard frame.

    Raises:
        LogError: if it holds no packets, or no IMU samples.
    """
    source = str(path)
    counts = TlogCounts()
    records = list(read_records(path.read_bytes(), counts))
    if not records:
        raise LogError(f"{source}: byte 0: no MAVLink packet in the whole file")
    if counts.damaged_bytes:
        note(
            source,
            f"{counts.damaged_bytes} bytes are passed over: the file is damaged, or cut off at its end",
        )
    if order is None:
        order = RotorOrder.by_layout(vehicle, "quad-x", RPM)
    arrived, quality, samples = _decode(source, records, MavlinkSamples(vehicle, order))
    unusable = samples.unusable
    for refusal, count in samples.refused.items():
        if any(reason in refusal for reason in unusable.by_reason):
            continue
        note(source, f"{count} messages not used, {refusal}")
    clocks = _clocks(arrived)
    mav_type = samples.vehicle_type or 0
    is_quadrotor = has_quadrotor(source, Airframe.of_mav_type(f"MAV_TYPE {mav_type}", mav_type))
    imu, rotors, pose, odometry = (_stream(topic, arrived, clocks) for topic in SOURCES)
    imu = require_imu(source, cast("ImuStream | None", imu), "HIGHRES_IMU, RAW_IMU or SCALED_IMU")
    left_out = tuple(unusable.left_out("rotor_speeds", int(imu.time_ns[0]))) if is_quadrotor else ()
    return Recording(
        name=path.stem,
        vehicle=vehicle.name if vehicle else "",
        source=source,
        imu=imu,
        rotor_speeds=_telling(source, rotors, samples) if is_quadrotor else None,
        pose=cast("PoseStream | None", pose),
        odometry=cast("OdometryStream | None", odometry),
        quality=quality.joined(DataQuality(left_out=left_out)),
    )


def _telling(source: str, rotors: Stream | None, samples: MavlinkSamples) -> RotorSpeedStream | None:
    """The rotor speeds, unless all of them are 0."""
    if not isinstance(rotors, RotorSpeedStream) or np.any(rotors.speeds):
        return cast("RotorSpeedStream | None", rotors)
    remedy = _NO_TELEMETRY.get(samples.autopilot or 0, "no telemetry")
    note(source, f"topic rotor_speeds: left out, every rpm is zero: {remedy}")
    return None


def _decode(
    source: str, records: list[TlogRecord], samples: MavlinkSamples
) -> tuple[list[_Arrived], DataQuality, MavlinkSamples]:
    """All samples of the vehicle with the most IMU messages."""
    decoder = MessageDecoder()
    messages = [(record, decoder.decode(record.frame)) for record in records]
    imus = Counter(
        record.frame.system for record, message in messages if type(message).__name__ in SOURCES["imu"]
    )
    if not imus:
        return [], NOTHING_TO_SAY, samples
    if len(imus) > 1:
        note(source, f"holds {len(imus)} vehicles; read is system {imus.most_common(1)[0][0]}")
    system = imus.most_common(1)[0][0]
    arrived = []
    others: Counter[str] = Counter()
    for record, message in messages:
        if record.frame.system != system:
            others[type(message).__name__] += 1
            continue
        sample = samples.decode(message, record.arrival_ns * 1e-9)
        if sample is not None:
            since_1970 = sample.clock_us is not None and is_epoch(sample.clock_us)
            sender = (record.frame.system, record.frame.component, since_1970)
            arrived.append(_Arrived(sample, record.arrival_ns, sender))
    for name in sorted(others.keys() & samples.names - {"HEARTBEAT"}):
        note(source, f"{others[name]} {name} of other systems not used")
    longest, quality = _longest_run(arrived)
    return longest, quality, samples


def _longest_run(arrived: list[_Arrived]) -> tuple[list[_Arrived], DataQuality]:
    """The samples between two restarts of the autopilot's clock, where the log has the most of them."""
    runs: list[list[_Arrived]] = [[]]
    latest_us: dict[tuple[int, int, bool], int] = {}
    falls: list[tuple[int, float, float]] = []
    imu_samples = 0
    for one in arrived:
        clock_us = one.sample.clock_us
        if clock_us is not None:
            before_us = latest_us.get(one.sender, 0)
            if clock_us < before_us - _RESTART_US:
                falls.append((imu_samples, 1e-6 * before_us, 1e-6 * clock_us))
                runs.append([])
                latest_us.clear()
            latest_us[one.sender] = clock_us
        imu_samples += one.sample.topic == "imu"
        runs[-1].append(one)
    longest = max(runs, key=len)
    if not falls:
        return longest, NOTHING_TO_SAY
    lengths_s = [1e-9 * (run[-1].arrival_ns - run[0].arrival_ns) for run in runs]
    used = UsedPart(
        from_s=0.0,
        to_s=lengths_s[runs.index(longest)],
        imu_samples=sum(one.sample.topic == "imu" for one in longest),
        of_s=sum(lengths_s),
        reason=f"the longest of {len(runs)} runs",
    )
    return longest, DataQuality(breaks=(Break("imu", CLOCK_FALLS, len(falls), *falls[0]),), used=(used,))


def _clocks(arrived: list[_Arrived]) -> dict[tuple[int, int, bool], Line]:
    """The line of each sender's clock."""
    stamped = [one for one in arrived if one.sample.clock_us is not None]
    lines = {}
    for sender in {one.sender for one in stamped}:
        pairs = np.array(
            [(one.sample.clock_us, one.arrival_ns) for one in stamped if one.sender == sender], dtype=np.int64
        )
        lines[sender] = line_below(pairs[:, 0] * 1000, pairs[:, 1])
    return lines


def _stream(topic: str, arrived: list[_Arrived], clocks: dict[tuple[int, int, bool], Line]) -> Stream | None:
    """The stream of a topic from the best kind of message that is there in number."""
    mine = [one for one in arrived if one.sample.topic == topic]
    counted = Counter(one.sample.source for one in mine)
    if not counted:
        return None
    most = max(counted.values())
    chosen = next(name for name in SOURCES[topic] if counted[name] >= _FEW * most)
    rows: list[Array] = []
    stamps: list[int] = []
    for sample, arrival_ns, sender in mine:
        if sample.source == chosen:
            rows.append(sample.values)
            clock_us = sample.clock_us
            stamps.append(
                arrival_ns
                if clock_us is None
                else int(clocks[sender].to_local(np.array([clock_us * 1000]))[0])
            )
    return stream_of(topic, np.array(stamps, dtype=np.int64), np.array(rows))


FORMAT = LogFormat(
    description="MAVLink telemetry log (.tlog)",
    read=read_tlog,
    begins=lambda head: _is_record(head, 0),
    suffixes=(".tlog",),
    load_mapping=RotorOrder.load,
    remedies={
        "imu": "SRn_RAW_SENS of ArduPilot, or MAV_CMD_SET_MESSAGE_INTERVAL, sends it more often",
        "rotor_speeds": "MAV_CMD_SET_MESSAGE_INTERVAL sends ESC_STATUS more often",
        "odometry": "SRn_EXTRA1 and SRn_POSITION of ArduPilot, MAV_CMD_SET_MESSAGE_INTERVAL of any",
        "mocap/pose": "raise the rate at which motion capture is sent",
    },
)
