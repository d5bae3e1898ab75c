# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reader for telemetry logs (.tlog): MAVLink packets, each behind its arrival time in µs since 1970."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from quadpi_core import flight
from quadpi_core.errors import LogError
from quadpi_core.findings import CLOCK_FALLS, NOTHING_TO_SAY, Break, DataQuality, UsedPart
from quadpi_core.logs.clocks import line_below
from quadpi_core.logs.formats import ardupilot, px4
from quadpi_core.logs.log_format import LogFormat
from quadpi_core.logs.mavlink_frames import PACKET_BEGIN, Framer, packet_length
from quadpi_core.logs.mavlink_samples import (
    ARDUPILOT,
    BESIDE,
    PX4,
    SOURCES,
    MavlinkSamples,
    Sample,
    is_epoch,
    stream_of,
)
from quadpi_core.logs.reader_steps import Airframe, by_frame, has_rotors, note, require_imu
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
    """A message of pymavlink and when it arrived, in ns since 1970."""

    arrival_ns: int
    message: Any


class _Arrived(NamedTuple):
    """A sample, when it arrived, and the clock of its stamp: component, and whether it counts from 1970."""

    sample: Sample
    arrival_ns: int
    clock: tuple[int, bool] | None


def read_records(path: Path) -> Iterator[TlogRecord]:
    """The messages of a telemetry log; damaged bytes, and a cut end, are passed over and noted.

    Raises:
        LogError: if there is no packet.
    """
    data, framer = path.read_bytes(), Framer()
    position = damaged = 0
    while position < len(data):
        start = position + _STAMP_BYTES
        end = start + packet_length(data, start)
        messages: list[Any] = []
        if (
            end <= len(data)
            and _is_record(data, position)
            and framer.read(bytearray(data[start:end]), messages)
        ):
            arrival_ns = int.from_bytes(data[position:start], "big") * 1000
            yield from (TlogRecord(arrival_ns, message) for message in messages)
            position = end
        else:
            damaged += 1
            position += 1
    if not framer.counts.frames:
        raise LogError(f"{path}: byte 0: no MAVLink packet in the whole file")
    if damaged:
        note(str(path), f"{damaged} bytes are passed over: the file is damaged, or cut off at its end")


def _is_record(data: bytes, position: int) -> bool:
    """Whether a plausible stamp and the first byte of a packet are there."""
    start = position + _STAMP_BYTES
    stamp_us = int.from_bytes(data[position:start], "big") & ~0x3
    return _YEAR_2000_US < stamp_us < _YEAR_2100_US and PACKET_BEGIN.match(data, start) is not None


def read_tlog(path: Path, vehicle: Vehicle | None, order: RotorOrder | None = None) -> flight.Recording:
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
    if order is None:
        order = by_frame(source, vehicle, unit=RPM)
    samples, arrived = _decode(path, lambda: MavlinkSamples(vehicle, order))
    arrived, quality = _longest_run(arrived)
    time_ns = _stamps(arrived)
    unusable = samples.unusable
    for refusal, count in samples.refused.items():
        if any(reason in refusal for reason in unusable.by_reason):
            continue
        note(source, f"{count} messages not used, {refusal}")
    mav_type = samples.vehicle_type or 0
    its_rotors = has_rotors(source, Airframe.of_mav_type(f"MAV_TYPE {mav_type}", mav_type), vehicle)
    imu, rotors, pose, odometry = (_stream(topic, arrived, time_ns) for topic in SOURCES)
    commands, battery, pressure = (_stream(topic, arrived, time_ns) for topic in BESIDE)
    imu = require_imu(source, cast("flight.ImuStream | None", imu), "HIGHRES_IMU, RAW_IMU or SCALED_IMU")
    left_out = tuple(unusable.left_out("rotor_speeds", int(imu.time_ns[0]))) if its_rotors else ()
    # The adapter whose commands have the same scale.
    scale = ardupilot.RC_OUT if samples.autopilot == ARDUPILOT else "px4_outputs"
    return flight.Recording(
        name=path.stem,
        vehicle=vehicle.name if vehicle else "",
        source=source,
        imu=imu,
        rotor_speeds=_telling(source, rotors, samples) if its_rotors else None,
        pose=cast("flight.PoseStream | None", pose),
        odometry=cast("flight.OdometryStream | None", odometry),
        commands=cast("flight.MotorCommandStream | None", commands) if its_rotors else None,
        command_source=scale if commands is not None and its_rotors else "",
        battery=cast("flight.BatteryStream | None", battery),
        pressure=cast("flight.AirStream | None", pressure),
        board_air=True,
        quality=quality.joined(DataQuality(left_out=left_out)),
    )


def _telling(
    source: str, rotors: flight.Stream | None, samples: MavlinkSamples
) -> flight.RotorSpeedStream | None:
    """The rotor speeds, unless all of them are 0."""
    if not isinstance(rotors, flight.RotorSpeedStream) or np.any(rotors.speeds):
        return cast("flight.RotorSpeedStream | None", rotors)
    remedy = _NO_TELEMETRY.get(samples.autopilot or 0, "no telemetry")
    note(source, f"topic rotor_speeds: left out, every rpm is zero: {remedy}")
    return None


def _decode(path: Path, begin: Callable[[], MavlinkSamples]) -> tuple[MavlinkSamples, list[_Arrived]]:
    """All samples of the vehicle with the most IMU messages, and what decoded them."""
    vehicles: dict[int, tuple[MavlinkSamples, list[_Arrived]]] = defaultdict(lambda: (begin(), []))
    sent: Counter[tuple[int, str]] = Counter()
    for arrival_ns, message in read_records(path):
        system = message.get_srcSystem()
        sent[system, message.get_type()] += 1
        samples, arrived = vehicles[system]
        sample = samples.decode(message, arrival_ns * 1e-9)
        if sample is not None:
            component, stamp_us = message.get_srcComponent(), sample.clock_us
            clock = None if stamp_us is None else (component, is_epoch(stamp_us))
            arrived.append(_Arrived(sample, arrival_ns, clock))
    imus: Counter[int] = Counter()
    for (system, name), count in sent.items():
        if name in SOURCES["imu"]:
            imus[system] += count
    if not imus:
        return begin(), []
    ((system, _),) = imus.most_common(1)
    if len(imus) > 1:
        note(str(path), f"holds {len(imus)} vehicles; read is system {system}")
    for name in sorted(begin().names - {"HEARTBEAT"}):
        if count := sum(sent[other, name] for other in vehicles if other != system):
            note(str(path), f"{count} {name} of other systems not used")
    return vehicles[system]


def _longest_run(arrived: list[_Arrived]) -> tuple[list[_Arrived], DataQuality]:
    """The samples between two restarts of the autopilot's clock, where the log has the most of them."""
    runs: list[list[_Arrived]] = [[]]
    latest_us: dict[tuple[int, bool] | None, int] = {}
    falls: list[tuple[int, float, float]] = []
    imu_samples = 0
    for one in arrived:
        clock_us = one.sample.clock_us
        if clock_us is not None:
            before_us = latest_us.get(one.clock, 0)
            if clock_us < before_us - _RESTART_US:
                falls.append((imu_samples, 1e-6 * before_us, 1e-6 * clock_us))
                runs.append([])
                latest_us.clear()
            latest_us[one.clock] = clock_us
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


def _stamps(arrived: list[_Arrived]) -> flight.Stamps:
    """The stamp (N,) of each sample, by the clock of the computer that wrote the log."""
    time_ns = np.array([one.arrival_ns for one in arrived], dtype=np.int64)
    for clock in {one.clock for one in arrived} - {None}:
        stamped = np.array([one.clock == clock for one in arrived])
        stamps_us = [one.sample.clock_us for one in arrived if one.clock == clock]
        remote_ns = np.array(stamps_us, dtype=np.int64) * 1000
        time_ns[stamped] = line_below(remote_ns, time_ns[stamped]).to_local(remote_ns)
    return time_ns


def _stream(topic: str, arrived: list[_Arrived], time_ns: flight.Stamps) -> flight.Stream | None:
    """The stream of a topic from the best kind of message that is there in number."""
    counted = Counter(one.sample.source for one in arrived if one.sample.topic == topic)
    if not counted:
        return None
    most = max(counted.values())
    chosen = next(name for name in (SOURCES | BESIDE)[topic] if counted[name] >= _FEW * most)
    rows = [row for row, one in enumerate(arrived) if one.sample[:2] == (topic, chosen)]
    return stream_of(topic, time_ns[rows], np.array([arrived[row].sample.values for row in rows]))


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
