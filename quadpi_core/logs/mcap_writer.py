# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Writing MCAP bags from arrays (https://mcap.dev/spec, profile ros2).

The place of every message is computed before anything is copied, so that there is no Python loop over
messages. Equal input gives equal bytes.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt
from lz4 import frame as lz4

from quadpi_core import __version__
from quadpi_core.errors import LogError
from quadpi_core.flight import Stamps
from quadpi_core.logs.definitions import definition_text, typestore
from quadpi_core.logs.mcap import CHUNK, MAGIC, MESSAGE, MESSAGE_HEADER, METADATA, Topic
from quadpi_core.logs.payloads import Bytes, Indices, Payloads, copy_spans
from quadpi_core.paths import whole_output

_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE_INDEX = 0x01, 0x02, 0x03, 0x04, 0x07
_CHUNK_INDEX, _STATISTICS, _METADATA_INDEX, _SUMMARY_OFFSET, _DATA_END = 0x08, 0x0B, 0x0D, 0x0E, 0x0F
_RECORD_HEADER = np.dtype([("opcode", "u1"), ("length", "<u8"), *MESSAGE_HEADER.descr])
_INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])
_FOOTER_LENGTH = 20
_CHUNK_BYTES = 1 << 20
_COMPRESSION = "lz4"
# Seconds of a ROS stamp are signed 32-bit numbers.
_STAMP_END_NS = 2**31 * 10**9


def write_mcap(path: Path, topics: Sequence[Topic], metadata: Mapping[str, str]) -> None:
    """Write a bag that appears whole or not at all.

    Args:
        path: file to write, replaced if it exists.
        topics: messages per topic, of types that `definitions` knows.
        metadata: entries of the metadata record "quadpi".

    Raises:
        LogError: if the path does not end in .mcap, and for log times that ROS stamps cannot hold.
        OutputError: if the file cannot be written.
    """
    if path.suffix != ".mcap":
        raise LogError(f"{path}: a bag is written to a file that ends in .mcap")
    for topic in topics:
        foreign = (topic.log_time_ns < 0) | (topic.log_time_ns >= _STAMP_END_NS)
        if np.any(foreign):
            sample = int(np.argmax(foreign))
            reason = "the stamp is before 1970 or after 2038"
            raise LogError(f"{path}: topic {topic.name}: sample {sample}: {reason}")
    with whole_output(path) as temporary, temporary.open("wb") as stream:
        _write(stream, topics, metadata)


def _write(stream: BinaryIO, topics: Sequence[Topic], metadata: Mapping[str, str]) -> None:
    stream.write(MAGIC + _record(_HEADER, _string("ros2") + _string(f"quadpi {__version__}")))
    types = list(dict.fromkeys(topic.type_name for topic in topics))
    schemas = b"".join(_schema(number, name) for number, name in enumerate(types, start=1))
    channels = b"".join(
        _channel(number, types.index(topic.type_name) + 1, topic) for number, topic in enumerate(topics)
    )
    stream.write(schemas + channels)
    chunks = [_write_chunk(stream, chunk) for chunk in _chunks(topics)]
    metadata_start = stream.tell()
    metadata_record = _record(METADATA, _string("quadpi") + _string_map(metadata))
    stream.write(metadata_record)
    stream.write(_record(_DATA_END, struct.pack("<I", 0)))
    metadata_place = struct.pack("<QQ", metadata_start, len(metadata_record))
    groups = {
        _SCHEMA: schemas,
        _CHANNEL: channels,
        _CHUNK_INDEX: b"".join(chunks),
        _METADATA_INDEX: _record(_METADATA_INDEX, metadata_place + _string("quadpi")),
        _STATISTICS: _statistics(topics, len(types), len(chunks)),
    }
    stream.write(_summary(groups, start=stream.tell()) + MAGIC)


def _summary(groups: Mapping[int, bytes], start: int) -> bytes:
    """Summary section, offsets of its groups and footer; `start` is where it stands in the file."""
    offsets = b""
    position = start
    for opcode, group in groups.items():
        if group:
            offsets += _record(_SUMMARY_OFFSET, struct.pack("<BQQ", opcode, position, len(group)))
        position += len(group)
    checked = b"".join(groups.values()) + offsets
    checked += struct.pack("<BQQQ", _FOOTER, _FOOTER_LENGTH, start, position)
    return checked + struct.pack("<I", zlib.crc32(checked))


@dataclass(frozen=True)
class _Chunk:
    """Message records of one chunk, with channel, log time and offset of each."""

    records: Bytes
    channel: npt.NDArray[np.uint16]
    log_time_ns: Stamps
    offsets: Indices


def _chunks(topics: Sequence[Topic]) -> Iterator[_Chunk]:
    """Merge the topics by log time, frame each message as a record, and cut the records into chunks."""
    if not any(len(topic.payloads) for topic in topics):
        return
    log_time_ns = np.concatenate([topic.log_time_ns for topic in topics])
    order = np.argsort(log_time_ns, kind="stable")
    lengths = np.concatenate([topic.payloads.lengths for topic in topics])
    sizes = lengths[order] + _RECORD_HEADER.itemsize
    starts = np.empty_like(sizes)
    starts[order] = np.cumsum(sizes) - sizes

    headers = np.zeros(len(order), dtype=_RECORD_HEADER)
    headers["opcode"] = MESSAGE
    headers["length"] = lengths + MESSAGE_HEADER.itemsize
    headers["channel"] = np.repeat(np.arange(len(topics)), [len(topic.payloads) for topic in topics])
    headers["sequence"] = np.concatenate([np.arange(len(topic.payloads)) for topic in topics])
    headers["log_time"] = headers["publish_time"] = log_time_ns

    data = np.empty(int(sizes.sum()), dtype=np.uint8)
    framed = Payloads.from_rows(headers.view(np.uint8).reshape(len(headers), -1))
    copy_spans(framed.data, framed.starts, data, starts, framed.lengths)
    payload_starts = starts + _RECORD_HEADER.itemsize
    first = 0
    for topic in topics:
        own = slice(first, first + len(topic.payloads))
        copy_spans(
            topic.payloads.data, topic.payloads.starts, data, payload_starts[own], topic.payloads.lengths
        )
        first = own.stop

    starts = starts[order]
    cuts = np.flatnonzero(np.diff(starts // _CHUNK_BYTES)) + 1
    for rows in np.split(np.arange(len(order)), cuts):
        begin, last = starts[rows[0]], rows[-1]
        yield _Chunk(
            data[begin : starts[last] + sizes[last]],
            headers["channel"][order[rows]],
            log_time_ns[order[rows]],
            starts[rows] - begin,
        )


def _write_chunk(stream: BinaryIO, chunk: _Chunk) -> bytes:
    """Write a chunk and its message indexes; return its record for the chunk index."""
    compressed = lz4.compress(chunk.records, store_size=False)
    span = struct.pack("<QQ", chunk.log_time_ns[0], chunk.log_time_ns[-1])
    checksum = struct.pack("<QI", len(chunk.records), zlib.crc32(chunk.records.data))
    content = struct.pack("<Q", len(compressed)) + compressed
    start = stream.tell()
    stream.write(_record(CHUNK, span + checksum + _string(_COMPRESSION) + content))
    length = stream.tell() - start
    index_offsets = b""
    for channel in np.unique(chunk.channel):
        own = chunk.channel == channel
        entries = np.empty(int(own.sum()), dtype=_INDEX_ENTRY)
        entries["log_time"], entries["offset"] = chunk.log_time_ns[own], chunk.offsets[own]
        index_offsets += struct.pack("<HQ", channel, stream.tell())
        stream.write(_record(_MESSAGE_INDEX, struct.pack("<H", channel) + _sized(entries.tobytes())))
    index_length = stream.tell() - start - length
    return _record(
        _CHUNK_INDEX,
        span
        + struct.pack("<QQ", start, length)
        + _sized(index_offsets)
        + struct.pack("<Q", index_length)
        + _string(_COMPRESSION)
        + struct.pack("<QQ", len(compressed), len(chunk.records)),
    )


def _statistics(topics: Sequence[Topic], schemas: int, chunks: int) -> bytes:
    counts = [len(topic.payloads) for topic in topics]
    times = np.concatenate([np.empty(0, np.int64), *(topic.log_time_ns for topic in topics)])
    span = (int(times.min()), int(times.max())) if len(times) else (0, 0)
    totals = struct.pack("<QHIIIIQQ", sum(counts), schemas, len(topics), 0, 1, chunks, *span)
    per_channel = b"".join(struct.pack("<HQ", channel, count) for channel, count in enumerate(counts))
    return _record(_STATISTICS, totals + _sized(per_channel))


def _schema(number: int, type_name: str) -> bytes:
    text = definition_text(type_name).encode()
    return _record(
        _SCHEMA, struct.pack("<H", number) + _string(type_name) + _string("ros2msg") + _sized(text)
    )


def _channel(number: int, schema: int, topic: Topic) -> bytes:
    metadata = {
        "offered_qos_profiles": "",
        "topic_type_hash": typestore().hash_rihs01(topic.type_name),
    }
    numbers = struct.pack("<HH", number, schema)
    return _record(_CHANNEL, numbers + _string(topic.name) + _string("cdr") + _string_map(metadata))


def _record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def _string_map(entries: Mapping[str, str]) -> bytes:
    return _sized(b"".join(_string(key) + _string(value) for key, value in entries.items()))


def _string(text: str) -> bytes:
    return _sized(text.encode())


def _sized(content: bytes) -> bytes:
    return struct.pack("<I", len(content)) + content
