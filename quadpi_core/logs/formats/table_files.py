# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reader for tables (CSV, Parquet, MATLAB) as a mapping file describes them: one row per sample time.

Signals of one topic come from the same rows. A row in which one of them has no value is dropped from that
topic alone: at either end, and in between as far as the mapping's `missing` allows, it is no sample. Beyond,
it is one that is not finite, see :mod:`quadpi_core.screening.sample_order`.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from quadpi_core import flight, frames
from quadpi_core.errors import LogError
from quadpi_core.inputs import ZERO_CELSIUS
from quadpi_core.logs.log_format import LogFormat
from quadpi_core.logs.mapping import ERPM, QUATERNION_ORDERS, TIME, UNITS, Mapping, Signal
from quadpi_core.logs.reader_steps import (
    normalised_attitude,
    note,
    odometry_of,
    rising,
    unsigned_speeds,
    without_parts,
)
from quadpi_core.logs.table_columns import PARQUET_MAGIC, mapping_draft, open_columns, stamps_of
from quadpi_core.records import STANDARD_GRAVITY
from quadpi_core.screening.sample_order import SHARE_MAX
from quadpi_core.vehicle import Vehicle

# Signals that are of no use without the others of the same topic.
_TOGETHER = MappingProxyType(
    {
        "mocap/pose": ("mocap_position", "mocap_attitude"),
        "simulation/wrench": ("simulated_force", "simulated_moment"),
    }
)
_SECOND_NS = 10**9
_GRAVITY_NED = np.array([0.0, 0.0, STANDARD_GRAVITY])

_log = logging.getLogger(__name__)


def read_table(path: Path, vehicle: Vehicle | None, mapping: Mapping | None) -> flight.Recording:
    """Read a table; topics whose signals the mapping does not have are None.

    imu needs `angular_velocity` and `acceleration`; rotor_speeds `rotor_speeds`; odometry `attitude` and
    `angular_velocity`, with `position` and `velocity` where they were measured; mocap/pose `mocap_position`
    and `mocap_attitude`; wind `wind`; simulation/wrench `simulated_force` and `simulated_moment`.

    Raises:
        LogError: naming file, topic and sample, without a mapping, for columns that are missing or not
            numeric, and values missing beyond what the mapping allows.
    """
    if mapping is None:
        columns = open_columns(path)
        note(str(path), f"a mapping file to start from:\n{mapping_draft(columns)}")
        raise LogError(
            f"{path}: a table needs a mapping file that says what its columns are (--mapping), like the one "
            f"above; it has {', '.join(columns.names)}"
        )
    return _TableReader(path, vehicle, mapping).recording()


class _Table:
    """Columns (N,) of one table by their names in the mapping, and its stamps (N,)."""

    def __init__(self, path: Path, time: Signal, names: Collection[str], *, may_be_slow: bool) -> None:
        columns = open_columns(path)
        clock = columns.place(time.columns[0])
        places = {name: columns.place(name) for name in dict.fromkeys(names)}
        try:
            found = columns.read(sorted({*places.values(), clock}), clock)
        except LogError as error:
            raise LogError(str(error) if str(error).startswith(str(path)) else f"{path}: {error}") from error
        self.time_ns = stamps_of(str(path), found[clock], time.unit, may_be_slow=may_be_slow)
        self.columns = {name: found[place].astype(np.float64) for name, place in places.items()}


class _TableReader:
    """The tables of one flight, their signals converted to SI, FRD and NED on demand.

    Rows without a value hold NaN.
    """

    def __init__(self, path: Path, vehicle: Vehicle | None, mapping: Mapping) -> None:
        self.path = path
        self.vehicle = vehicle
        self.mapping = mapping
        self.tables: dict[str | None, _Table] = {}
        mapping = self.mapping = mapping.of_rotors(
            lambda table: open_columns(self._file(mapping, table)).names
        )
        signals = {name: signal for name, signal in mapping.signals.items() if name != TIME}
        for table in dict.fromkeys([None, *(signal.table for signal in signals.values())]):
            other = mapping.tables.get(table or "")
            file = self._file(mapping, table)
            names = [name for one in signals.values() if one.table == table for name in one.columns]
            time = other.time if other else mapping.signals[TIME]
            # Wind or a battery may come once a second, the IMU does not.
            self.tables[table] = _Table(file, time, names, may_be_slow=table is not None)
        stamps = [one.time_ns[one.time_ns != flight.NO_STAMP] for one in self.tables.values()]
        earliest_ns = min((int(known[0]) for known in stamps if len(known)), default=0)
        if -flight.FLIGHT_MAX_NS < earliest_ns < 0:
            # Seconds since a take-off, or a trigger.
            moved = -(earliest_ns // _SECOND_NS)
            note(str(path), f"the stamps begin at {1e-9 * earliest_ns:.3f} s: {moved} s are added to all")
            for one in self.tables.values():
                one.time_ns = np.where(
                    one.time_ns == flight.NO_STAMP, flight.NO_STAMP, one.time_ns + moved * _SECOND_NS
                )

    def _file(self, mapping: Mapping, table: str | None) -> Path:
        other = mapping.tables.get(table or "")
        return self.path.parent / other.file if other and other.file else self.path

    def recording(self) -> flight.Recording:
        together: dict[str, tuple[str, ...]] = dict(_TOGETHER)
        if not self._has("attitude"):
            together["odometry"] = ("attitude", "position", "velocity")
        for topic, names in together.items():
            present = [name for name in names if self._has(name)]
            missing = [name for name in names if not self._has(name)]
            if present and missing:
                text = f"{_listed(missing)} missing, so {_listed(present)} not used"
                note(str(self.path), f"topic {topic}: {text}")
        return flight.Recording(
            name=self.path.stem,
            vehicle=self.vehicle.name if self.vehicle else "",
            source=str(self.path),
            imu=self._imu(),
            rotor_speeds=self._rotor_speeds() if self._has("rotor_speeds") else None,
            pose=self._pose() if self._has(*_TOGETHER["mocap/pose"]) else None,
            odometry=self._odometry() if self._has("attitude") else None,
            wind=self._wind() if self._has("wind") else None,
            simulated=self._simulated() if self._has(*_TOGETHER["simulation/wrench"]) else None,
            battery=flight.BatteryStream(*self._known("battery")) if self._has("battery") else None,
            commands=self._commands() if self._has("motor_commands") else None,
            command_source=f"table {self.mapping.path.stem}" if self._has("motor_commands") else "",
            pressure=self._air("pressure") if self._has("pressure") else None,
            temperature=self._air("temperature") if self._has("temperature") else None,
        )

    def _imu(self) -> flight.ImuStream:
        of = ("angular_velocity", "acceleration")
        time_ns, rates, force = self._complete(
            flight.ImuStream.topic, of, self._rates(), self._specific_force()
        )
        return flight.ImuStream(time_ns, rates, force)

    def _rotor_speeds(self) -> flight.RotorSpeedStream:
        speeds = self._scaled("rotor_speeds")
        if self.mapping.signals["rotor_speeds"].unit == ERPM:
            if self.vehicle is None:
                raise LogError(f"{self.path}: electrical rotor speeds need the vehicle (--vehicle)")
            speeds = self.vehicle.rotor_speeds_from_erpm(speeds)
        time_ns, speeds = self._complete(flight.RotorSpeedStream.topic, ("rotor_speeds",), speeds)
        return flight.RotorSpeedStream(time_ns, unsigned_speeds(str(self.path), speeds))

    def _pose(self) -> flight.PoseStream:
        of = _TOGETHER["mocap/pose"]
        signals = self._position("mocap_position"), self._attitude("mocap_attitude")
        return flight.PoseStream(*self._complete(flight.PoseStream.topic, of, *signals))

    def _odometry(self) -> flight.OdometryStream | None:
        of = [name for name in ("position", "attitude", "velocity") if self._has(name)]
        attitude = self._attitude("attitude")
        nothing = np.zeros((len(attitude), 3))
        lacking = {name: not self._has(name) for name in ("position", "velocity")}
        state = (
            nothing if lacking["position"] else self._position("position"),
            attitude,
            nothing if lacking["velocity"] else self._velocity(),
        )
        if self._is_in_one_table((*of, "angular_velocity")):
            signals = (*state, self._rates())
            states = flight.OdometryStream(
                *self._complete(flight.OdometryStream.topic, (*of, "angular_velocity"), *signals)
            )
            return without_parts(states, **lacking)
        time_ns, (position, attitude, velocity) = rising(
            *self._complete(flight.OdometryStream.topic, of, *state)
        )
        in_world = frames.rotate_body_to_world(attitude, velocity)
        found = odometry_of(time_ns, position, in_world, (time_ns, attitude), self._imu())
        return without_parts(found, **lacking)

    def _wind(self) -> flight.WindStream:
        return flight.WindStream(*self._complete(flight.WindStream.topic, ("wind",), self._position("wind")))

    def _simulated(self) -> flight.WrenchStream:
        of = _TOGETHER["simulation/wrench"]
        wrench = np.hstack([self._to_frd(self._scaled(name)) for name in of])
        return flight.WrenchStream(*self._complete(flight.WrenchStream.topic, of, wrench))

    def _known(self, name: str) -> tuple[flight.Stamps, frames.Array]:
        """Stamps and values of the rows that have one."""
        values = self._scaled(name)[:, 0]
        known = np.isfinite(values)
        return self._table(name).time_ns[known], values[known]

    def _air(self, name: str) -> flight.AirStream:
        time_ns, values = self._known(name)
        nothing = np.full(len(values), np.nan)
        if name == "pressure":
            return flight.AirStream(time_ns, values, nothing)
        kelvin = self.mapping.signals[name].unit == "K"
        return flight.TemperatureStream(time_ns, nothing, values - (ZERO_CELSIUS if kelvin else 0.0))

    def _commands(self) -> flight.MotorCommandStream:
        signal = self.mapping.signals["motor_commands"]
        idle = 1.0 if signal.unit == "us" else 0.0
        time_ns, shares = self._complete(
            flight.MotorCommandStream.topic, ("motor_commands",), self._scaled("motor_commands") - idle
        )
        return flight.MotorCommandStream(time_ns, np.clip(shares, 0.0, 1.0))

    def _rates(self) -> frames.Array:
        return self._to_frd(self._scaled("angular_velocity"))

    def _specific_force(self) -> frames.Array:
        values = self._scaled("acceleration")
        signal = self.mapping.signals["acceleration"]
        gravity = signal.gravity == "included"
        if signal.axes == "world":
            in_world = self._to_ned(values) - (0.0 if gravity else _GRAVITY_NED)
            return frames.rotate_world_to_body(self._attitude_beside("acceleration"), in_world)
        in_body = self._to_frd(values)
        if gravity:
            return in_body
        return in_body - frames.rotate_world_to_body(self._attitude_beside("acceleration"), _GRAVITY_NED)

    def _velocity(self) -> frames.Array:
        values = self._scaled("velocity")
        if self.mapping.signals["velocity"].axes == "body":
            return self._to_frd(values)
        return frames.rotate_world_to_body(self._attitude_beside("velocity"), self._to_ned(values))

    def _position(self, name: str) -> frames.Array:
        return self._to_ned(self._scaled(name))

    def _attitude_beside(self, name: str) -> frames.Array:
        """The attitude in the rows of another signal."""
        if not self._has("attitude"):
            raise LogError(f"{self.mapping.path}: world axes or gravity removed need `attitude`")
        if not self._is_in_one_table((name, "attitude")):
            raise LogError(f"{self.mapping.path}: {name} needs an `attitude` in the same table")
        return self._attitude("attitude")

    def _attitude(self, name: str) -> frames.Array:
        signal = self.mapping.signals[name]
        if signal.unit is None:
            order = QUATERNION_ORDERS[str(signal.form)]
            quaternion = normalised_attitude(self._raw(name)[:, order])
        else:
            quaternion = frames.quaternion_from_roll_pitch_yaw(self._scaled(name))
        if self.mapping.body == "flu":
            quaternion = frames.quaternion_body_flu_to_frd(quaternion)
        return frames.quaternion_world_enu_to_ned(quaternion) if self.mapping.world == "enu" else quaternion

    def _to_frd(self, vector: frames.Array) -> frames.Array:
        return frames.body_flu_to_frd(vector) if self.mapping.body == "flu" else vector

    def _to_ned(self, vector: frames.Array) -> frames.Array:
        return frames.world_enu_to_ned(vector) if self.mapping.world == "enu" else vector

    def _has(self, *names: str) -> bool:
        return all(name in self.mapping.signals for name in names)

    def _scaled(self, name: str) -> frames.Array:
        return self._raw(name) * UNITS[name][str(self.mapping.signals[name].unit)]

    def _raw(self, name: str) -> frames.Array:
        """Columns of a signal (N, C) as the table holds them; NaN where there is no value."""
        columns = self._table(name).columns
        return np.stack([columns[column] for column in self.mapping.signals[name].columns], axis=1)

    def _table(self, name: str) -> _Table:
        return self.tables[self.mapping.signals[name].table]

    def _is_in_one_table(self, names: Collection[str]) -> bool:
        return len({self.mapping.signals[name].table for name in names}) == 1

    def _complete(self, topic: str, of: Sequence[str], *signals: frames.Array) -> list[Any]:
        """Stamps and signals of the rows in which every signal has a value."""
        where = f"{self.path}: topic {topic}"
        if not self._is_in_one_table(of):
            raise LogError(f"{where}: {', '.join(of)} must be in one table")
        complete = np.all([np.isfinite(values).all(axis=1) for values in signals], axis=0)
        keep = np.flatnonzero(complete)
        if len(keep) == 0:
            raise LogError(f"{where}: no row has a value for all of {', '.join(of)}")
        inside = complete[keep[0] : keep[-1] + 1]
        share = np.mean(~inside)
        allowed = max(self.mapping.signals[name].missing for name in of)
        if share > max(allowed, SHARE_MAX.value):
            index = int(keep[0] + np.argmin(inside))
            raise LogError(
                f"{where}: sample {index}: no value, as in {share:.2%} of the rows; "
                f"the mapping may allow it with `missing`"
            )
        if share > allowed:
            # Not by design, as the mapping would say: dropped and counted as of every source.
            keep = np.arange(keep[0], keep[-1] + 1)
        elif len(keep) < len(complete):
            _log.warning(
                "%s: dropped %d of %d rows without a value", where, len(complete) - len(keep), len(complete)
            )
        return [values[keep] for values in (self._table(of[0]).time_ns, *signals)]


def _listed(names: Sequence[str]) -> str:
    return f"{' and '.join(names)} {'is' if len(names) == 1 else 'are'}"


FORMAT = LogFormat(
    description="table with a mapping file (.csv, .tsv, .txt, .parquet)",
    read=read_table,
    begins=lambda head: head.startswith(PARQUET_MAGIC),
    suffixes=(".csv", ".tsv", ".txt", ".parquet"),
    sure_suffixes=(".csv", ".tsv"),
    load_mapping=Mapping.load,
)
