# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What is damaged: a few small files of every format, how each falls into records, and what then reads it."""

from __future__ import annotations

import hashlib
import io
import json
import random
import shutil
import struct
import sys
import zlib
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, fields, replace
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import scipy.io
from backports import zstd
from rich.console import Console
from rosbags import rosbag1
from rosbags.rosbag2 import StoragePlugin, Writer

from benchmarks.fuzzing import flight_logs
from benchmarks.fuzzing.api_calls import GOLDEN_MODEL, make_call, read_call
from benchmarks.fuzzing.message_readers import UNPACKERS, sound_message
from benchmarks.fuzzing.mutation import Finding, Split, change_bytes, mutate, mutate_json, mutate_text
from quadpi_core import cli
from quadpi_core.discrepancy.loading import load_simulation
from quadpi_core.flight import ImuStream, OdometryStream, PoseStream, Recording, RotorSpeedStream, WindStream
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.logs import read_recording
from quadpi_core.logs.bag_topics import topic_stamps
from quadpi_core.logs.bags import read_outputs, write_bag
from quadpi_core.logs.mapping import Mapping
from quadpi_core.logs.mavlink_session import MavlinkSession, SessionSettings
from quadpi_core.logs.mcap_files import CHUNK, MAGIC, METADATA, SCHEMA, records_of
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.adapters import AdapterSettings
from quadpi_core.messages.definitions import typestore
from quadpi_core.messages.payloads import Payloads
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.model_folder import ARRAYS_FILE, MODEL_FILE
from quadpi_core.models.regressors import load_pools
from quadpi_core.paths import config_directory
from quadpi_core.report.info_tables import describe
from quadpi_core.rotor_order import RPM, RotorOrder
from quadpi_core.screening.plausibility import check_plausible
from quadpi_core.simulation.flying import SimulatedVehicle
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.simulation.sensor_noise import SensorSuite
from quadpi_core.vehicle import Vehicle

_SAMPLES = 12
_TABLE_ROWS = 20
_START_NS = 1_700_000_000_000_000_000
# What a reader lets pass: no value larger, no flight longer than two days.
_LARGEST = 1e6
_LONGEST_NS = 2 * 86_400 * 10**9


@dataclass(frozen=True)
class Format:
    """One kind of input.

    Attributes:
        name: of the format.
        share: of all cases.
        make: gives the damaged bytes of a case.
        read: reads them from a file, or a folder that it makes beside it; a QuadpiError refuses them.
        suffix: of the file.
        names_file: whether a refusal must name the file.
    """

    name: str
    share: float
    make: Callable[[random.Random], bytes]
    read: Callable[[Path, int], object]
    suffix: str
    names_file: bool = True


@cache
def _vehicle() -> Vehicle:
    return replace(Vehicle.load("neurobem"), pole_pairs=7, rotor_speed_max_rad_s=2500.0)


def _recording(samples: int = _SAMPLES) -> Recording:
    flown = flight_logs.hover(samples)
    time_ns = _START_NS + (flown.time_us - flown.time_us[0]) * 1000
    speeds = flown.rpm * (2.0 * np.pi / 60.0)
    body = np.zeros((samples, 3))
    return Recording(
        name="flight",
        vehicle="neurobem",
        source="",
        imu=ImuStream(time_ns, flown.rates, flown.force),
        rotor_speeds=RotorSpeedStream(time_ns, speeds),
        pose=PoseStream(time_ns, flown.position, flown.attitude),
        odometry=OdometryStream(time_ns, flown.position, flown.attitude, body, flown.rates),
        wind=WindStream(time_ns, body),
    )


# Checks of what was let pass.


def _require_sane(recording: Recording) -> None:
    for stream in recording.streams():
        if np.ptp(stream.time_ns) > _LONGEST_NS:
            raise Finding(f"topic {stream.topic} spans {np.ptp(stream.time_ns) / 8.64e13:.0f} days")
        for column in fields(stream):
            values = getattr(stream, column.name)
            if values.dtype.kind == "f" and not np.all(np.abs(values) <= _LARGEST):
                raise Finding(f"topic {stream.topic}: {column.name} holds {np.max(np.abs(values)):g}")


def _read_log(path: Path, number: int, mapping: str | None = None) -> None:
    """As `import` does, and every eighth time as `info` does."""
    if number % 8 == 0:
        Console(file=io.StringIO(), markup=False).print(*describe(path, "hdbeetle", mapping)[0])
        return
    recording = read_recording(path, _vehicle(), mapping)
    check_plausible(recording, _vehicle())
    _require_sane(recording)


def _read_bag(path: Path, number: int) -> None:
    readers = (_read_log, lambda path, _: topic_stamps(path), lambda path, _: read_outputs(path), _read_log)
    readers[number % 4](path, number)


def _read_folder(path: Path, number: int) -> None:
    """The bytes are those of metadata.yaml, a line of dashes, and a database."""
    folder = _beside(path)
    metadata, _, database = path.read_bytes().partition(_BORDER)
    (folder / "metadata.yaml").write_bytes(metadata)
    (folder / "flight.db3").write_bytes(database)
    _read_bag(folder, number)


def _beside(path: Path) -> Path:
    """An empty folder with the name of the file in its own: a refusal that names it names the file."""
    folder = path.with_name(f"{path.name}.folder")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    return folder


_BORDER = b"\n-----\n"


# MCAP


def _mcap_records(data: bytes) -> list[bytes]:
    """Magic, records, magic; a chunk that is not compressed falls into its head and its records."""
    pieces, end = [data[: len(MAGIC)]], len(MAGIC)
    for opcode, start, length in records_of(io.BytesIO(data), len(data)):
        record = data[start - 9 : start + length]
        end = start + length
        # Behind opcode and length: times, sizes, checksum, and no name of a compression.
        if opcode == CHUNK and record[37:41] == bytes(4) and len(record) > 49:
            pieces.append(record[:49])
            inner = list(records_of(io.BytesIO(record), len(record), 49))
            pieces += [record[at - 9 : at + size] for _, at, size in inner]
            pieces.append(record[inner[-1][1] + inner[-1][2] if inner else 49 :])
        else:
            pieces.append(record)
    return [*pieces, data[end:]]


def _unpacked_mcap(data: bytes) -> bytes:
    """The bag with its chunks not compressed and its checksums not computed: damage gets through."""
    found = list(records_of(io.BytesIO(data), len(data)))
    chunks = []
    for start, length in ((start, length) for opcode, start, length in found if opcode == CHUNK):
        chunk = data[start : start + length]
        content = zstd.decompress(chunk[28 + 4 + len("zstd") + 8 :])
        body = chunk[:24] + bytes(8) + struct.pack("<Q", len(content)) + content
        chunks.append(struct.pack("<BQ", CHUNK, len(body)) + body)
    head = [
        data[start - 9 : start + length]
        for opcode, start, length in found
        if opcode in {_HEADER, SCHEMA, _CHANNEL, METADATA}
    ]
    # Without a summary: rosbags then counts what is in the chunks.
    end = struct.pack("<BQ", _DATA_END, 4) + bytes(4) + struct.pack("<BQ", _FOOTER, 20) + bytes(20)
    return MAGIC + b"".join(dict.fromkeys(head)) + b"".join(chunks) + end + MAGIC


_HEADER, _FOOTER, _CHANNEL, _DATA_END = 0x01, 0x02, 0x04, 0x0F


def _without_summary_checksum(data: bytes) -> bytes:
    return data[: -4 - len(MAGIC)] + bytes(4) + data[-len(MAGIC) :]


@cache
def _mcap_seeds() -> list[bytes]:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "flight.mcap"
        write_bag(path, _recording())
        packed = path.read_bytes()
    return [_without_summary_checksum(packed), _unpacked_mcap(packed), _unpacked_mcap(packed)]


def _few_messages() -> list[tuple[str, str, list[int], Payloads]]:
    """Topic, type, log times and messages of two sensors."""
    recording = _recording(6)
    imu, rotors = recording.imu, recording.rotor_speeds
    assert rotors is not None
    packed = sensor_messages.pack_rotor_speeds(rotors)
    return [
        ("/imu", sensor_messages.IMU, imu.time_ns.tolist(), sensor_messages.pack_imu(imu)),
        ("/rotor_speeds", sensor_messages.ROTOR_SPEEDS, rotors.time_ns.tolist(), packed),
    ]


@cache
def _folder_seeds() -> list[bytes]:
    with TemporaryDirectory() as folder:
        with Writer(Path(folder) / "bag", version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
            for name, type_name, times, payloads in _few_messages():
                connection = writer.add_connection(name, type_name, typestore=typestore())
                for time_ns, payload in zip(times, payloads, strict=True):
                    writer.write(connection, time_ns, payload)
        made = Path(folder) / "bag"
        metadata = (made / "metadata.yaml").read_bytes().replace(b"bag.db3", b"flight.db3")
        return [metadata + _BORDER + (made / "bag.db3").read_bytes()]


def _damaged_folder(rng: random.Random) -> bytes:
    (seed,) = _folder_seeds()
    metadata, _, database = seed.partition(_BORDER)
    if rng.random() < 0.4:
        metadata = mutate_text(rng, metadata, [metadata])
    else:
        database = mutate(rng, database, _pages, [database])
    return metadata + _BORDER + database


def _databases() -> list[bytes]:
    return [_folder_seeds()[0].partition(_BORDER)[2]]


@cache
def _ros1_seeds() -> list[bytes]:
    seeds = []
    with TemporaryDirectory() as folder:
        for number, packing in enumerate((None, None, *rosbag1.Writer.CompressionFormat)):
            path = Path(folder) / f"{number}.bag"
            writer = rosbag1.Writer(path)
            if packing is not None:
                writer.set_compression(packing)
            with writer:
                for name, type_name, times, payloads in _few_messages():
                    connection = writer.add_connection(name, type_name, typestore=typestore())
                    for time_ns, payload in zip(times, payloads, strict=True):
                        message = bytes(typestore().cdr_to_ros1(payload, type_name))
                        writer.write(connection, time_ns, message)
            seeds.append(path.read_bytes())
    return seeds


def _ros1_records(data: bytes) -> list[bytes]:
    """The first line, then headers and data in turn, each with its length in front."""
    border = data.find(b"\n") + 1
    pieces, at = [data[:border]], border
    while at + 4 <= len(data):
        size = 4 + int.from_bytes(data[at : at + 4], "little")
        pieces.append(data[at : at + size])
        at += size
    return [*pieces, data[at:]]


def _pages(data: bytes) -> list[bytes]:
    return [data[at : at + 4096] for at in range(0, len(data), 4096)]


# Messages


@cache
def _message_seeds() -> dict[str, bytes]:
    return {type_name: sound_message(type_name) for type_name in UNPACKERS}


def _damaged_message(rng: random.Random) -> bytes:
    type_name = rng.choice(sorted(UNPACKERS))
    good = _message_seeds()[type_name]
    return type_name.encode() + b"\n" + mutate(rng, good, _words, [good])


def _words(data: bytes) -> list[bytes]:
    return [data[at : at + 4] for at in range(0, len(data), 4)]


def _read_message(path: Path, number: int) -> None:
    name, _, payload = path.read_bytes().partition(b"\n")
    type_name = name.decode()
    unpack, good = UNPACKERS[type_name], _message_seeds()[type_name]
    unpack(payload if number % 2 else Payloads.join([good, payload, good]))


# MAVLink


@cache
def _packets() -> list[bytes]:
    data = flight_logs.tlog(flight_logs.hover(8))
    return [packet[8:] for packet in _tlog_records(data)] + [
        flight_logs.Sender().packet("HEARTBEAT", 2, 12, 0, 0, 4, 3),
        flight_logs.Sender().packet("TIMESYNC", 0, _START_NS),
    ]


def _tlog_records(data: bytes) -> list[bytes]:
    """Stamp and packet, by the lengths that the packets say."""
    records, at = [], 0
    while at < len(data):
        size = 8 + (data[at + 9] if at + 9 < len(data) else 0) + 12
        records.append(data[at : at + size])
        at += size
    return records


@cache
def _kinds() -> list[Any]:
    sender = flight_logs.Sender()
    known = {*MavlinkSession(None, _rotor_order(), SessionSettings())._samples.names, "TIMESYNC"}
    return [kind for name, kind in sorted(sender.kinds.items()) if name in known]


@cache
def _rotor_order() -> RotorOrder:
    return RotorOrder.by_layout(_vehicle(), "quad-x", RPM)


def _packet(rng: random.Random) -> bytes:
    """A packet with a right checksum and any payload, or a sound one."""
    if rng.random() < 0.4:
        return rng.choice(_packets())
    kind = rng.choice(_kinds())
    payload = bytes(kind.unpacker.size)
    for _ in range(rng.choice((0, 1, 2, 4))):
        payload = change_bytes(rng, payload, rng.choice(_packets()))
    return flight_logs.Sender().raw(kind, payload[: rng.choice((255, kind.unpacker.size, 255))][:255])


def _damaged_link(rng: random.Random) -> bytes:
    data = b"".join(_packet(rng) for _ in range(rng.randrange(1, 12)))
    for _ in range(rng.choice((0, 0, 1, 2))):
        data = change_bytes(rng, data, data)
    return data


def _read_link(path: Path, number: int) -> None:
    """As the bridge does: a stream in pieces, or a datagram."""
    data = path.read_bytes()
    session = MavlinkSession(_vehicle(), _rotor_order(), SessionSettings())
    step = len(data) + 1 if number % 2 else 50
    latest: dict[str, int] = {}
    for piece, at in enumerate(range(0, len(data), step)):
        now = _START_NS + piece * 10_000_000
        for topic, time_ns, values in session.take(data[at : at + step], now, complete=bool(number % 2)):
            if not np.all(np.isfinite(values)):
                raise Finding(f"{topic} is not finite")
            if not latest.get(topic, now - 10_000_000_001) < time_ns <= now + 1_000_000_000:
                raise Finding(f"{topic}: the stamp falls, or is far from its arrival")
            latest[topic] = time_ns
        session.due(now)
    session.report(_START_NS)


def _damaged_tlog(rng: random.Random) -> bytes:
    seed = _log_seeds()["tlog"]
    if rng.random() < 0.5:
        return mutate(rng, seed, _tlog_records, [seed])
    records = _tlog_records(seed)
    for _ in range(rng.randrange(1, 8)):
        place = rng.randrange(len(records))
        records[place] = records[place][:8] + _packet(rng)
    return b"".join(records)


# Logs


@cache
def _log_seeds() -> dict[str, bytes]:
    flown = flight_logs.hover(_SAMPLES)
    return {
        "ardupilot": flight_logs.dataflash(flown),
        "px4": flight_logs.ulog(flown),
        "betaflight": flight_logs.blackbox(flown),
        "cfusdlog": flight_logs.cfusdlog(flown),
        "tlog": flight_logs.tlog(flown),
    }


def _log(
    name: str, split: Split, repair: Callable[[bytes], bytes] = lambda data: data
) -> Callable[..., bytes]:
    def make(rng: random.Random) -> bytes:
        seed = _log_seeds()[name]
        damaged = mutate(rng, seed, split, [seed])
        return repair(damaged) if rng.random() < 0.9 else damaged

    return make


def _by_marker(marker: bytes) -> Split:
    def split(data: bytes) -> list[bytes]:
        first, *rest = data.split(marker)
        return [first, *(marker + piece for piece in rest)]

    return split


def _ulog_records(data: bytes) -> list[bytes]:
    records, at = [data[:16]], 16
    while at + 3 <= len(data):
        size = 3 + int.from_bytes(data[at : at + 2], "little")
        records.append(data[at : at + size])
        at += size
    return [*records, data[at:]]


def _blackbox_records(data: bytes) -> list[bytes]:
    """Header lines, then frames as far as a marker tells."""
    border = data.find(b"\nI") + 1
    return [*data[:border].splitlines(keepends=True), *_by_marker(b"I")(data[border:])]


def _cfusdlog_records(data: bytes) -> list[bytes]:
    """The names that end in a zero byte, then records of the length of the seed's."""
    head, at = [], 5
    while at < 120 and (end := data.find(b"\0", at)) >= 0:
        head.append(data[at : end + 1])
        at = end + 1
    return [data[:5], *head, *(data[place : place + 44] for place in range(at, len(data), 44))]


def _with_checksum(data: bytes) -> bytes:
    return data[:-4] + struct.pack("<I", zlib.crc32(data[:-4]))


# MATLAB


@cache
def _matlab_seeds() -> list[bytes]:
    flown = flight_logs.hover(_TABLE_ROWS)
    matrix = np.zeros((_TABLE_ROWS, 41))
    matrix[:, 0] = np.arange(_TABLE_ROWS) / 400.0
    flip = np.array([1.0, -1.0, -1.0])
    matrix[:, 4:7], matrix[:, 11:14] = flown.rates * flip, flown.force * flip
    matrix[:, 10] = 1.0
    matrix[:, 20:24] = flown.rpm * (2.0 * np.pi / 60.0)
    matrix[:, 28] = 160.0
    seeds = []
    for more in ({}, {"other": np.eye(2), "text": "abc"}):
        buffer = io.BytesIO()
        scipy.io.savemat(buffer, {"flight": matrix, **more})
        seeds.append(buffer.getvalue())
    return seeds


def _damaged_matlab(rng: random.Random) -> bytes:
    seed = rng.choice(_matlab_seeds())
    if rng.random() < 0.5:
        return mutate(rng, seed, _matlab_parts, _matlab_seeds())
    # As MATLAB writes it: each variable is packed.
    packed = zlib.compress(mutate(rng, seed[128:], _matlab_parts, [seed[128:]]), 1)
    whole = seed[:128] + struct.pack("<II", 15, len(packed)) + packed
    return change_bytes(rng, whole) if rng.random() < 0.2 else whole


def _matlab_parts(data: bytes) -> list[bytes]:
    """Heads in words of eight bytes, numbers in one piece."""
    return [*(data[at : at + 8] for at in range(0, 256, 8)), data[256:]]


# Tables


@cache
def _table() -> pa.Table:
    mapping = Mapping.load("nanodrone")
    flown = flight_logs.hover(_TABLE_ROWS)
    names = [name for signal in mapping.signals.values() for name in signal.columns]
    columns = {name: np.linspace(0.01, 0.02, _TABLE_ROWS) for name in names}
    (time,) = mapping.signals["time"].columns
    unit = {"s": 1e-6, "ms": 1e-3, "us": 1.0, "ns": 1e3}[str(mapping.signals["time"].unit)]
    columns[time] = flown.time_us * unit
    for name in mapping.signals["rotor_speeds"].columns:
        columns[name] = np.full(_TABLE_ROWS, 120_000.0)
    for signal in ("attitude", "mocap_attitude"):
        if signal in mapping.signals and mapping.signals[signal].unit is None:
            first = mapping.signals[signal].columns[str(mapping.signals[signal].form).index("w")]
            columns[first] = np.ones(_TABLE_ROWS)
    columns[mapping.signals["acceleration"].columns[2]] = np.full(_TABLE_ROWS, 9.8)
    return pa.table(columns)


@cache
def _table_seeds(suffix: str) -> list[bytes]:
    seeds = []
    for options in (
        {"compression": "snappy"},
        {"compression": "none", "use_dictionary": False},
        {"compression": "zstd"},
    ):
        sink = pa.BufferOutputStream()
        if suffix == ".csv":
            pyarrow.csv.write_csv(_table(), sink)
        else:
            pyarrow.parquet.write_table(_table(), sink, **options)
        seeds.append(sink.getvalue().to_pybytes())
    return seeds


def _damaged_parquet(rng: random.Random) -> bytes:
    seeds = _table_seeds(".parquet")
    seed = rng.choice(seeds)
    footer = 8 + int.from_bytes(seed[-8:-4], "little")
    if rng.random() < 0.5:
        return seed[:-footer] + mutate(rng, seed[-footer:-8], None, [seed[-footer:]]) + seed[-8:]
    return mutate(rng, seed, None, seeds)


# Models, configuration, additions


@cache
def _model_files() -> tuple[Any, bytes]:
    content = json.loads((GOLDEN_MODEL / MODEL_FILE).read_text())
    return content, (GOLDEN_MODEL / ARRAYS_FILE).read_bytes()


def _damaged_model(rng: random.Random) -> bytes:
    """model.json, a line of dashes, arrays.safetensors whose hash is put right in nine of ten."""
    content, arrays = _model_files()
    if rng.random() < 0.3:
        head = int.from_bytes(arrays[:8], "little") + 8
        if rng.random() < 0.5:
            arrays = arrays[:8] + mutate_text(rng, arrays[8:head], [arrays[8:head]]) + arrays[head:]
            arrays = struct.pack("<Q", len(arrays) - (len(_model_files()[1]) - head) - 8) + arrays[8:]
        else:
            arrays = mutate(rng, arrays, None, [arrays])
        if rng.random() < 0.9:
            content = {**content, "arrays_sha256": hashlib.sha256(arrays).hexdigest()}
        return json.dumps(content).encode() + _BORDER + arrays
    return mutate_json(rng, content) + _BORDER + arrays


def _read_model(path: Path, number: int) -> None:
    """As every command does, and every eighth time as `info` does."""
    folder = _beside(path)
    text, _, arrays = path.read_bytes().partition(_BORDER)
    (folder / MODEL_FILE).write_bytes(text)
    (folder / ARRAYS_FILE).write_bytes(arrays)
    if number % 8 == 0:
        Console(file=io.StringIO(), markup=False).print(*describe(folder, None, None)[0])
        return
    model = AerodynamicModel.load(folder)
    model.evaluate(np.zeros((2, len(INPUT_NAMES))))
    model.calibration()


_CONFIGURATION: dict[str, Callable[[Path], object]] = {
    "vehicles": Vehicle.load,
    "mappings": Mapping.load,
    "adapters": AdapterSettings.load,
    "candidates": load_pools,
    "scenarios": load_scenario,
    "noise": SensorSuite.load,
}


@cache
def _configuration_seeds(kind: str) -> list[bytes]:
    files = sorted((config_directory() / kind).glob("*.yaml"), key=lambda file: file.stat().st_size)
    return [file.read_bytes() for file in files[:3]]


def _damaged_configuration(rng: random.Random) -> bytes:
    kind = rng.choice(sorted(_CONFIGURATION))
    seeds = _configuration_seeds(kind)
    return kind.encode() + b"\n" + mutate_text(rng, rng.choice(seeds), seeds)


def _read_configuration(path: Path, _: int) -> None:
    name, _separator, text = path.read_bytes().partition(b"\n")
    kind = name.decode()
    own = path.with_name(f"{path.name}.{kind}.yaml")
    own.write_bytes(text)
    _CONFIGURATION[kind](own)
    if kind == "vehicles":
        SimulatedVehicle.load(own)


_ADDITION = {
    "simulation": "bebop2",
    "vehicle": "bebop2",
    "effects": {"body_drag": {}},
    "adjusted": {},
    "version": "1",
}


def _damaged_addition(rng: random.Random) -> bytes:
    return mutate_json(rng, _ADDITION)


def _read_addition(path: Path, _: int) -> None:
    load_simulation(str(path))


# The command line


_COMMANDS = ("ardupilot", "cfusdlog", "px4", "mcap")


def _damaged_for_command(rng: random.Random) -> bytes:
    name = rng.choice(_COMMANDS)
    return name.encode() + b"\n" + FORMATS[name].make(rng)


def _read_by_command(path: Path, number: int) -> None:
    """`info` or `import` in this process: one line and status 2, or status 0."""
    name, _, data = path.read_bytes().partition(b"\n")
    log = path.with_name(f"[red]{number % 2}{FORMATS[name.decode()].suffix}")
    log.write_bytes(data)
    command = ["info", str(log), "--vehicle", "neurobem"]
    if number % 2:
        command = ["import", str(log), "--vehicle", "neurobem", "-o", str(_beside(path))]
    arguments, sys.argv = sys.argv, ["quadpi", *command]
    said, errors, status = io.StringIO(), io.StringIO(), 0
    try:
        with redirect_stdout(said), redirect_stderr(errors):
            cli.main()
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 1
    finally:
        sys.argv = arguments
    if status not in {0, 2} or "Traceback" in errors.getvalue():
        raise Finding(f"{command[0]} ends with status {status}: {errors.getvalue()[-300:]}")
    if status == 2 and (errors.getvalue().count("\n") != 1 or str(log) not in errors.getvalue()):
        raise Finding(f"{command[0]}: not one line that names the file: {errors.getvalue()[:300]!r}")


def _choice_of(seeds: Callable[[], Sequence[bytes]], split: Split | None) -> Callable[[random.Random], bytes]:
    return lambda rng: mutate(rng, rng.choice(seeds()), split, seeds())


def _text_of(seeds: Callable[[], Sequence[bytes]]) -> Callable[[random.Random], bytes]:
    return lambda rng: mutate_text(rng, rng.choice(seeds()), seeds())


FORMATS = {
    one.name: one
    for one in (
        Format("mcap", 0.05, _choice_of(_mcap_seeds, _mcap_records), _read_bag, ".mcap"),
        Format("folder", 0.03, _damaged_folder, _read_folder, ".folder"),
        Format("db3", 0.02, _choice_of(_databases, _pages), _read_bag, ".db3"),
        Format("ros1", 0.03, _choice_of(_ros1_seeds, _ros1_records), _read_bag, ".bag"),
        Format("message", 0.20, _damaged_message, _read_message, ".cdr", names_file=False),
        Format("mavlink", 0.12, _damaged_link, _read_link, ".mavlink", names_file=False),
        Format("tlog", 0.03, _damaged_tlog, _read_log, ".tlog"),
        Format("ardupilot", 0.07, _log("ardupilot", _by_marker(b"\xa3\x95")), _read_log, ".bin"),
        Format("px4", 0.03, _log("px4", _ulog_records), _read_log, ".ulg"),
        Format("betaflight", 0.03, _log("betaflight", _blackbox_records), _read_log, ".bbl"),
        Format("cfusdlog", 0.10, _log("cfusdlog", _cfusdlog_records, _with_checksum), _read_log, ".cf"),
        Format("matlab", 0.10, _damaged_matlab, _read_log, ".mat"),
        Format(
            "csv",
            0.05,
            _text_of(lambda: _table_seeds(".csv")),
            partial(_read_log, mapping="nanodrone"),
            ".csv",
        ),
        Format("parquet", 0.03, _damaged_parquet, partial(_read_log, mapping="nanodrone"), ".parquet"),
        Format("model", 0.04, _damaged_model, _read_model, ".model"),
        Format("configuration", 0.05, _damaged_configuration, _read_configuration, ".yaml"),
        Format("addition", 0.019, _damaged_addition, _read_addition, ".json"),
        Format("api", 0.05, make_call, read_call, ".call", names_file=False),
        Format("command", 0.001, _damaged_for_command, _read_by_command, ".command", names_file=False),
    )
}
