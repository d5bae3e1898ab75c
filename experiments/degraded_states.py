# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a slow state costs: models of flights whose motion capture is degraded to GPS, beside those of all.

Of each flight the smoothed state is taken at a few instants a second and given errors; IMU and rotor speeds
stay. Models are identified on every second flight and judged on the others, and the other way round.

    python experiments/degraded_states.py [--only neurobem] [--seeds 4] [--rate 5]
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from intervals_raced import model_of
from page_tables import renew

from quadpi_core import frames
from quadpi_core.errors import QuadpiError
from quadpi_core.estimator.fusion import fuse
from quadpi_core.evaluation.evaluate import predict_flight
from quadpi_core.flight import Flight, OdometryStream, Recording
from quadpi_core.frames import Array
from quadpi_core.identification.prepared_flights import PreparedFlight, prepare_recording
from quadpi_core.logs import read_recording
from quadpi_core.models.model_kind import CUTOFF_HZ
from quadpi_core.report.table import Column, Table, markdown_table
from quadpi_core.screening.consistency import checked
from quadpi_core.vehicle import Vehicle

PAGE = Path(__file__).parent / "results" / "slow-states.md"
CUTOFF = CUTOFF_HZ["default"]
# Of a state by GPS and an autopilot's attitude: m, rad, m/s.
GPS = (1.0, np.deg2rad(2.0), 0.1)
SETS = {"crazyflie_rpm": "imrc_brushless", "neurobem": "neurobem"}


def degraded(
    recording: Recording,
    full: Flight,
    rng: np.random.Generator,
    rate_hz: float,
    errors: Sequence[float] = GPS,
    *,
    stated: bool = True,
) -> Recording:
    """The recording with a slow state in the place of what told the state.

    Args:
        recording: as logged.
        full: its flight by all of motion capture.
        rng: of the errors.
        rate_hz: of the state.
        errors: standard deviations of position m, attitude rad and velocity m/s.
        stated: whether the state says them.
    """
    rows = np.arange(0, len(full), round(full.rate_hz / rate_hz))
    count = len(rows)
    tilts = frames.from_rotation_vector(rng.normal(0.0, errors[1], (count, 3)))
    attitude = frames.products(full.attitude[rows], tilts)
    moving = frames.rotate_body_to_world(full.attitude[rows], full.velocity[rows])
    moving += rng.normal(0.0, errors[2], (count, 3))
    state = OdometryStream(
        full.stamps_ns[rows],
        full.position[rows] + rng.normal(0.0, errors[0], (count, 3)),
        attitude,
        frames.rotate_world_to_body(attitude, moving),
        full.rates[rows],
        np.tile(errors, (count, 1)) if stated else np.zeros((count, 3)),
    )
    return replace(recording, pose=None, twist=None, odometry=state, arrivals={})


def drag(flights: Sequence[PreparedFlight], recordings: Sequence[Recording]) -> Array:
    """Drag over mass and speed (2,) along x and y, 1/s, by the slope of the accelerometer over velocity.

    The accelerometer is as it reads, with a bias for each flight: what differs is the velocity alone.
    """
    slopes = []
    for axis in range(2):
        gram, pull = 0.0, 0.0
        for one, recording in zip(flights, recordings, strict=True):
            assert one.flight is not None
            imu, stamps = recording.imu, one.flight.stamps_ns
            force = np.interp(stamps, imu.time_ns, imu.specific_force[:, axis])
            moving = one.flight.velocity[:, axis] - one.flight.velocity[:, axis].mean()
            gram, pull = gram + moving @ moving, pull + moving @ force
        slopes.append(-pull / gram)
    return np.array(slopes)


@dataclass(frozen=True)
class Judged:
    """Errors of predictions on unseen flights: RMSE (6,), and the share (6,) inside of the intervals."""

    rmse: Array
    coverage: Array


def judged(vehicle: Vehicle, flights: Sequence[PreparedFlight]) -> Judged:
    """Models of each half of some flights, on the other half."""
    errors, inside = [], []
    for half in (0, 1):
        model = model_of(list(flights[half::2]), vehicle, "physical")
        for flight in flights[1 - half :: 2]:
            one = predict_flight(model, flight, model.confidence)
            errors.append(one.measured - one.predicted)
            inside.append((one.measured >= one.lower) & (one.measured <= one.upper))
    return Judged(
        np.sqrt(np.mean(np.square(np.concatenate(errors)), axis=0)), np.mean(np.concatenate(inside), axis=0)
    )


def rows_of(vehicle_name: str, folder: Path, seeds: int, rate_hz: float) -> list[list[str]]:
    """The rows of one set of flights."""
    vehicle = Vehicle.load(vehicle_name)
    recordings, truth, full = [], [], []
    for path in sorted(folder.iterdir()):
        try:
            recording = checked(read_recording(path, vehicle), vehicle)
            prepared = prepare_recording(recording, vehicle, CUTOFF)
            smooth = fuse(recording, vehicle, CUTOFF)
        except QuadpiError as error:
            print(f"{path.name}: left out: {error}", flush=True)
            continue
        recordings.append(recording)
        truth.append(prepared)
        full.append(smooth)
    best, known = judged(vehicle, truth), drag(truth, recordings)
    rows = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        stated = seed % 2 == 0
        slow = [
            prepare_recording(degraded(one, own, rng, rate_hz, stated=stated), vehicle, CUTOFF)
            for one, own in zip(recordings, full, strict=True)
        ]
        found, ratio = judged(vehicle, slow), drag(slow, recordings) / known
        rmse, share = found.rmse / best.rmse, found.coverage
        rows.append(
            [
                f"{vehicle_name}, {len(slow)} flights",
                str(seed),
                "messages" if stated else "the flights",
                *(f"{100.0 * (one - 1.0):+.1f} %" for one in ratio),
                *(f"{one:.2f}" for one in rmse[:2]),
                f"{max(rmse[2:]):.2f}",
                f"{100.0 * min(share):.1f} %",
            ]
        )
        print(rows[-1], flush=True)
    return rows


def main() -> None:
    """Measure, and renew the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--rate", type=float, default=5.0, help="of the state, Hz")
    parser.add_argument("--only", choices=tuple(SETS))
    parser.add_argument("--page", type=Path, default=PAGE)
    given = parser.parse_args()
    data = Path(os.environ.get("QUADPI_DATA", Path(__file__).parents[2] / "shared" / "data"))
    rows = []
    for vehicle, folder in SETS.items():
        if given.only in (None, vehicle):
            rows += rows_of(vehicle, data / folder, given.seeds, given.rate)
    columns = ("seed", "noise by", "drag x", "drag y", "RMSE Fx", "Fy", "worst other", "least coverage")
    table = Table([Column("flights", is_text=True), *map(Column, columns)], rows)
    renew(given.page, {"degraded": markdown_table(table)})


if __name__ == "__main__":
    main()
