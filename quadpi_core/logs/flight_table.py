# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A smoothed flight as a table, on which any simulator can be run, and which `import` reads again.

The columns are those of config/mappings/flight.yaml: SI units, body axes forward-right-down, world
north-east-down. With six columns `simulated_…` from a simulator, the mapping is flight_simulated.yaml. Both
are of four rotors: of others a copy lists the columns of all.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from quadpi_core.errors import LogError, require_library
from quadpi_core.flight import Flight
from quadpi_core.frames import Array
from quadpi_core.paths import whole_output

SUFFIXES = (".csv", ".parquet")
# Columns by the field of a flight that they hold; rotor speeds: :func:`columns_of`.
_STATES = {
    "position": ("north_m", "east_m", "down_m"),
    "attitude": ("qw", "qx", "qy", "qz"),
    "velocity": ("u_m_s", "v_m_s", "w_m_s"),
    "rates": ("p_rad_s", "q_rad_s", "r_rad_s"),
    "angular_acceleration": ("p_rad_s2", "q_rad_s2", "r_rad_s2"),
    "specific_force": ("force_x_m_s2", "force_y_m_s2", "force_z_m_s2"),
    "rotor_speeds": (),
    "wind": ("wind_north_m_s", "wind_east_m_s", "wind_down_m_s"),
}
# Of the measured wrench.
WRENCH = ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")


def columns_of(rotors: int) -> dict[str, tuple[str, ...]]:
    """Columns by the field of a flight that they hold, of a vehicle with this number of rotors."""
    return _STATES | {"rotor_speeds": tuple(f"rotor_{number}_rad_s" for number in range(1, rotors + 1))}


def require_table(path: Path) -> None:
    """Refuse a path that names no kind of table, with a LogError."""
    if path.suffix not in SUFFIXES:
        raise LogError(f"{path}: a table of a flight ends in {' or '.join(SUFFIXES)}")


def write_flight_table(path: Path, flight: Flight, wrench: Array) -> None:
    """Write a flight and its wrench (N, 6) in N and Nm, body, a row per sample, whole or not at all.

    Raises:
        LogError: for another ending.
        OutputError: if `path` cannot be written.
    """
    require_table(path)
    pa, csv, parquet = (require_library(f"pyarrow{part}", "logs") for part in ("", ".csv", ".parquet"))
    columns = {"time_ns": flight.stamps_ns}
    for name, headings in columns_of(flight.rotor_speeds.shape[1]).items():
        columns |= dict(zip(headings, getattr(flight, name).T, strict=True))
    columns |= dict(zip(WRENCH, wrench.T, strict=True))
    table = pa.table({name: np.ascontiguousarray(values) for name, values in columns.items()})
    with whole_output(path) as temporary:
        if path.suffix == ".csv":
            csv.write_csv(table, temporary)
        else:
            parquet.write_table(table, temporary)
