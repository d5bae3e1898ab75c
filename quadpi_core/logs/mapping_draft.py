# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A mapping file to start from, for a table without one: what its columns may be, by names and numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import yaml

from quadpi_core.frames import Array
from quadpi_core.logs.mapping import ERPM, ROLL_PITCH_YAW, UNITS
from quadpi_core.logs.table_columns import Columns, bare_name
from quadpi_core.records import STANDARD_GRAVITY

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
