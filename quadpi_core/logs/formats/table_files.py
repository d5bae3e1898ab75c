# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reader for CSV and Parquet tables, as a mapping file describes them: one row per sample time.

Signals of one topic come from the same rows. A row in which one of them has no value is dropped from that
topic alone: at either end always, in between as far as the mapping's `missing` allows. Every drop is logged.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import LogError, one_line
from quadpi_core.flight import (
    ImuStream,
    OdometryStream,
    PoseStream,
    Recording,
    RotorSpeedStream,
    Stamps,
    Stream,
    WindStream,
    WrenchStream,
)
from quadpi_core.frames import (
    Array,
    body_flu_to_frd,
    quaternion_body_flu_to_frd,
    quaternion_from_roll_pitch_yaw,
    quaternion_world_enu_to_ned,
    world_enu_to_ned,
)
from quadpi_core.logs.log_format import LogFormat
from quadpi_core.logs.mapping import ERPM, QUATERNION_ORDERS, UNITS, Mapping
from quadpi_core.logs.parquet_pages import unpacked_bytes
from quadpi_core.logs.reader_steps import normalised_attitude, stamps_ns
from quadpi_core.logs.unpacking import require_unpackable
from quadpi_core.rotations import rotate_world_to_body
from quadpi_core.sample_limits import STANDARD_GRAVITY
from quadpi_core.vehicle import Vehicle

if TYPE_CHECKING:
    import pyarrow as pa

_PARQUET_MAGIC = b"PAR1"
_GRAVITY_NED = np.array([0.0, 0.0, STANDARD_GRAVITY])

_log = logging.getLogger(__name__)


def read_table(path: Path, vehicle: Vehicle | None, mapping: Mapping | None) -> Recording:
    """Read a table; topics whose signals the mapping does not have are None.

    imu needs `angular_velocity` and `acceleration`; rotor_speeds `rotor_speeds`; odometry `position`,
    `attitude`, `velocity` and `angular_velocity`; mocap/pose `mocap_position` and `mocap_attitude`; wind
    `wind`; simulation/wrench `simulated_force` and `simulated_moment`.

    Raises:
        LogError: naming file, topic and sample, without a mapping, for columns that are missing or not
            numeric, and values missing beyond what the mapping allows.
    """
    if mapping is None:
        raise LogError(f"{path}: a table needs a mapping file that says what its columns are (--mapping)")
    return _TableReader(path, vehicle, mapping).recording()


class _TableReader:
    """One table, its signals converted to SI, FRD and NED on demand; rows without a value hold NaN."""

    def __init__(self, path: Path, vehicle: Vehicle | None, mapping: Mapping) -> None:
        self.path = path
        self.vehicle = vehicle
        self.mapping = mapping
        self.table = _load_table(path)
        time_unit = UNITS["time"][str(mapping.signals["time"].unit)]
        self.time_ns = stamps_ns(str(path), self._raw("time")[:, 0], time_unit)

    def recording(self) -> Recording:
        return Recording(
            name=self.path.stem,
            vehicle=self.vehicle.name if self.vehicle else "",
            source=str(self.path),
            imu=self._imu(),
            rotor_speeds=self._rotor_speeds() if self._has("rotor_speeds") else None,
            pose=self._pose() if self._has("mocap_position", "mocap_attitude") else None,
            odometry=self._odometry() if self._has("position", "attitude", "velocity") else None,
            wind=self._wind() if self._has("wind") else None,
            simulated=self._simulated() if self._has("simulated_force", "simulated_moment") else None,
            battery_v=self._battery() if self._has("battery") else None,
        )

    def _imu(self) -> ImuStream:
        rates, force = self._rates(), self._specific_force()
        keep = self._complete(ImuStream, rates, force, of=("angular_velocity", "acceleration"))
        return ImuStream(self.time_ns[keep], rates[keep], force[keep])

    def _rotor_speeds(self) -> RotorSpeedStream:
        speeds = self._scaled("rotor_speeds")
        if self.mapping.signals["rotor_speeds"].unit == ERPM:
            if self.vehicle is None:
                raise LogError(f"{self.path}: electrical rotor speeds need the vehicle (--vehicle)")
            speeds = self.vehicle.rotor_speeds_from_erpm(speeds)
        keep = self._complete(RotorSpeedStream, speeds, of=("rotor_speeds",))
        return RotorSpeedStream(self.time_ns[keep], speeds[keep])

    def _pose(self) -> PoseStream:
        position, attitude = self._position("mocap_position"), self._attitude("mocap_attitude")
        keep = self._complete(PoseStream, position, attitude, of=("mocap_position", "mocap_attitude"))
        return PoseStream(self.time_ns[keep], position[keep], attitude[keep])

    def _odometry(self) -> OdometryStream:
        signals = (self._position("position"), self._attitude("attitude"), self._velocity(), self._rates())
        of = ("position", "attitude", "velocity", "angular_velocity")
        keep = self._complete(OdometryStream, *signals, of=of)
        return OdometryStream(self.time_ns[keep], *(values[keep] for values in signals))

    def _wind(self) -> WindStream:
        wind = self._position("wind")
        keep = self._complete(WindStream, wind, of=("wind",))
        return WindStream(self.time_ns[keep], wind[keep])

    def _simulated(self) -> WrenchStream:
        of = ("simulated_force", "simulated_moment")
        wrench = np.hstack([self._to_frd(self._scaled(name)) for name in of])
        keep = self._complete(WrenchStream, wrench, of=of)
        return WrenchStream(self.time_ns[keep], wrench[keep])

    def _battery(self) -> tuple[Stamps, Array]:
        volts = self._scaled("battery")[:, 0]
        known = np.isfinite(volts)
        return self.time_ns[known], volts[known]

    def _rates(self) -> Array:
        return self._to_frd(self._scaled("angular_velocity"))

    def _specific_force(self) -> Array:
        values = self._scaled("acceleration")
        signal = self.mapping.signals["acceleration"]
        gravity = signal.gravity == "included"
        if signal.axes == "world":
            in_world = self._to_ned(values) - (0.0 if gravity else _GRAVITY_NED)
            return rotate_world_to_body(self._attitude("attitude"), in_world)
        in_body = self._to_frd(values)
        return (
            in_body if gravity else in_body - rotate_world_to_body(self._attitude("attitude"), _GRAVITY_NED)
        )

    def _velocity(self) -> Array:
        values = self._scaled("velocity")
        if self.mapping.signals["velocity"].axes == "body":
            return self._to_frd(values)
        return rotate_world_to_body(self._attitude("attitude"), self._to_ned(values))

    def _position(self, name: str) -> Array:
        return self._to_ned(self._scaled(name))

    def _attitude(self, name: str) -> Array:
        if not self._has(name):
            raise LogError(f"{self.mapping.path}: world axes or gravity removed need `{name}`")
        signal = self.mapping.signals[name]
        if signal.unit is None:
            order = QUATERNION_ORDERS[str(signal.form)]
            quaternion = normalised_attitude(str(self.path), name, self._raw(name)[:, order])
        else:
            quaternion = quaternion_from_roll_pitch_yaw(self._scaled(name))
        if self.mapping.body == "flu":
            quaternion = quaternion_body_flu_to_frd(quaternion)
        return quaternion_world_enu_to_ned(quaternion) if self.mapping.world == "enu" else quaternion

    def _to_frd(self, vector: Array) -> Array:
        return body_flu_to_frd(vector) if self.mapping.body == "flu" else vector

    def _to_ned(self, vector: Array) -> Array:
        return world_enu_to_ned(vector) if self.mapping.world == "enu" else vector

    def _has(self, *names: str) -> bool:
        return all(name in self.mapping.signals for name in names)

    def _scaled(self, name: str) -> Array:
        return self._raw(name) * UNITS[name][str(self.mapping.signals[name].unit)]

    def _raw(self, name: str) -> Array:
        """Columns of a signal (N, C) as the table holds them; NaN where there is no value."""
        return np.stack([self._column(column) for column in self.mapping.signals[name].columns], axis=1)

    def _column(self, name: str) -> Array:
        from pyarrow import types

        if name not in self.table.column_names:
            raise LogError(f"{self.path}: no column {name}; it has {', '.join(self.table.column_names)}")
        if self.table.column_names.count(name) > 1:
            raise LogError(f"{self.path}: column {name} is present twice")
        column = self.table[name]
        numeric = (types.is_floating, types.is_integer, types.is_null)
        if not any(test(column.type) for test in numeric):
            raise LogError(f"{self.path}: column {name} holds {column.type}, not numbers")
        values: Array = column.to_numpy(zero_copy_only=False).astype(np.float64)
        return values

    def _complete(self, topic: type[Stream], *signals: Array, of: tuple[str, ...]) -> npt.NDArray[np.int64]:
        """Rows in which every signal has a value."""
        complete = np.all([np.isfinite(values).all(axis=1) for values in signals], axis=0)
        where = f"{self.path}: topic {topic.topic}"
        keep = np.flatnonzero(complete)
        if len(keep) == 0:
            raise LogError(f"{where}: no row has a value for all of {', '.join(of)}")
        inside = complete[keep[0] : keep[-1] + 1]
        share = np.mean(~inside)
        if share > max(self.mapping.signals[name].missing for name in of):
            index = int(keep[0] + np.argmin(inside))
            raise LogError(
                f"{where}: sample {index}: no value, as in {share:.2%} of the rows; "
                f"the mapping may allow it with `missing`"
            )
        if len(keep) < len(complete):
            _log.warning(
                "%s: dropped %d of %d rows without a value", where, len(complete) - len(keep), len(complete)
            )
        return keep


def _read_parquet(path: Path) -> pa.Table:
    """A Parquet table, unless it unpacks to too much: one value can stand for any number of rows."""
    from pyarrow import parquet

    content = np.memmap(path, dtype=np.uint8, mode="r")
    try:
        require_unpackable(len(content), unpacked_bytes(content.data))
    except LogError as error:
        raise LogError(f"{path}: not a readable parquet table: {error}") from error
    return parquet.read_table(path)


def _load_table(path: Path) -> pa.Table:
    # Slow to import, and no other format needs it.
    import pyarrow as pa
    from pyarrow import csv

    read = csv.read_csv if path.suffix.lower() == ".csv" else _read_parquet
    try:
        table = read(path)
        # Names that are not UTF-8 show only here.
        _ = table.column_names
    except (pa.ArrowException, UnicodeDecodeError) as error:
        raise LogError(f"{path}: not a readable {path.suffix[1:]} table: {one_line(error)}") from error
    if table.num_columns == 1:
        raise LogError(f"{path}: the table has one column; a CSV file has commas between its columns")
    if table.num_rows == 0:
        raise LogError(f"{path}: the table has no rows")
    return table


FORMAT = LogFormat(
    description="table with a mapping file (.csv, .parquet)",
    read=read_table,
    begins=lambda head: head.startswith(_PARQUET_MAGIC),
    suffixes=(".csv", ".parquet"),
    load_mapping=Mapping.load,
)
