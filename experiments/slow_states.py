# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a slow state costs: models of flights whose motion capture is degraded to GPS, beside those of all of it.

Of each flight the smoothed state is taken at a few instants a second and given errors; commands, IMU and rotor
speeds stay. Models are identified on every second flight and judged on the others, and the other way round.

    python experiments/slow_states.py [--seeds 3] [--rate 5]
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

from quadpi_core import rotations
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
    tilts = rotations.from_rotation_vector(rng.normal(0.0, errors[1], (count, 3)))
    attitude = rotations.products(full.attitude[rows], tilts)
    moving = rotations.rotate_body_to_world(full.attitude[rows], full.velocity[rows])
    moving += rng.normal(0.0, errors[2], (count, 3))
    state = OdometryStream(
        full.stamps_ns[rows],
        full.position[rows] + rng.normal(0.0, errors[0], (count, 3)),
        attitude,
        rotations.rotate_world_to_body(attitude, moving),
        full.rates[rows],
        np.tile(errors, (count, 1)) if stated else np.zeros((count, 3)),
    )
    return replace(recording, pose=None, twist=None, odometry=state, arrivals={})


def drag(flights: Sequence[PreparedFlight], vehicle: Vehicle) -> Array:
    """Drag over mass and speed (2,) along x and y, 1/s, by the slope of specific force over velocity."""
    slopes = []
    for axis in range(2):
        rows = [
            np.stack([one.flight.velocity[:, axis], np.ones(len(one.time))], axis=1)
            for one in flights
            if one.flight is not None
        ]
        force = np.concatenate([one.wrench[:, axis] for one in flights]) / vehicle.mass_kg
        # Each flight has a bias of its own, which the flights with a slow state tell worse.
        columns = np.zeros((sum(map(len, rows)), 1 + len(rows)))
        start = 0
        for place, own in enumerate(rows):
            columns[start : start + len(own), 0] = own[:, 0]
            columns[start : start + len(own), 1 + place] = 1.0
            start += len(own)
        slopes.append(-float(np.linalg.lstsq(columns, force, rcond=None)[0][0]))
    return np.array(slopes)


@dataclass(frozen=True)
class Judged:
    """Errors of predictions on unseen flights: RMSE (6,), and the share (6,) inside of the intervals."""

    rmse: Array
    coverage: Array


def judged(vehicle: Vehicle, learned: Sequence[PreparedFlight], others: Sequence[PreparedFlight]) -> Judged:
    """A model of some flights, on others."""
    model = model_of(list(learned), vehicle, "physical")
    results = [predict_flight(model, one, model.confidence) for one in others]
    errors = np.concatenate([one.measured - one.predicted for one in results])
    inside = np.concatenate([(one.measured >= one.lower) & (one.measured <= one.upper) for one in results])
    return Judged(np.sqrt(np.mean(np.square(errors), axis=0)), np.mean(inside, axis=0))


def both_ways(vehicle: Vehicle, flights: Sequence[PreparedFlight], truth: Sequence[PreparedFlight]) -> Judged:
    """Models of each half of some flights on the other half as it truly was, and coverage on it as it is."""
    ways = [
        (
            judged(vehicle, flights[half::2], truth[1 - half :: 2]),
            judged(vehicle, flights[half::2], flights[1 - half :: 2]),
        )
        for half in (0, 1)
    ]
    rmse = np.sqrt(np.mean([np.square(one.rmse) for one, _ in ways], axis=0))
    return Judged(rmse, np.mean([own.coverage for _, own in ways], axis=0))


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
        recordings.append(recording), truth.append(prepared), full.append(smooth)
    best, known = both_ways(vehicle, truth, truth), drag(truth, vehicle)
    rows = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        stated = seed % 2 == 0
        slow = [
            prepare_recording(degraded(one, own, rng, rate_hz, stated=stated), vehicle, CUTOFF)
            for one, own in zip(recordings, full, strict=True)
        ]
        found, ratio = both_ways(vehicle, slow, truth), drag(slow, vehicle) / known
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
