# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reader for the flights of the NeuroBEM data set: one matrix of samples by 41 columns in a .mat file.

Source: Bauersfeld et al., "NeuroBEM: Hybrid Aerodynamic Quadrotor Model", RSS 2021.
Body axes in the file are forward-left-up; the world is z-up and taken as east-north-up.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np

from quadpi_core import flight
from quadpi_core.errors import LogError
from quadpi_core.frames import Array, body_flu_to_frd, quaternion_flu_enu_to_frd_ned, world_enu_to_ned
from quadpi_core.logs.column_files import read_matlab
from quadpi_core.logs.formats.table_files import read_table
from quadpi_core.logs.log_format import LogFormat
from quadpi_core.logs.mapping import Mapping
from quadpi_core.logs.reader_steps import normalised_attitude, note, stamps_ns
from quadpi_core.logs.table_columns import mapping_draft, open_columns
from quadpi_core.vehicle import Vehicle

_COLUMN_COUNT = 41
_TIME = 0
_RATES = slice(4, 7)
_ATTITUDE = [10, 7, 8, 9]
_SPECIFIC_FORCE = slice(11, 14)
_VELOCITY_BODY = slice(14, 17)
_POSITION = slice(17, 20)
_ROTOR_SPEEDS = slice(20, 24)
_BATTERY_DECIVOLT = 28


def read_matlab_file(path: Path, vehicle: Vehicle | None, mapping: Mapping | None = None) -> flight.Recording:
    """Read a .mat file: variables as a mapping says, without one a flight of NeuroBEM."""
    return read_neurobem(path, vehicle) if mapping is None else read_table(path, vehicle, mapping)


def read_neurobem(path: Path, vehicle: Vehicle | None) -> flight.Recording:
    """Read one NeuroBEM flight; every stream lies on the file's one clock.

    The rotor order of the file is rear right, front right, rear left, front left: that of
    config/vehicles/neurobem.yaml.

    Raises:
        LogError: if the file does not hold one (N, 41) matrix.
    """
    source = str(path)
    matrix = _load_matrix(path)
    time_ns = stamps_ns(matrix[:, _TIME])
    rates = body_flu_to_frd(matrix[:, _RATES])
    position = world_enu_to_ned(matrix[:, _POSITION])
    attitude = quaternion_flu_enu_to_frd_ned(normalised_attitude(matrix[:, _ATTITUDE]))
    velocity = body_flu_to_frd(matrix[:, _VELOCITY_BODY])
    specific_force = body_flu_to_frd(matrix[:, _SPECIFIC_FORCE])
    return flight.Recording(
        name=path.stem,
        vehicle=vehicle.name if vehicle else "",
        source=source,
        imu=flight.ImuStream(time_ns, rates, specific_force),
        rotor_speeds=flight.RotorSpeedStream(time_ns, np.ascontiguousarray(matrix[:, _ROTOR_SPEEDS])),
        pose=flight.PoseStream(time_ns, position, attitude),
        odometry=flight.OdometryStream(time_ns, position, attitude, velocity, rates),
        battery=flight.BatteryStream(time_ns, matrix[:, _BATTERY_DECIVOLT] / 10.0),
    )


def _load_matrix(path: Path) -> Array:
    try:
        variables = read_matlab(path)
    except LogError as error:
        raise LogError(f"{path}: {error}") from error
    matrices = [
        variable.values
        for variable in variables
        if variable.values is not None
        and variable.values.ndim == 2
        and variable.values.shape[1] == _COLUMN_COUNT
    ]
    if len(matrices) != 1 or matrices[0].dtype.kind != "f":
        with suppress(LogError):
            note(str(path), f"a mapping file to start from:\n{mapping_draft(open_columns(path))}")
        held = ", ".join(f"{variable.name} ({variable.kind})" for variable in variables) or "nothing"
        raise LogError(
            f"{path}: expected one NeuroBEM matrix of N samples by {_COLUMN_COUNT} columns; "
            f"the file holds {held}; other variables need a mapping file (--mapping), like the one above"
        )
    return np.ascontiguousarray(matrices[0], dtype=np.float64)


FORMAT = LogFormat(
    description="NeuroBEM flight, or variables with a mapping file (.mat)",
    read=read_matlab_file,
    suffixes=(".mat",),
    load_mapping=Mapping.load,
)
