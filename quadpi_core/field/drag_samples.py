# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The samples of a flight that tell of drag: specific force, velocity over ground, attitude, air density."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quadpi_core.field.airborne import Flown, velocity_of
from quadpi_core.field.estimates import PIECES_FEWEST
from quadpi_core.field.field_log import FieldLog
from quadpi_core.frames import Array, rotation_matrix
from quadpi_core.inputs import STANDARD_DENSITY
from quadpi_core.records import Threshold

# Samples are means of the specific force over a fifth of a second: no state comes less often, and vibration
# and the lever arm of the IMU average out.
STEP_S = 0.2
PIECE_S = Threshold(
    "shortest and longest pieces that intervals leave out; a tenth of the flights lies between",
    (3.0, 10.0),
    "s",
    "gusts at 2 to 50 m of height are correlated for 1 to 10 s at 5 m/s and more (Dryden, MIL-F-8785C)",
    "simulated windy flights of seeds below 100, other than those whose coverage is counted",
)
# Pieces of one flight: an hour takes no more than ten minutes do.
_PIECES_MOST = 60


@dataclass(frozen=True)
class DragSamples:
    """Samples (N,) of one flight, a fifth of a second apart where it was in the air.

    Attributes:
        time: s.
        piece: (N,) the piece of flight of each.
        force: (N, 3) m/s² body.
        velocity: (N, 3) m/s over ground, world.
        turn: (N, 3, 3) body to world.
        density: kg/m³, of the air; None where the log does not tell it.
    """

    time: Array
    piece: Array
    force: Array
    velocity: Array
    turn: Array
    density: float | None

    def every(self, stride: int) -> DragSamples:
        """One sample of so many."""
        own = (self.time, self.piece, self.force, self.velocity, self.turn)
        time, piece, force, velocity, turn = (values[::stride] for values in own)
        return DragSamples(time, piece, force, velocity, turn, self.density)

    @property
    def air_ratio(self) -> float:
        """Density of the air over that of standard air; 1 where it is not known."""
        return 1.0 if self.density is None else self.density / STANDARD_DENSITY

    @property
    def body_velocity(self) -> Array:
        """Velocity over ground (N, 3) in body axes."""
        body: Array = np.einsum("nji,nj->ni", self.turn, self.velocity)
        return body


def piece_lengths_s(airborne_s: Sequence[float]) -> list[float]:
    """Length of the pieces of each flight that intervals leave out.

    Of many flights drag leaves out whole ones, and the pieces tell of the wind of theirs alone.
    """
    together = sum(airborne_s)
    return [_length_s(own if len(airborne_s) >= PIECES_FEWEST.value else together) for own in airborne_s]


def _length_s(airborne_s: float) -> float:
    usual = float(np.clip(0.1 * airborne_s, PIECE_S.value[0], PIECE_S.value[1]))
    return max(usual, airborne_s / _PIECES_MOST)


def drag_samples(log: FieldLog, flight: Flown, piece_s: float) -> DragSamples | str:
    """The samples of a flight that tell of drag, or what the log lacks for them.

    Args:
        log: of the flight.
        flight: when it was in the air.
        piece_s: see :func:`piece_lengths_s`.
    """
    velocity = velocity_of(log)
    if log.imu is None or log.attitude is None or velocity is None:
        needed = {"specific force": log.imu, "attitude": log.attitude, "velocity": velocity}
        lacking = [name for name, series in needed.items() if series is None]
        return f"the log has no {' and no '.join(lacking)}"
    times, pieces, forces = [], [], []
    count = 0
    for one in flight.stretches:
        edges = np.arange(one.begin, one.end, STEP_S)
        if len(edges) < 2:
            continue
        middle = 0.5 * (edges[1:] + edges[:-1])
        forces.append(log.imu.filled_means(edges)[:, 3:])
        times.append(middle)
        parts = max(1, round(one.duration_s / piece_s))
        place = np.minimum((parts * np.arange(len(middle))) // len(middle), parts - 1)
        pieces.append(count + place)
        count += parts
    if not times:
        return "the flight is too short"
    time = np.concatenate(times)
    moving, attitude, force = velocity.at(time), log.attitude.at(time), np.concatenate(forces)
    length = np.linalg.norm(attitude, axis=1, keepdims=True)
    good = np.isfinite(np.hstack([moving, attitude, force])).all(axis=1) & (length[:, 0] > 0.5)
    if not good.any():
        return "specific force, attitude and velocity do not overlap"
    air = None if log.density is None else float(np.median(log.density.values))
    return DragSamples(
        time[good],
        np.concatenate(pieces)[good].astype(np.int64),
        force[good],
        moving[good],
        rotation_matrix(attitude[good] / length[good]),
        air,
    )
