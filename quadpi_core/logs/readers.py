# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reading a log of any known format, and which of the formats a file is."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import IO, Any

from quadpi_core import array_checks
from quadpi_core.errors import LogError, QuadpiError, one_line
from quadpi_core.flight import Recording, RotorSpeedStream, Stamps
from quadpi_core.flight_files import flight_in
from quadpi_core.frames import Array
from quadpi_core.logs import formats
from quadpi_core.logs.log_format import HEAD_BYTES, LogFormat, OpenLog
from quadpi_core.plugins import Plugins
from quadpi_core.reading_options import MappingOrOptions, reading_options
from quadpi_core.rotor_order import with_commanded_speeds
from quadpi_core.screening.flight_runs import in_range
from quadpi_core.screening.sample_order import usable_recording
from quadpi_core.screening.wild_samples import screened
from quadpi_core.vehicle import LOAD_VEHICLE, Vehicle

FORMATS = Plugins("log format", formats, "quadpi.log_formats", LogFormat, LogError)

# What unpacks a file that a log was compressed to, by its first bytes. Compressed bags are read as they are.
_PACKERS = {
    b"\x1f\x8b": "gunzip",
    b"PK\x03\x04": "unzip",
    b"BZh": "bunzip2",
    b"\xfd7zXZ": "unxz",
    b"7z\xbc\xaf": "7z x",
    b"\x28\xb5\x2f\xfd": "unzstd",
    b"\x04\x22\x4d\x18": "unlz4",
}


@cache
def log_formats() -> tuple[LogFormat[Any], ...]:
    """The known formats: those that come with quadpi by file name, then those of installed packages.

    Raises:
        LogError: naming the package whose format cannot be loaded.
    """
    return tuple(FORMATS.all())


def identify_format(path: Path) -> LogFormat[Any]:
    """The format of a log, also of `FILE#NUMBER`: by its first bytes, else by its suffix.

    Raises:
        LogError: if the path does not exist, is empty, or is of no known format.
    """
    path, number = flight_in(path)
    if not path.exists():
        raise LogError(f"{path}: no such file or folder")
    if path.is_file() and path.stat().st_size == 0:
        raise LogError(f"{path}: the file is empty")
    found = _identified(path)
    if found is None and path.is_file():
        with path.open("rb") as file:
            begin = file.read(max(map(len, _PACKERS)))
        for magic, command in _PACKERS.items():
            if begin.startswith(magic):
                raise LogError(f"{path}: is compressed; `{command} {path.name}` unpacks it")
    if found is None:
        known = ", ".join(log_format.description for log_format in log_formats())
        why = f"not a known log format; known: {known}"
        raise LogError(f"{path}: {f'a folder that is no bag; give {path}/*' if path.is_dir() else why}")
    if number is not None and found.flights is None:
        raise LogError(f"{path}: a {found.description} holds one flight, and none of a number")
    return found


def flights_of(path: Path) -> list[Path]:
    """The flights in a log: `FILE#NUMBER` of each where there are several, else the same path.

    What is wrong with a log is said when it is read.
    """
    numbers: Sequence[int] = ()
    with suppress(LogError), reading(path):
        flights = identify_format(path).flights
        if flights is not None and flight_in(path)[1] is None:
            numbers = flights.numbers(path)
    return [path.with_name(f"{path.name}#{number}") for number in numbers] if len(numbers) > 1 else [path]


def is_log_folder(path: Path) -> bool:
    """Whether a folder is a log, such as a bag."""
    return path.is_dir() and _identified(path) is not None


def _identified(path: Path) -> LogFormat[Any] | None:
    if path.is_dir():
        matching = [one for one in log_formats() if one.is_folder(path)]
    elif path.is_file():
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
        suffix = path.suffix.lower()
        matching = [one for one in log_formats() if head.isascii() and suffix in one.sure_suffixes]
        matching = matching or [one for one in log_formats() if one.begins(head)]
        matching = matching or [one for one in log_formats() if suffix in one.suffixes]
    else:  # a device or pipe
        matching = []
    return matching[0] if matching else None


def read_recording(path: Path | str, vehicle: Vehicle | None, mapping: MappingOrOptions = None) -> Recording:
    """Read any supported log or bag in SI, FRD and NED, without the samples that no flight can have.

    Those are the samples that :mod:`quadpi_core.screening.sample_order` drops, and those beyond limits. What
    was left out, sorted and cut off is in the recording's `quality`.

    Args:
        path: a file, a rosbag2 folder, or `FILE#NUMBER` for one of the flights in a file.
        vehicle: gives the pole pairs and the largest rotor speed; a log of electrical speeds needs it.
        mapping: a file, or its name, with what the log does not say of itself: the columns of a CSV or
            Parquet table (config/mappings), how messages of other packages are read (config/adapters), or
            the rotor order of an autopilot. Or :class:`.ReadingOptions`, which also choose topics of a bag,
            and a part of the flight.

    Raises:
        LogError: naming the file, and topic and sample where there is one.
    """
    usable = usable_recording(decode_recording(path, vehicle, mapping))
    recording = screened(in_range(usable, reading_options(mapping).part), vehicle)
    recording.check()
    return recording


def decode_recording(
    path: Path | str, vehicle: Vehicle | None, mapping: MappingOrOptions = None
) -> Recording:
    """Like :func:`read_recording`, but whole; only the number of rotors is checked: for `quadpi info`."""
    path = array_checks.path("path", path)
    if vehicle is not None:
        array_checks.instance("vehicle", vehicle, Vehicle, LOAD_VEHICLE)
    log_format = identify_format(path)
    file, number = flight_in(path)
    with reading(path):
        settings = _settings(path, log_format, mapping)
        if number is not None and log_format.flights is not None:
            recording = log_format.flights.read(file, number, vehicle, settings)
        else:
            recording = log_format.read(file, vehicle, settings)
    motors = None
    if vehicle is not None:
        recording.require_rotors(vehicle.name, vehicle.rotor_count)
        motors = vehicle.motors
    return replace(with_commanded_speeds(recording, motors), remedies=log_format.remedies)


@contextmanager
def open_in_blocks(
    path: Path | str, vehicle: Vehicle | None, mapping: MappingOrOptions = None
) -> Iterator[OpenLog]:
    """Open a log whose format has a container, to read it with :func:`blocks_of`.

    Raises:
        LogError: naming the file, and topic and sample where there is one.
    """
    path = Path(path)
    log_format = identify_format(path)
    assert log_format.container is not None
    with ExitStack() as opened:
        with reading(path):
            settings = _settings(path, log_format, mapping)
            log = opened.enter_context(log_format.container.open(path, vehicle, settings))
        yield log


def _settings(path: Path, log_format: LogFormat[Any], mapping: MappingOrOptions) -> Any:
    options, settings = reading_options(mapping), None
    if options.mapping is not None:
        if log_format.load_mapping is None:
            raise LogError(f"{path}: a {log_format.description} takes no mapping file")
        settings = log_format.load_mapping(options.mapping)
    if options.topics or options.namespace:
        if log_format.choose_topics is None:
            raise LogError(f"{path}: a {log_format.description} takes no --topics and no --namespace")
        settings = log_format.choose_topics(settings, options.topics, options.namespace)
    return settings


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


def blocks_of(log: OpenLog) -> Iterator[Recording]:
    """The recording in an open log in blocks.

    Raises:
        LogError: naming the log, for every error.
    """
    remedies = identify_format(Path(log.source)).remedies
    with reading(Path(log.source)):
        for block in log.blocks():
            yield replace(block, remedies=remedies)


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
