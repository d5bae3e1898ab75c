# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The nano-drone benchmark: open-loop predictions half a second ahead, beside the published ones.

Busetto et al., Nonlinear system identification for a nano-drone benchmark, Control Engineering Practice 172
(2026). From every sample of a test flight, 50 steps of 0.01 s by the measured rotor speeds; mean over all
starts of the Euclidean norms of the errors after 1, 10 and 50 steps. Run by `make nanodrone`.

What is used of a test flight before a start, and nothing after it but the rotor speeds: the state at the
start, the residual wrench that the past left (`quadpi_core.models.physical_rollout`), and by which delay of
the rotor speeds the flight so far is predicted best.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console

from quadpi_core.errors import LogError, QuadpiError
from quadpi_core.flight import Flight
from quadpi_core.frames import Array, rotate_body_to_world, rotate_world_to_body
from quadpi_core.logs import read_recording
from quadpi_core.models.kinds.physical import PhysicalStudy
from quadpi_core.models.multi_step_fit import fit_multi_step
from quadpi_core.models.physical_fit import PhysicalFlight, Problem, Sensing
from quadpi_core.models.physical_rollout import ATTITUDE, RATES, STATES, VELOCITY, Disturbance
from quadpi_core.models.rollout_model import RolloutFlight, RolloutModel, disturbance_left
from quadpi_core.paths import data_directory, write_json
from quadpi_core.report.table import Cell, Column, Mark, Row, Table, number, terminal_table
from quadpi_core.vehicle import Vehicle

VEHICLE = "nanodrone"
DATA = data_directory() / "nanodrone_benchmark"
OUTPUT = Path("out/nanodrone.json")
# The authors' own validation flights, of each family the last: not trained on.
VALIDATION = (
    "multisine_20251017_run4",
    "random1_20251017_run4",
    "random2_20251017_run4",
    "square_20251017_run5",
)
STEPS = (1, 10, 50)
QUANTITIES = ("position_m", "velocity_m_s", "attitude_rad", "rates_rad_s")
# As published for the test flights "melon"; h 1, 10 and 50 of each quantity.
PUBLISHED = {
    "naive": (
        (0.0143, 0.1430, 0.6797),
        (0.0329, 0.3182, 1.4749),
        (0.0071, 0.0692, 0.3041),
        (0.0796, 0.3596, 0.8837),
    ),
    "physics (rates held)": (
        (0.0013, 0.0126, 0.1269),
        (0.0080, 0.0570, 0.5781),
        (0.0011, 0.0205, 0.2544),
        (0.0796, 0.3596, 0.8837),
    ),
    "MLP": (
        (0.0032, 0.0305, 0.1712),
        (0.0116, 0.0890, 0.5720),
        (0.0022, 0.0331, 0.2268),
        (0.1138, 0.5949, 0.9005),
    ),
    "physics + residual": (
        (0.0016, 0.0166, 0.1119),
        (0.0092, 0.0613, 0.5556),
        (0.0027, 0.0376, 0.2306),
        (0.0912, 0.4880, 0.5979),
    ),
    "LSTM": (
        (0.0079, 0.0390, 0.2572),
        (0.0247, 0.1175, 0.7407),
        (0.0066, 0.0372, 0.2325),
        (0.1021, 0.4292, 1.2407),
    ),
}
# Delays of the rotor speeds [s] that are tried: those of the training families differ by as much.
DELAYS_S = (0.0, 0.005, 0.01, 0.015, 0.02, 0.03)
# Mean residuals over this time [s] tell delays apart: below it the gyro's derivative is noise.
_DELAY_SPAN_S = 0.1
# Rounds of parameters, and of the disturbance that they leave, which differs from that of the first step:
# with the second, rates of families left out (multisine, random2) err by 0.5 to 6 % less after half a second.
_ROUNDS = 2
# A test flight's delay is looked for again after so many seconds of it.
_DELAY_EVERY_S = 5.0


@dataclass(frozen=True)
class BenchmarkFlight:
    """A flight as the benchmark has it, and the same to predict.

    Attributes:
        position: (N, 3) m, world.
        own: states and rotor speeds, with the wrench by central differences.
    """

    position: Array
    own: RolloutFlight

    @classmethod
    def read(cls, path: Path, vehicle: Vehicle) -> BenchmarkFlight:
        """Read a table of the benchmark.

        Raises:
            LogError: naming the file and what it lacks.
        """
        recording = read_recording(path, vehicle, VEHICLE)
        state, speeds = recording.odometry, recording.rotor_speeds
        if state is None or speeds is None:
            raise LogError(f"{path}: topics odometry and rotor_speeds are needed")
        seconds = 1e-9 * (state.time_ns - state.time_ns[0])
        if len(seconds) <= STEPS[-1] or not np.allclose(np.diff(seconds), 0.01, atol=1e-3):
            raise LogError(
                f"{path}: topic odometry: {STEPS[-1] + 1} samples or more, 0.01 s apart, are needed"
            )
        spinning = 1e-9 * (speeds.time_ns - state.time_ns[0])
        rotors = np.stack([np.interp(seconds, spinning, speeds.speeds[:, k]) for k in range(4)], axis=1)
        world = rotate_body_to_world(state.attitude, state.velocity)
        acceleration = np.gradient(world, seconds, axis=0) - [0.0, 0.0, vehicle.gravity_m_s2]
        flight = Flight(
            name=recording.name,
            vehicle=vehicle.name,
            source=str(path),
            start_ns=int(state.time_ns[0]),
            time=seconds,
            position=state.position,
            attitude=state.attitude,
            velocity=state.velocity,
            rates=state.rates,
            angular_acceleration=np.gradient(state.rates, seconds, axis=0),
            specific_force=rotate_world_to_body(state.attitude, acceleration),
            rotor_speeds=rotors,
            wind=np.zeros_like(world),
        )
        return cls(state.position, RolloutFlight.from_flight(flight, vehicle))

    @property
    def velocity(self) -> Array:
        """(N, 3) m/s, world."""
        return rotate_body_to_world(self.own.attitude, self.own.motion["velocity"])


class PositionLink(NamedTuple):
    """How the measured position moves by the measured velocity, each axis of the world by itself.

    The onboard estimate of the velocity is larger by a tenth along x and y than the position moves.

    Attributes:
        scale: (3,) of the velocity.
        drift: (3,) m/s.
        lag: (3,) s that the position is ahead.
    """

    scale: Array
    drift: Array
    lag: Array

    @classmethod
    def of(cls, flights: Sequence[BenchmarkFlight]) -> PositionLink:
        """By least squares over a tenth of a second."""
        span = STEPS[1]
        rows, moved = [], []
        for flight in flights:
            velocity, step = flight.velocity, flight.own.step
            way = np.cumsum(0.5 * step * (velocity[1:] + velocity[:-1]), axis=0)
            flown = way[span:] - way[:-span]
            rows.append(
                np.stack(
                    (flown, np.full_like(flown, span * step), velocity[span + 1 :] - velocity[1:-span]), -1
                )
            )
            moved.append(flight.position[span + 1 :] - flight.position[1:-span])
        all_rows, all_moved = np.concatenate(rows), np.concatenate(moved)
        found = [np.linalg.lstsq(all_rows[:, axis], all_moved[:, axis], rcond=None)[0] for axis in range(3)]
        return cls(*np.array(found).T)

    def moved(self, flown: Array, seconds: float, change: Array) -> Array:
        """Displacement (W, 3) after so many seconds, of the integrated velocity and its change (W, 3)."""
        result: Array = self.scale * flown + self.drift * seconds + self.lag * change
        return result


class Trained(NamedTuple):
    """What was trained."""

    model: RolloutModel
    link: PositionLink


def train(flights: Sequence[BenchmarkFlight], vehicle: Vehicle) -> Trained:
    """Fit the physical model to single samples, then to predictions over half a second."""
    own = [flight.own for flight in flights]
    physical = [
        PhysicalFlight(
            flight.name,
            flight.time,
            flight.motion,
            np.gradient(flight.motion["rotor_accelerations"], flight.time, axis=0),
            flight.wrench,
        )
        for flight in own
    ]
    delay, step = float(np.median(DELAYS_S)), own[0].step
    study = PhysicalStudy.from_flights(physical, vehicle, sensing=Sensing(delay))

    def first_step(left_out: int | None) -> RolloutModel:
        fit = study.fit(choose=False, left_out=left_out)
        return RolloutModel(
            fit.values,
            fit.covariance,
            fit.vehicle,
            vehicle.inertia,
            vehicle.gravity_m_s2,
            delay,
            Disturbance.nothing(step),
            np.full(STATES, 1e-12),
            # Central differences: the residual of a sample is known with the next.
            lead_s=step,
        )

    start = first_step(None)
    delays = [DELAYS_S[int(np.argmin(delay_costs(flight, start)[-1]))] for flight in own]
    # Each flight with its own delay, to models without any.
    late = [flight.delayed(there) for flight, there in zip(own, delays, strict=True)]
    apart = [replace(first_step(k), rotor_delay_s=0.0) for k in range(len(own))]
    whole, problem = replace(start, rotor_delay_s=0.0), Problem.from_vehicle(vehicle, study.reference)
    process = disturbance_left(apart, late)
    for _ in range(_ROUNDS):
        # By the terms, not by the first step: central differences of the logged states are mostly noise.
        found = fit_multi_step(late, replace(whole, disturbance=process), apart, problem, by_terms=True)
        process = disturbance_left(found.left_out, late)
    model = replace(found.model, disturbance=process)
    return Trained(replace(model, rotor_delay_s=float(np.median(delays))), PositionLink.of(flights))


def delay_costs(flight: RolloutFlight, model: RolloutModel) -> Array:
    """Sum (N, D) up to each sample of the squared mean moments that each delay of DELAYS_S leaves."""
    span = max(1, round(_DELAY_SPAN_S / flight.step))
    costs = []
    for delay in DELAYS_S:
        moments = replace(model, rotor_delay_s=delay).residuals(flight)[:, 3:5] / np.diag(model.inertia)[:2]
        summed = np.cumsum(np.vstack((np.zeros(2), moments)), axis=0)
        means = (summed[span:] - summed[:-span]) / span
        squares = np.sum(np.square(means), axis=1)
        costs.append(np.concatenate((np.zeros(span - 1), np.cumsum(squares))))
    return np.stack(costs, axis=1)


def predict(trained: Trained, flight: BenchmarkFlight) -> Array:
    """Norms (W, 3, 4) of the errors from every sample, after the steps and by quantity of the benchmark."""
    own, horizons = flight.own, np.array(STEPS)
    starts = np.arange(len(own.time) - STEPS[-1])
    costs, every = delay_costs(own, trained.model), round(_DELAY_EVERY_S / own.step)
    norms = np.zeros((len(starts), len(STEPS), len(QUANTITIES)))
    velocity = flight.velocity
    for first in range(0, len(starts), every):
        rows = starts[first : first + every]
        # Of the flight so far, but for the sample whose derivative needs the next one.
        delay = DELAYS_S[int(np.argmin(costs[first - 2]))] if first else trained.model.rotor_delay_s
        rolled = replace(trained.model, rotor_delay_s=delay).predicted(own, rows, horizons)
        for place, steps in enumerate(STEPS):
            errors = rolled.errors[:, place]
            end = rows + steps
            change = velocity[end] + errors[:, VELOCITY] - velocity[rows]
            flown = rolled.path["displacement"][:, steps]
            moved = trained.link.moved(flown, steps * own.step, change)
            position = moved - (flight.position[end] - flight.position[rows])
            parts = (position, errors[:, VELOCITY], errors[:, ATTITUDE], errors[:, RATES])
            norms[rows, place] = np.stack([np.linalg.norm(part, axis=1) for part in parts], axis=1)
    return norms


def benchmark_table(means: Array, seconds: float) -> Table:
    """The published table with our row, (3, 4) by steps and quantity."""
    columns = [Column("model", is_text=True)]
    for quantity in QUANTITIES:
        name, _, unit = quantity.partition("_")
        label = f"{name} {unit.replace('_', '/')}"
        columns += [Column(f"h{steps}", number, group=label) for steps in STEPS]
    rows: list[Row] = [
        [name, *(value for own in table for value in own)] for name, table in PUBLISHED.items()
    ]
    best = np.min(list(PUBLISHED.values()), axis=0).T
    ours = [
        Cell(float(means[h, q]), Mark.GOOD if means[h, q] < best[h, q] else None)
        for q in range(len(QUANTITIES))
        for h in range(len(STEPS))
    ]
    note = (
        f"Published: three flights of a family of its own, melon. Trained and predicted in {seconds:.0f} s."
    )
    return Table(columns, [*rows, ["quadpi, physical", *ours]], note=note)


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, predict, print the table and write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "test", nargs="?", type=Path, help="folder of test flights; default: validation flights"
    )
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the training flights")
    parser.add_argument("--output", type=Path, default=OUTPUT)
    parser.add_argument("--without", default="", help="family that is not trained on, and tested")
    given = parser.parse_args(arguments)
    # The table has twelve columns of numbers.
    console = Console(markup=False, width=120)
    begun = time.monotonic()
    vehicle = Vehicle.load(VEHICLE)
    known = {path.stem: path for path in sorted(given.data.glob("*.parquet"))}
    if not known:
        raise LogError(f"{given.data}: no flights of the benchmark (*.parquet) to train on")
    left_out = (
        [name for name in known if name.startswith(given.without)] if given.without else list(VALIDATION)
    )
    tests = [known[name] for name in left_out if name in known]
    if given.test is not None:
        tests = sorted(given.test.glob("*.parquet"))
        if not tests:
            raise LogError(f"{given.test}: no flights (*.parquet) to predict")
    flights = [BenchmarkFlight.read(path, vehicle) for path in tests]
    training = [BenchmarkFlight.read(path, vehicle) for name, path in known.items() if name not in left_out]
    trained = train(training, vehicle)
    console.print(f"trained on {len(training)} flights in {time.monotonic() - begun:.0f} s")
    norms = [predict(trained, flight) for flight in flights]
    for flight, own in zip(flights, norms, strict=True):
        console.print(f"{flight.own.name}: {np.round(own.mean(axis=0)[1:], 4).tolist()}")
    means = np.concatenate(norms).mean(axis=0)
    console.print(terminal_table(benchmark_table(means, time.monotonic() - begun)))
    given.output.parent.mkdir(parents=True, exist_ok=True)
    write_json(
        given.output,
        {
            f"{steps}": dict(zip(QUANTITIES, means[place].tolist(), strict=True))
            for place, steps in enumerate(STEPS)
        },
    )


if __name__ == "__main__":
    try:
        main()
    except QuadpiError as error:
        sys.exit(f"nanodrone: {error}")
