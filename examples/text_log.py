# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reader for ArduPilot's logs as text (.log): forward-right-down, north-east-down, SI, stamps in µs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from quadpi_core.errors import LogError
from quadpi_core.flight import ImuStream, Recording, Stamps
from quadpi_core.frames import Array
from quadpi_core.logs.log_format import LogFormat
from quadpi_core.logs.reader_steps import normalised_attitude, odometry_of, rotors_together
from quadpi_core.rotor_order import RPM, RotorOrder
from quadpi_core.vehicle import Vehicle

# Messages that are read: the topic that each becomes, and its columns. The second is the number of the sensor
# or speed controller.
_READ = {
    "IMU": ("imu", "TimeUS I GyrX GyrY GyrZ AccX AccY AccZ"),
    "ESC": ("rotor_speeds", "TimeUS Instance RPM"),
    "XKF1": ("odometry", "TimeUS C PN PE PD VN VE VD"),
    "XKQ": ("odometry", "TimeUS C Q1 Q2 Q3 Q4"),
}


def read_text_log(path: Path, vehicle: Vehicle | None, order: RotorOrder | None) -> Recording:
    """Read one log; `order` says which speed controller turns which rotor, if not those of a quad X."""
    rows = _rows(path)
    order = order or RotorOrder.by_layout(vehicle, "quad-x", RPM)
    time_ns, values = _of_number(rows["IMU"], 0)
    imu = ImuStream(time_ns, values[:, :3], values[:, 3:])
    state_ns, states = _of_number(rows["XKF1"], 0)
    attitude_ns, quaternions = _of_number(rows["XKQ"], 0)
    attitude = attitude_ns, normalised_attitude(quaternions)
    controllers = [_of_number(rows["ESC"], number) for number in order.controllers]
    return Recording(
        name=path.stem,
        vehicle=vehicle.name if vehicle else "",
        source=str(path),
        imu=imu,
        rotor_speeds=rotors_together(controllers, order, vehicle),
        odometry=odometry_of(state_ns, states[:, :3], states[:, 3:], attitude, imu),
    )


def _rows(path: Path) -> dict[str, Array]:
    """The columns (N, C) of each message that is read."""
    columns: dict[str, list[str]] = {}
    rows: dict[str, list[list[float]]] = {name: [] for name in _READ}
    for line in path.read_text(errors="replace").splitlines(keepends=True):
        name, *values = (word.strip() for word in line.split(","))
        if name == "FMT":
            columns[values[2]] = values[4:]
        elif name in _READ:
            topic, wanted = _READ[name]
            try:
                if not line.endswith("\n"):
                    raise ValueError("the line has no end")
                found = dict(zip(columns[name], map(float, values), strict=True))
                rows[name].append([found[column] for column in wanted.split()])
            except (KeyError, ValueError) as error:
                where = f"{path}: topic {topic}: sample {len(rows[name])}"
                raise LogError(f"{where}: cut off or damaged: {line.rstrip()}") from error
    return {name: np.array(rows[name]).reshape(-1, len(_READ[name][1].split())) for name in _READ}


def _of_number(rows: Array, number: int) -> tuple[Stamps, Array]:
    """Stamps (N,) and values (N, C) of one sensor or controller."""
    chosen = rows[rows[:, 1] == number]
    return (chosen[:, 0] * 1000).astype(np.int64), chosen[:, 2:]


FORMAT = LogFormat(
    description="ArduPilot log as text (.log)",
    read=read_text_log,
    begins=lambda head: head.startswith(b"FMT, 128, "),
    suffixes=(".log",),
    load_mapping=RotorOrder.load,
)
