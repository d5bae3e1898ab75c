# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The known log formats: which of them a file is, and the reader of each.

Readers are imported when one is needed: each brings libraries that the others do not need.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from quadpi_core.errors import LogError, QuadpiError, one_line
from quadpi_core.flight import Recording
from quadpi_core.logs.autopilot import (
    BLACKBOX_MAGIC,
    CFUSDLOG_MAGIC,
    DATAFLASH_MAGIC,
    ULOG_MAGIC,
    begins_with,
)
from quadpi_core.screening.wild_samples import screened
from quadpi_core.vehicle import Vehicle

if TYPE_CHECKING:
    from quadpi_core.logs.bags import BagRecording
    from quadpi_core.rotor_order import RotorOrder


@dataclass(frozen=True)
class LogFormat:
    """A log format: how to tell it from others, and its reader.

    Attributes:
        description: what a user would call it, for messages.
        recognise: whether a path that exists is of this format, by its suffix or first byte.
        read: gives the recording; the last argument is the mapping file, where it takes one.
    """

    description: str
    recognise: Callable[[Path], bool]
    read: Callable[[Path, Vehicle | None, Path | None], Recording]
    takes_mapping: bool = False


def read_recording(path: Path | str, vehicle: Vehicle | None, mapping: Path | str | None = None) -> Recording:
    """Read any supported log or bag in SI, FRD and NED, leave out samples beyond limits, check every stream.

    What was left out is in the recording's `quality`.

    Args:
        path: a file, or a rosbag2 folder.
        vehicle: gives the pole pairs and the largest rotor speed; a log of electrical speeds needs it.
        mapping: for CSV and Parquet, a file that says what the columns are, or the name of one in
            config/mappings; for bags, one that says how messages of other packages are read, in
            config/adapters.

    Raises:
        LogError: naming the file, and topic and sample where there is one.
    """
    recording = decode_recording(path, vehicle, mapping)
    recording = screened(recording, vehicle)
    recording.check()
    return recording


def decode_recording(
    path: Path | str, vehicle: Vehicle | None, mapping: Path | str | None = None
) -> Recording:
    """Like :func:`read_recording`, but unchecked, and whole: what `quadpi info` diagnoses."""
    path = Path(path)
    log_format = identify_format(path)
    if mapping is not None and not log_format.takes_mapping:
        raise LogError(f"{path}: a {log_format.description} takes no mapping file")
    with reading(path):
        return log_format.read(path, vehicle, None if mapping is None else Path(mapping))


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Name the file that could not be read.

    Raises:
        LogError: in place of every error that is not quadpi's own.
    """
    try:
        yield
    except QuadpiError:
        raise
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror or error}") from error
    except MemoryError as error:
        raise LogError(f"{path}: cannot be read: it takes more memory than there is") from error
    except Exception as error:  # the last resort: libraries raise many kinds on damaged bytes
        raise LogError(f"{path}: cannot be read: {type(error).__name__}: {one_line(error)}") from error


def blocks_of(bag: BagRecording) -> Iterator[Recording]:
    """The recording in a bag in blocks.

    Raises:
        LogError: naming the bag, for every error.
    """
    with reading(Path(bag.source)):
        yield from bag.blocks()


def identify_format(path: Path) -> LogFormat:
    """The format of a log or bag.

    Raises:
        LogError: if the path does not exist, is empty, or is of no known format.
    """
    if not path.exists():
        raise LogError(f"{path}: no such file or folder")
    if path.is_file() and path.stat().st_size == 0:
        raise LogError(f"{path}: the file is empty")
    for log_format in FORMATS.values():
        if log_format.recognise(path):
            return log_format
    known = ", ".join(log_format.description for log_format in FORMATS.values())
    raise LogError(f"{path}: not a known log format; known: {known}")


def _is_bag(path: Path) -> bool:
    if path.is_dir():
        return (path / "metadata.yaml").is_file() or any(map(_is_bag_file, path.iterdir()))
    return _is_bag_file(path)


def _is_bag_file(path: Path) -> bool:
    return path.is_file() and path.suffix.lower() in {".mcap", ".db3", ".bag"}


def _files(*suffixes: str, magic: bytes = b"") -> Callable[[Path], bool]:
    """Whether a path is a file with one of the suffixes, or one that begins with the magic bytes.

    One that has the suffix alone is left to its reader, which says what is wrong with it.
    """

    def recognise(path: Path) -> bool:
        has_suffix = path.suffix.lower() in suffixes
        return path.is_file() and (has_suffix or (magic != b"" and begins_with(path, magic)))

    return recognise


def _read_bag(path: Path, vehicle: Vehicle | None, mapping: Path | None) -> Recording:
    from quadpi_core.logs.bags import read_bag
    from quadpi_core.messages.adapters import AdapterSettings

    return read_bag(path, vehicle, None if mapping is None else AdapterSettings.load(mapping))


def _read_neurobem(path: Path, vehicle: Vehicle | None, _mapping: Path | None) -> Recording:
    from quadpi_core.logs.neurobem import read_neurobem

    return read_neurobem(path, vehicle)


def _read_cfusdlog(path: Path, vehicle: Vehicle | None, _mapping: Path | None) -> Recording:
    from quadpi_core.logs.cfusdlog import read_cfusdlog

    return read_cfusdlog(path, vehicle)


def _read_table(path: Path, vehicle: Vehicle | None, mapping: Path | None) -> Recording:
    from quadpi_core.logs.mapping import Mapping
    from quadpi_core.logs.table_files import read_table

    if mapping is None:
        raise LogError(f"{path}: a table needs a mapping file that says what its columns are (--mapping)")
    return read_table(path, vehicle, Mapping.load(mapping))


def _is_tlog(path: Path) -> bool:
    if not path.is_file():
        return False
    from quadpi_core.logs.mavlink_tlog import is_tlog

    return path.suffix.lower() == ".tlog" or is_tlog(path)


def _read_tlog(path: Path, vehicle: Vehicle | None, mapping: Path | None) -> Recording:
    from quadpi_core.logs.mavlink_tlog import read_tlog

    return read_tlog(path, vehicle, _rotor_order(mapping))


def _read_ardupilot(path: Path, vehicle: Vehicle | None, mapping: Path | None) -> Recording:
    from quadpi_core.logs.ardupilot import read_ardupilot

    return read_ardupilot(path, vehicle, _rotor_order(mapping))


def _read_px4(path: Path, vehicle: Vehicle | None, mapping: Path | None) -> Recording:
    from quadpi_core.logs.px4 import read_px4

    return read_px4(path, vehicle, _rotor_order(mapping))


def _read_betaflight(path: Path, vehicle: Vehicle | None, mapping: Path | None) -> Recording:
    from quadpi_core.logs.betaflight import read_betaflight

    return read_betaflight(path, vehicle, _rotor_order(mapping))


def _rotor_order(mapping: Path | None) -> RotorOrder | None:
    from quadpi_core.rotor_order import RotorOrder

    return None if mapping is None else RotorOrder.load(mapping)


FORMATS = {
    "bag": LogFormat("bag (.mcap, .db3, .bag, rosbag2 folder)", _is_bag, _read_bag, takes_mapping=True),
    "neurobem": LogFormat("NeuroBEM flight (.mat)", _files(".mat"), _read_neurobem),
    "table": LogFormat(
        "table with a mapping file (.csv, .parquet)",
        _files(".csv", ".parquet"),
        _read_table,
        takes_mapping=True,
    ),
    "cfusdlog": LogFormat("Crazyflie uSD log", _files(magic=bytes([CFUSDLOG_MAGIC])), _read_cfusdlog),
    "ardupilot": LogFormat(
        "ArduPilot log (.bin)", _files(".bin", magic=DATAFLASH_MAGIC), _read_ardupilot, takes_mapping=True
    ),
    "px4": LogFormat("PX4 log (.ulg)", _files(".ulg", magic=ULOG_MAGIC), _read_px4, takes_mapping=True),
    "betaflight": LogFormat(
        "Betaflight Blackbox log (.bbl, .bfl, .txt)",
        _files(".bbl", ".bfl", magic=BLACKBOX_MAGIC),
        _read_betaflight,
        takes_mapping=True,
    ),
    "tlog": LogFormat("MAVLink telemetry log (.tlog)", _is_tlog, _read_tlog, takes_mapping=True),
}
