# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The benchmark of nano-drones: its protocol on flights made here, and on its own where they are."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

from quadpi_core.errors import LogError
from quadpi_core.vehicle import Vehicle


def write_table(path: Path, seconds: float, scale: float = 1.0) -> None:
    """A flight on a circle, level; its velocity reads `scale` times what the position moves by."""
    time = np.arange(0.0, seconds, 0.01)
    x, y = np.sin(time), np.cos(time)
    one, zero = np.ones_like(time), np.zeros_like(time)
    signals = {
        ("t",): (time,),
        ("x", "y", "z"): (x, y, one),
        ("qw", "qx", "qy", "qz"): (one, zero, zero, zero),
        ("vx", "vy", "vz"): (scale * y, -scale * x, zero),
        ("wx", "wy", "wz"): (zero, zero, zero),
        ("ax", "ay", "az"): (-x, -y, 9.81 * one),
        ("m1_erpm", "m2_erpm", "m3_erpm", "m4_erpm"): (98000.0 * one,) * 4,
        ("Vbat",): (4.0 * one,),
    }
    columns = {
        name: column for names, values in signals.items() for name, column in zip(names, values, strict=True)
    }
    pq.write_table(pa.table(columns), path)


def test_states_are_read_in_the_frames_of_the_core(tool: ModuleType, tmp_path: Path) -> None:
    write_table(tmp_path / "circle.parquet", 3.0)
    flight = tool.BenchmarkFlight.read(tmp_path / "circle.parquet", Vehicle.load("nanodrone"))
    assert len(flight.own.time) == 300
    # East-north-up to north-east-down.
    np.testing.assert_allclose(flight.position[0], [1.0, 0.0, -1.0], atol=1e-9)
    np.testing.assert_allclose(flight.velocity[0], [0.0, 1.0, 0.0], atol=1e-9)
    assert np.median(flight.own.motion["rotor_speeds"]) == pytest.approx(98000 / 6 * 2 * np.pi / 60)
    np.testing.assert_allclose(flight.own.wrench[150, 2], -0.045 * 9.80665, rtol=1e-3)


def test_a_velocity_that_reads_too_large_is_scaled(tool: ModuleType, tmp_path: Path) -> None:
    write_table(tmp_path / "circle.parquet", 20.0, 1.1)
    flight = tool.BenchmarkFlight.read(tmp_path / "circle.parquet", Vehicle.load("nanodrone"))
    link = tool.PositionLink.of([flight])
    np.testing.assert_allclose(link.scale[:2], 1.0 / 1.1, rtol=1e-3)
    np.testing.assert_allclose(link.drift, 0.0, atol=1e-3)


def test_flights_that_are_too_short_or_missing_are_refused(tool: ModuleType, tmp_path: Path) -> None:
    write_table(tmp_path / "short.parquet", 0.4)
    with pytest.raises(LogError, match=r"short\.parquet: topic odometry: 51 samples or more"):
        tool.BenchmarkFlight.read(tmp_path / "short.parquet", Vehicle.load("nanodrone"))
    with pytest.raises(LogError, match="no flights of the benchmark"):
        tool.main(["--data", str(tmp_path / "nowhere")])


def test_our_row_stands_below_what_is_published(tool: ModuleType) -> None:
    means = np.zeros((3, 4))
    means[2, 3] = 1.0
    table = tool.benchmark_table(means, 60.0)
    ours = table.cells[-1]
    assert len(table.cells) == len(tool.PUBLISHED) + 1
    assert [cell.mark is not None for cell in ours[1:]] == [True] * 11 + [False]


@pytest.mark.slow
def test_the_protocol_on_a_family_that_was_not_trained_on(
    tool: ModuleType, shared_data: Path, tmp_path: Path
) -> None:
    """Minutes: trains on the families but one, and predicts that one."""
    arguments = ["--data", str(shared_data / "nanodrone_benchmark"), "--without", "random1"]
    tool.main([*arguments, "--output", str(tmp_path / "result.json")])
    result = json.loads((tmp_path / "result.json").read_text())
    assert list(result) == ["1", "10", "50"]
    assert list(result["50"]) == list(tool.QUANTITIES)
    held = holding(tool, sorted((shared_data / "nanodrone_benchmark").glob("random1*.parquet")))
    # Rates are noisy: a tenth of a second ahead a model gains little on holding them.
    assert result["10"]["rates_rad_s"] < 0.98 * held["10"]["rates_rad_s"]
    assert result["50"]["rates_rad_s"] < 0.75 * held["50"]["rates_rad_s"]
    assert result["50"]["attitude_rad"] < 0.6 * held["50"]["attitude_rad"]
    assert result["10"]["position_m"] < 0.1 * held["10"]["position_m"]


def holding(tool: ModuleType, paths: Sequence[Path]) -> dict[str, dict[str, float]]:
    """Errors of a prediction that nothing changes, by the protocol."""
    errors = []
    for path in paths:
        flight = tool.BenchmarkFlight.read(path, Vehicle.load("nanodrone"))
        starts = np.arange(len(flight.position) - 50)
        turns = Rotation.from_quat(flight.own.attitude[:, [1, 2, 3, 0]])
        for steps in (1, 10, 50):
            turned = (turns[starts].inv() * turns[starts + steps]).magnitude()
            moved = [
                np.linalg.norm(signal[starts + steps] - signal[starts], axis=1)
                for signal in (flight.position, flight.own.motion["rates"])
            ]
            errors.append((str(steps), moved[0], turned, moved[1]))
    return {
        steps: {
            name: float(np.mean(np.concatenate([own[place] for own in errors if own[0] == steps])))
            for place, name in ((1, "position_m"), (2, "attitude_rad"), (3, "rates_rad_s"))
        }
        for steps in ("1", "10", "50")
    }
