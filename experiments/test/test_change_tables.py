# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
from change_tables import SOUND, all_faster, faster_rotor, flights_of, offset_accelerometer, row_of

from quadpi_core.logs import read_recording
from quadpi_core.paths import bags_directory
from quadpi_core.vehicle import Vehicle


def test_a_flight_is_altered_from_the_moment_on() -> None:
    recording = read_recording(bags_directory() / "interpolation.mcap", Vehicle.load("bebop2"))
    stamps = recording.rotor_speeds.time_ns
    begin_ns = int(stamps[len(stamps) // 2])
    late = stamps >= begin_ns
    ratio = faster_rotor(recording, begin_ns, 2, 0.03).rotor_speeds.speeds / recording.rotor_speeds.speeds
    np.testing.assert_allclose(ratio[late, 2], 1.0153, atol=1e-4)
    np.testing.assert_array_equal(ratio[:, [0, 1, 3]], 1.0)
    np.testing.assert_array_equal(ratio[~late], 1.0)
    ratio = all_faster(recording, begin_ns, 0, 0.015).rotor_speeds.speeds / recording.rotor_speeds.speeds
    np.testing.assert_allclose(ratio[late], 1.0076, atol=1e-4)
    force = offset_accelerometer(recording, begin_ns, 0, 0.015).imu.specific_force
    off = (force - recording.imu.specific_force)[:, 2]
    np.testing.assert_allclose(off, np.where(recording.imu.time_ns >= begin_ns, 0.1471, 0.0), atol=1e-4)


def test_a_row_counts_the_flights_without_an_alarm_too() -> None:
    row = row_of(
        "x",
        [0.4, 1.2, np.inf, 4.0],
        [True, False, False, True],
        [0.03, 0.02, 0.0, 0.04],
        [True, True, False, False],
    )
    assert row == ["x", "4", "25 %", "50 %", "50 %", "75 %", "67 %", "3 %", "50 %"]
    assert row_of("y", [np.inf], [False], [0.0], [None])[2:] == ["0 %"] * 4 + ["–", "–", "–"]


def test_random_halves_are_of_all_flights(tmp_path) -> None:
    (tmp_path / SOUND).mkdir()
    for k in range(20):
        (tmp_path / SOUND / f"flight{k:02d}").touch()
    usual, one, other = (flights_of(tmp_path, split) for split in (None, 1, 2))
    assert usual == sorted(usual)
    assert one == flights_of(tmp_path, 1) != other
    assert sorted(one) == sorted(other) == usual
