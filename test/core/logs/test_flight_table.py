# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A smoothed flight as a table: what it holds, and that `import` reads it again as it was."""

from __future__ import annotations

import numpy as np
import pytest
from pyarrow import csv, parquet

from quadpi_core.errors import LogError
from quadpi_core.frames import rotate_world_to_body
from quadpi_core.logs import read_recording
from quadpi_core.logs.flight_table import write_flight_table
from quadpi_core.signals.wrench import measured_wrench


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_table_is_read_again_as_the_flight(flights, simulation, tmp_path, suffix):
    flight, path = flights[0], tmp_path / f"flown{suffix}"
    write_flight_table(path, flight, measured_wrench(flight, simulation.vehicle))
    again = read_recording(path, simulation.vehicle, "flight")
    stamps = flight.start_ns + np.round(1e9 * flight.time).astype(np.int64)
    # Readers of tables take time as floating-point numbers, which are 256 ns apart in this century.
    assert np.abs(again.odometry.time_ns - stamps).max() <= 256
    for name, values in {
        "position": flight.position,
        "attitude": flight.attitude,
        "velocity": flight.velocity,
        "rates": flight.rates,
    }.items():
        assert getattr(again.odometry, name) == pytest.approx(values, abs=1e-9), name
    assert again.imu.specific_force == pytest.approx(flight.specific_force, abs=1e-9)
    assert again.rotor_speeds.speeds == pytest.approx(flight.rotor_speeds)
    assert again.wind.velocity == pytest.approx(flight.wind)


def test_a_table_with_a_simulated_wrench_is_a_recorded_simulation(flights, simulation, tmp_path):
    flight, path = flights[0], tmp_path / "flown.parquet"
    write_flight_table(path, flight, measured_wrench(flight, simulation.vehicle))
    table = parquet.read_table(path)
    wrench = simulation.wrench(flight)
    for place, axis in enumerate(("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")):
        table = table.append_column(f"simulated_{axis}", [wrench[:, place]])
    parquet.write_table(table, path)
    again = read_recording(path, simulation.vehicle, "flight_simulated")
    assert again.simulated.wrench == pytest.approx(wrench)


def test_the_wrench_is_that_of_newton_and_euler(flights, simulation, tmp_path):
    """The force in the table is mass times acceleration, without gravity."""
    flight, path = flights[0], tmp_path / "flown.csv"
    vehicle = simulation.vehicle
    write_flight_table(path, flight, measured_wrench(flight, vehicle))
    columns = csv.read_csv(path).to_pydict()
    force = np.stack([columns[name] for name in ("fx_n", "fy_n", "fz_n")], axis=1)
    assert force == pytest.approx(vehicle.mass_kg * flight.specific_force, rel=0.05, abs=0.5)
    attitude = np.stack([columns[name] for name in ("qw", "qx", "qy", "qz")], axis=1)
    down = rotate_world_to_body(attitude, np.tile([0.0, 0.0, 1.0], (len(attitude), 1)))
    assert np.mean(np.sum(force * down, axis=1)) == pytest.approx(
        -vehicle.mass_kg * vehicle.gravity_m_s2, rel=0.1
    )


def test_another_ending_is_refused(flights, tmp_path):
    with pytest.raises(LogError, match=r"flown.mat: a table of a flight ends in .csv or .parquet"):
        write_flight_table(tmp_path / "flown.mat", flights[0], np.zeros((len(flights[0]), 6)))
    assert not list(tmp_path.iterdir())
