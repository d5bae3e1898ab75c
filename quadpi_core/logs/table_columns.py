# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Columns of a table by their names, whatever file they are in: CSV, Parquet, variables of MATLAB."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import yaml

from quadpi_core.errors import LogError, one_line, require_library
from quadpi_core.flight import MAX_GAP_NS, NO_STAMP, Stamps
from quadpi_core.frames import Array
from quadpi_core.logs.column_files import (
    ABSENT,
    CsvDialect,
    dialect_of,
    read_columns,
    read_content,
    read_matlab,
)
from quadpi_core.logs.mapping import ERPM, ROLL_PITCH_YAW, UNITS
from quadpi_core.logs.reader_steps import note, stamps_ns
from quadpi_core.logs.sandbox import read_apart
from quadpi_core.records import CONVENTION, STANDARD_GRAVITY, Threshold

if TYPE_CHECKING:
    import pyarrow as pa

PARQUET_MAGIC = b"PAR1"
STAMP_INTERVAL_S = Threshold(
    "shortest and longest interval between rows by which the unit of the stamps is told",
    (5e-4, 0.5),
    "s",
    "units of time are a factor of 1000 apart, so that one of them gives such an interval and no other; "
    "2 Hz to 2 kHz has every rate of the flights in shared data, of 100 to 1010 Hz, at its middle",
    CONVENTION,
)
# A unit that the mapping names is kept down to this share of the shortest interval: Blackbox has 8 kHz.
_FAST_SHARE = 0.1
# Counters of 32 bits, of microseconds and of milliseconds, and the time of a day begin again at 0.
_COUNTERS_NS = (2**32 * 1000, 2**32 * 10**6)
_DAY_NS = 86_400 * 10**9
_NANOSECONDS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
# A unit in brackets at the end of a name, which is no index.
_IN_BRACKETS = re.compile(r"[\[(](?!\d+[\])])[^\[\]()]*[\])]$")
_HEAD_ROWS = 1000


@dataclass(frozen=True)
class Columns:
    """The columns of one table.

    Attributes:
        path: of the file.
        names: (C,) in the order of the table.
        units: (C,) where a row of the table gives them, else empty.
        read: columns by their places, with the place of the stamps: numbers (N,), or date and time.
        head: the first rows of all columns that hold numbers, by place.
    """

    path: Path
    names: Sequence[str]
    units: Sequence[str]
    read: Callable[[Sequence[int], int], Mapping[int, npt.NDArray[Any]]]
    head: Callable[[], Mapping[int, Array]]

    def place(self, name: str) -> int:
        """Place of the column of a name: exactly so, or without a unit in brackets, spaces and `#`.

        Raises:
            LogError: if there is none, or more than one.
        """
        found = [place for place, one in enumerate(self.names) if one == name]
        plain = bare_name(name)
        found = found or [place for place, one in enumerate(self.names) if bare_name(one) == plain]
        if not found:
            raise LogError(f"{self.path}: no column {name}; it has {', '.join(self.names)}")
        if len(found) > 1:
            raise LogError(f"{self.path}: column {name} is present twice")
        return found[0]


def bare_name(name: str) -> str:
    """The name of a column without a unit in brackets, and what marks a comment."""
    return _IN_BRACKETS.sub("", name.strip("#% \t")).rstrip()


def open_columns(path: Path) -> Columns:
    """The columns of a table.

    Raises:
        LogError: naming the file, if it cannot be read, is no table, or has no rows.
    """
    suffix = path.suffix.lower()
    try:
        with path.open("rb") as stream:
            is_parquet = stream.read(len(PARQUET_MAGIC)) == PARQUET_MAGIC or suffix == ".parquet"
        if suffix != ".mat":
            require_library("pyarrow", "logs")
        return (_of_parquet if is_parquet else _of_matlab if suffix == ".mat" else _of_csv)(path)
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (LogError, UnicodeDecodeError) as error:
        raise LogError(f"{path}: {one_line(error)}") from error


def _of_csv(path: Path) -> Columns:
    content = read_content(path)
    dialect = dialect_of(content)

    def read(places: Sequence[int], stamps: int) -> Mapping[int, npt.NDArray[Any]]:
        table, said = read_columns(content, dialect, places, stamps)
        for sentence in said:
            note(str(path), sentence)
        return {int(name): _numbers(table, name, dialect.names[int(name)]) for name in table.column_names}

    return Columns(path, dialect.names, dialect.units, read, lambda: _head_of(dialect))


def _head_of(dialect: CsvDialect) -> dict[int, Array]:
    head = {}
    for place, column in enumerate(zip(*dialect.head[:_HEAD_ROWS], strict=True)):
        values = np.array([_number_of(text.replace(dialect.decimal, ".")) for text in column])
        if 2 * np.count_nonzero(np.isfinite(values)) > sum(text.lower() not in ABSENT for text in column):
            head[place] = values
    return head


def _number_of(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")


def _of_parquet(path: Path) -> Columns:
    """A Parquet table, unless it unpacks to too much: one value can stand for any number of rows."""
    # Slow to import, and no other format needs it; here, so that the other process need not.
    from pyarrow import parquet  # noqa: F401

    table: pa.Table = next(read_apart(path.stat().st_size, _parquet_table, path))
    names = table.column_names
    if table.num_rows == 0:
        raise LogError("the table has no rows")
    by_place = table.rename_columns([str(place) for place in range(len(names))])

    def read(places: Sequence[int], _stamps: int) -> Mapping[int, npt.NDArray[Any]]:
        return {place: _numbers(by_place, str(place), names[place]) for place in places}

    def head() -> Mapping[int, Array]:
        first = by_place.slice(0, _HEAD_ROWS)
        numeric = [place for place in range(len(names)) if _is_numeric(first[str(place)].type)]
        return {place: _numbers(first, str(place), names[place]).astype(np.float64) for place in numeric}

    return Columns(path, names, (), read, head)


def _parquet_table(path: Path) -> Iterator[pa.Table]:
    import pyarrow as pa
    from pyarrow import parquet

    # Another allocator would reserve more memory than it uses.
    pa.set_memory_pool(pa.system_memory_pool())
    table = parquet.ParquetFile(path).read(use_threads=False)
    table.validate(full=True)
    yield table


def _of_matlab(path: Path) -> Columns:
    """Variables by their names, fields of a struct with a dot; of a matrix also NAME.1, NAME.2 and so on."""
    columns: dict[str, npt.NDArray[Any]] = {}
    for variable in read_matlab(path):
        if variable.values is not None and variable.values.size:
            along = variable.values if np.argmax(variable.values.shape) == 0 else variable.values.T
            if along.shape[1] == 1:
                columns[variable.name] = along[:, 0]
            else:
                columns |= {f"{variable.name}.{k + 1}": column for k, column in enumerate(along.T)}
    if not columns:
        raise LogError("the file holds no numbers")
    values = list(columns.values())

    def head() -> Mapping[int, Array]:
        return {place: column[:_HEAD_ROWS].astype(np.float64) for place, column in enumerate(values)}

    def read(places: Sequence[int], stamps: int) -> Mapping[int, npt.NDArray[Any]]:
        names = list(columns)
        for place in places:
            if len(values[place]) != len(values[stamps]):
                raise LogError(
                    f"{path}: {names[place]} has {len(values[place])} values, the time {names[stamps]} has "
                    f"{len(values[stamps])}"
                )
        return {place: values[place] for place in places}

    return Columns(path, list(columns), (), read, head)


def _numbers(table: pa.Table, name: str, called: str) -> npt.NDArray[Any]:
    """A column (N,) of a table: numbers, NaN where there is none, or date and time."""
    import pyarrow as pa
    from pyarrow import compute, types

    column = table[name]
    if types.is_string(column.type):
        column = _dates(column, called)
    if types.is_time(column.type):
        column = compute.cast(compute.cast(column, pa.time64("ns")), pa.int64()).cast(pa.timestamp("ns"))
    if types.is_timestamp(column.type):
        return np.asarray(column.to_numpy(zero_copy_only=False)).astype("datetime64[ns]")
    if not _is_numeric(column.type):
        raise LogError(f"column {called} holds {column.type}, not numbers")
    values = np.asarray(column.to_numpy(zero_copy_only=False))
    return values if values.dtype.kind in "iuf" else values.astype(np.float64)


def _dates(column: pa.ChunkedArray, called: str) -> pa.ChunkedArray:
    """Date and time (N,) of ISO 8601, or of a day alone; null where it is neither, refused if most are so."""
    import pyarrow as pa
    from pyarrow import compute

    text = compute.replace_substring(compute.utf8_trim_whitespace(column), ",", ".")
    text = compute.replace_substring_regex(text, r"^(\d\d?:)", r"1970-01-01T\1")
    text = compute.replace_substring_regex(
        text, r"^(\d{4})[-/]?(\d\d)[-/]?(\d\d)[T ]+(\d\d?):?(\d\d):?(\d\d)", r"\1-\2-\3T\4:\5:\6"
    )
    text = compute.replace_substring_regex(text, r"T(\d):", r"T0\1:")
    # Arrow takes nine decimals at most.
    text = compute.replace_substring_regex(text, r"(\.\d{9})\d+", r"\1")
    zone = r"(Z|[+-]\d\d(:?\d\d)?)"
    form = rf"^\d{{4}}-[01]\d-[0-3]\dT[0-2]\d:[0-5]\d:[0-5]\d(\.\d+)?{zone}?$"
    dated = compute.fill_null(compute.match_substring_regex(text, form), fill_value=False)
    if 2 * (compute.sum(dated).as_py() or 0) <= len(column) - column.null_count:
        first = next((one.as_py() for one in column if one.is_valid), "")
        raise LogError(
            f"column {called}: {first!r} is neither a number nor date and time as 2026-11-26T12:30:00.250"
        )
    without_zone = compute.match_substring_regex(text, r"T[\d:]{8}(\.\d+)?$")
    text = compute.if_else(without_zone, compute.binary_join_element_wise(text, "Z", ""), text)
    text = compute.if_else(dated, text, pa.scalar(None, pa.string()))
    try:
        return compute.cast(text, pa.timestamp("ns", "UTC"))
    except pa.ArrowException as error:
        raise LogError(f"column {called}: {one_line(error)}") from error


def _is_numeric(kind: pa.DataType) -> bool:
    from pyarrow import types

    return any(test(kind) for test in (types.is_floating, types.is_integer, types.is_null))


def stamps_of(
    source: str, values: npt.NDArray[Any], unit: str | None, *, may_be_slow: bool = False
) -> Stamps:
    """Nanosecond stamps (N,) of a column of times; a note says where the unit is not that of the mapping.

    Date and time (ISO 8601) need no unit. Otherwise the unit is that which gives an interval between rows
    that a flight has, `STAMP_INTERVAL_S`, unless `unit` does.

    Args:
        source: the table, for messages.
        values: numbers, or date and time.
        unit: as the mapping says; None where it does not.
        may_be_slow: whether a unit of the mapping is kept however seldom rows are.

    Raises:
        LogError: for times of no unit that can be told.
    """
    if values.dtype.kind == "M":
        return unwrapped(source, np.where(np.isnat(values), NO_STAMP, values.astype(np.int64)), _DAY_NS)
    steps = np.diff(values.astype(np.float64))
    steps = steps[steps > 0.0]
    interval = float(np.median(steps)) if len(steps) else 0.0
    shortest, longest = STAMP_INTERVAL_S.value
    fitting = [one for one, scale in UNITS["time"].items() if shortest <= interval * scale < longest]
    slowest = np.inf if may_be_slow else longest
    keeps = unit and _FAST_SHARE * shortest <= interval * UNITS["time"][unit] < slowest
    if not keeps and interval > 0.0 and fitting:
        rate = 1.0 / (interval * UNITS["time"][fitting[0]])
        said = f", not in {unit} as the mapping says" if unit else ""
        note(
            source, f"the stamps are taken to be in {fitting[0]}{said}, which makes {rate:.4g} rows a second"
        )
        unit = fitting[0]
    elif not keeps and 0.0 < interval * UNITS["time"][unit or "s"] < shortest:
        raise LogError(
            f"{source}: the stamps are {interval:.3g} apart, which is the interval of no flight in s, ms, us "
            "or ns; is another column the time?"
        )
    if unit is None:
        raise LogError(f"{source}: the unit of the time cannot be told; `unit` in the mapping says it")
    if values.dtype.kind in "iu" and len(values):
        largest = max(abs(int(values.min())), abs(int(values.max())))
        if largest * _NANOSECONDS[unit] <= np.iinfo(np.int64).max:
            return unwrapped(source, values.astype(np.int64) * _NANOSECONDS[unit], *_COUNTERS_NS)
    return unwrapped(source, stamps_ns(values.astype(np.float64), UNITS["time"][unit]), *_COUNTERS_NS)


def unwrapped(source: str, time_ns: Stamps, *periods_ns: int) -> Stamps:
    """Stamps (N,) of a clock that begins again at 0 after a period, counted on; a note says so.

    Only a fall by the period, but for a usual pause, is taken for that: a clock that starts again falls by
    any other time.
    """
    known = np.flatnonzero(time_ns != NO_STAMP)
    for period in periods_ns:
        steps = np.diff(time_ns[known])
        turns = np.round(steps / period).astype(np.int64)
        turns[np.abs(steps - turns * period) > MAX_GAP_NS] = 0
        if turns.min(initial=0) < 0:
            note(source, f"the clock begins again after {1e-9 * period:.6g} s, and is counted on")
            time_ns = time_ns.copy()
            time_ns[known[1:]] -= np.cumsum(turns) * period
    return time_ns


_BEGIN = r"(^|[\W_])"
_MOCAP = r"(mocap|vicon|optitrack|vrpn|locsrv|extpos|extatt)"
# Signals, how many columns each has, and what these are called in lower case, without unit, axis or number.
# The first group that fits is taken: motion capture before a state. Of motors without rpm these are commands.
_CALLED = (
    ("rotor_speeds", 4, r"rpm|rotor|omega$|^(?!.*(motor|pwm|cmd))(.*[\W_])?(m|esc)$"),
    ("wind", 3, "wind"),
    ("mocap_attitude", 4, _MOCAP),
    ("mocap_position", 3, _MOCAP),
    ("angular_velocity", 3, rf"gyro|omega|ang\w*[\W_]?(vel|rate)|{_BEGIN}rates?$|{_BEGIN}w(_rs_s)?$|^pqr$"),
    ("acceleration", 3, rf"acc|specific|force|{_BEGIN}a(_rs_s)?$"),
    ("velocity", 3, rf"vel|{_BEGIN}v(_rs_r)?$|^uvw$"),
    ("attitude", 4, rf"quat|att|orient|rot|{_BEGIN}q(_rs)?$"),
    ("attitude", 3, "rpy$"),
    ("position", 3, rf"pos|{_BEGIN}p(_rs_r)?$|^$|estimate$"),
)
_TIME, _BATTERY = re.compile(r"t\b|time|stamp"), re.compile("vbat|batt|volt")
_SUFFIX = re.compile(r"[\W_](rad_s|deg_s|e?rpm|[cm]?m_s2?|[mun]?s|rad|deg|[cm]?m|m?v|g)$")
_PART = re.compile(r"(.*?)[\W_]*([xyzw]|\d)\W*")
# Names that are components without an axis or number.
_NAMED_PARTS = {
    **{name: ("rpy", str(place)) for place, name in enumerate(("roll", "pitch", "yaw"))},
    **{name: ("pqr", str(place)) for place, name in enumerate("pqr")},
    **{name: ("uvw", str(place)) for place, name in enumerate("uvw")},
}
# The search for parts of a name takes a time that grows with the square of its length.
_NAME_MAX = 100
_PARTS = {3: ("xyz", "012", "123"), 4: ("wxyz", "0123", "1234")}
# By signal: up to which number it is in the first unit, else in the second; of the median, or the largest.
_UNITS_BY_SIZE = {
    "angular_velocity": (35.0, "rad/s", "deg/s", False),
    "attitude": (7.0, "rad", "deg", False),
    "mocap_attitude": (7.0, "rad", "deg", False),
    "rotor_speeds": (4000.0, "rad/s", "rpm", True),
    "battery": (100.0, "V", "mV", True),
}


@dataclass
class _Group:
    """Columns that are called alike: their places by axis or number, and a unit that is written somewhere."""

    places: dict[str, int] = field(default_factory=dict)
    unit: str = ""

    def of(self, count: int) -> list[int] | None:
        """The places in order, of a quaternion w first; None if these are not so many components."""
        keys = next((keys for keys in _PARTS[count] if set(keys) == set(self.places)), "")
        return [self.places[key] for key in keys] or None


def mapping_draft(columns: Columns) -> str:
    """A mapping file for a table, whole but for columns that could not be guessed: ? stands for them."""
    head = columns.head()
    groups = _groups(columns, head)
    entries: dict[str, dict[str, Any]] = {}
    values: dict[str, Array] = {}
    for name, count, called in _CALLED:
        for stem, group in groups.items():
            places = group.of(count)
            if name in entries or places is None or not re.search(called, stem):
                continue
            values[name] = np.column_stack([head[place] for place in places])
            entries[name] = _entry(columns, places, name, values[name], (stem, group.unit))
            groups = {other: one for other, one in groups.items() if other != stem}
    for place, name in ((place, columns.names[place]) for place in head):
        if _BATTERY.search(name.lower()) and "battery" not in entries:
            entries["battery"] = _entry(columns, [place], "battery", head[place][:, np.newaxis])
    if "velocity" not in entries:
        # A position and an attitude alone are a pose, as motion capture has it.
        for name in ("position", "attitude"):
            if name in entries:
                entries.setdefault(f"mocap_{name}", entries.pop(name))
    return _text(columns, head, entries, values)


def _groups(columns: Columns, head: Mapping[int, Array]) -> dict[str, _Group]:
    groups: dict[str, _Group] = {}
    for place in head:
        name = bare_name(columns.names[place]).lower()
        unit = columns.units[place] if columns.units else columns.names[place][len(bare_name(name)) :]
        if suffix := _SUFFIX.search(name):
            name, unit = name[: suffix.start()], unit if unit.strip(" []()") else suffix[1]
        last = re.split(r"[\W_]", name)[-1]
        if last in _NAMED_PARTS:
            stem, part = name.removesuffix(last) + _NAMED_PARTS[last][0], _NAMED_PARTS[last][1]
        elif len(name) > _NAME_MAX:
            continue
        elif found := _PART.fullmatch(name):
            stem, part = found.groups()
        else:
            continue
        group = groups.setdefault(stem, _Group())
        group.places.setdefault(part, place)
        group.unit = group.unit or unit
    return groups


def _spelled(unit: str) -> str:
    """A unit as mappings spell it: `rad s^-1`, `m/s²` and `deg_s` become rad/s, m/s2 and deg/s."""
    text = re.sub(r"[\s\[\]()^]", "", unit.lower()).replace("²", "2").replace("°", "deg")
    text = re.sub(r"[µμ]", "u", text)
    return re.sub(r"_s2$|s-2$", "/s2", re.sub(r"_s$|s-1$", "/s", text))


def _entry(
    columns: Columns, places: list[int], name: str, values: Array, group: tuple[str, str] = ("", "")
) -> dict[str, Any]:
    """What a mapping says of a signal; `group`: what its columns are called, and a unit that is written."""
    entry: dict[str, Any] = {"columns": [bare_name(columns.names[place]) for place in places]}
    if name.endswith("attitude"):
        entry["form"] = "wxyz" if len(places) == 4 else ROLL_PITCH_YAW
    if entry.get("form") != "wxyz":
        entry["unit"] = _unit(name, values, *group)
    if name == "velocity":
        entry["axes"] = "body" if "uvw" in group[0] else "world"
    if name == "acceleration":
        entry |= {
            "axes": "body",
            "gravity": "included" if _holds_gravity(values, entry["unit"]) else "removed",
        }
    there = np.flatnonzero(np.all(np.isfinite(values), axis=1))
    if len(there):
        lacking = 1.0 - len(there) / int(there[-1] - there[0] + 1)
        if lacking > 0.0:
            # Of a slow sensor in a fast table; rows further on may lack more.
            entry["missing"] = min(math.ceil(10.0 * lacking + 0.5) / 10.0, 0.99)
    return entry


def _unit(name: str, values: Array, called: str, written: str) -> str:
    known = {unit.lower(): unit for unit in UNITS[name]}
    if _spelled(written) in known:
        return known[_spelled(written)]
    if name == "rotor_speeds" and "rpm" in called:
        return ERPM if ERPM in called else "rpm"
    if name == "acceleration":
        size = float(np.nanmedian(np.linalg.norm(values, axis=1)))
        return "g" if 0.5 < size < 2.0 else "m/s2"
    sizes = np.abs(values[np.isfinite(values)])
    if name in _UNITS_BY_SIZE and len(sizes):
        most, smaller, larger, by_median = _UNITS_BY_SIZE[name]
        return smaller if (np.median(sizes) if by_median else np.max(sizes)) <= most else larger
    return next(iter(known.values()))


def _holds_gravity(values: Array, unit: str) -> bool:
    """Whether an acceleration is nearer to gravity than to nothing, as at rest and in flight on average."""
    size = float(np.nanmedian(np.linalg.norm(values, axis=1))) * UNITS["acceleration"][unit]
    return size > 0.5 * STANDARD_GRAVITY


def _text(
    columns: Columns,
    head: Mapping[int, Array],
    entries: Mapping[str, dict[str, Any]],
    values: Mapping[str, Array],
) -> str:
    """The lines of the file, in the order of the guide."""
    names = {place: columns.names[place] for place in range(len(columns.names))}
    clock = next((name for name in names.values() if _TIME.match(bare_name(name).lower())), None)
    rising = (place for place, column in head.items() if len(column) > 1 and np.all(np.diff(column) > 0.0))
    clock = clock or names.get(next(rising, -1), "?")
    up = float(np.nanmedian(values["acceleration"][:, 2])) if "acceleration" in values else 1.0
    down = float(np.nanmedian(values["position"][:, 2])) < 0.0 if "position" in values else up < 0.0
    lines = {
        "time": {"columns": [bare_name(clock)]},
        "body": "flu" if up > 0.0 else "frd",
        "world": "ned" if down else "enu",
        "angular_velocity": {"columns": ["?x", "?y", "?z"], "unit": "rad/s"},
        "acceleration": {
            "columns": ["?x", "?y", "?z"],
            "unit": "m/s2",
            "axes": "body",
            "gravity": "included",
        },
        **entries,
    }
    written = (f"{name}: {_flow(value)}" for name, value in lines.items())
    return "\n".join(
        ("# Guessed from names and numbers: check each line, and put columns for ? in.", *written)
    )


def _flow(value: object) -> str:
    if isinstance(value, str):
        return value
    return yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=10_000).strip()
