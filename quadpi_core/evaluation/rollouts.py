# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Open-loop predictions of a model on flights: errors at several horizons, and the tubes around them.

A tube follows its flight: once the roll-out that it was drawn around has ended, its factor grows where the
flight left it and shrinks slowly where not, so that the coverage of any flight approaches the nominal one
(quantile tracking, see `monitor.adaptive`, with errors that become known a horizon later). It starts at the
factor that was calibrated on flights left out.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadpi_core.errors import ModelError
from quadpi_core.findings import DataQuality
from quadpi_core.flight import Flight
from quadpi_core.flight_files import FlightFile, FlightLeftOut, LeftOutFlights, for_each_flight, once_each
from quadpi_core.frames import Array
from quadpi_core.identification.prepared_flights import read_flight
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.rollout_model import FlightRollouts, RolloutFlight, RolloutModel, horizon_steps
from quadpi_core.models.tubes import (
    HORIZONS_S,
    LARGEST,
    QUANTITIES,
    TRACKING_PER_S,
    Following,
    error_norms,
    require_horizon,
    tracked_factors,
    tube_radii,
    tube_scores,
)
from quadpi_core.parallel import ReportProgress, Workers, ignore_progress
from quadpi_core.reading_options import MappingOrOptions
from quadpi_core.vehicle import Vehicle
from quadpi_core.version import __version__

# Samples between the starts of roll-outs, of a flight at 100 Hz.
START_EVERY = 10
# Horizons [s] that are always judged, where they are not beyond the one asked for.
JUDGED_S = (0.01, 0.1, 0.5)
# Names of the quantities in results: angles are given in degrees there.
_NAMES = {"attitude_rad": ("attitude_deg", float(np.degrees(1.0)))}


@dataclass(frozen=True)
class TubeMetrics:
    """Errors and tubes of a quantity at one horizon of a flight.

    Attributes:
        rms: root mean square of the error's norm.
        coverage: share of roll-outs that ended in their tube.
        width: mean over the roll-outs of the diameter of the ball that has the volume of the tube; at most a
            whole turn.
        fixed_coverage, fixed_width: of tubes that do not follow the flight.
        conformal_coverage, conformal_width: of split conformal prediction, balls of one size from the same
            errors of the same flights left out.
        conformal_tracked_coverage, conformal_tracked_width: of such balls that follow the flight.
    """

    rms: float
    coverage: float
    width: float
    fixed_coverage: float
    fixed_width: float
    conformal_coverage: float
    conformal_width: float
    conformal_tracked_coverage: float
    conformal_tracked_width: float


@dataclass(frozen=True)
class FlightRolloutMetrics:
    """A flight's roll-outs judged.

    Attributes:
        starts: number of roll-outs.
        left_out: number of starts after which a rotor speed was not measured, or samples are missing.
        position_measured: whether errors of position are against a measured position; else they are against
            the integrated velocity.
        in_sample: whether the model was identified on this flight, by its hash.
        horizons: by horizon in seconds and quantity, such as "0.5" and "position_m".
    """

    starts: int
    left_out: int
    position_measured: bool
    in_sample: bool
    horizons: dict[str, dict[str, TubeMetrics]]


@dataclass(frozen=True)
class RolloutEvaluation:
    """Roll-outs of a model on flights; the names of the attributes are the keys of the JSON file.

    Attributes:
        data_quality: remarks on the data, by flight.
        left_out: flights that were given and cannot be predicted.
    """

    quadpi_version: str
    model: str
    vehicle: str
    confidence: float
    horizon_s: float
    flights: dict[str, FlightRolloutMetrics]
    data_quality: dict[str, DataQuality]
    left_out: tuple[FlightLeftOut, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return asdict(self)


class RolledFlight(NamedTuple):
    """Roll-outs of a flight with their tubes, for figures.

    Attributes:
        name: of the flight.
        quality: remarks on its data.
        horizons_s: (H,).
        flight: that was flown, at about 100 Hz.
        rolled: paths, errors, and the matrices of the tubes' ellipsoids for covariances.
        factors: (W, H, 4) on the ellipsoids.
    """

    name: str
    quality: DataQuality
    horizons_s: tuple[float, ...]
    flight: RolloutFlight
    rolled: FlightRollouts
    factors: Array


def evaluate_rollouts(
    model: AerodynamicModel,
    paths: Sequence[Path],
    vehicle: Vehicle,
    *,
    horizon_s: float = 0.5,
    confidence: float | None = None,
    mapping: MappingOrOptions = None,
    progress: ReportProgress = ignore_progress,
    left_out: LeftOutFlights = None,
) -> tuple[list[RolledFlight], RolloutEvaluation]:
    """Predict flights ahead, open loop from every tenth sample, with the measured rotor speeds.

    Args:
        model: of the vehicle that flew.
        paths: bags or logs.
        vehicle: that flew.
        horizon_s: to predict to.
        confidence: of the tubes; default: the model's.
        mapping: of the files, see :func:`quadpi_core.logs.read_recording`.
        progress: called after each flight.
        left_out: the list to which flights that cannot be predicted are added; without it, the first is an
            error.

    Raises:
        ModelError: for a model that is no simulation, or of another vehicle; a horizon or confidence that is
            not calibrated; naming the flight, for one that is shorter than the horizon.
        LogError, SignalError: for what cannot be read or used, naming the file, and a flight present twice.
    """
    model.require(vehicle)
    rollouts = model.require_rollouts()
    require_horizon(horizon_s)
    level = model.confidence if confidence is None else confidence

    def ahead(_: None, file: FlightFile) -> tuple[str, RolledFlight, FlightRolloutMetrics]:
        flight = replace(read_flight(file.path, vehicle, model.cutoff_hz, mapping), name=file.name)
        rolled, judged = judge_flight(rollouts, flight, vehicle, horizon_s=horizon_s, confidence=level)
        in_sample = model.learned_from(flight.sha256)
        return flight.sha256, rolled, replace(judged, in_sample=in_sample)

    workers = Workers(1, progress=progress)
    task = "Predicting flights ahead"
    done = for_each_flight(ahead, paths, shared=None, task=task, workers=workers, left_out=left_out)
    judged_flights = [(rolled, judged) for _, (_, rolled, judged) in once_each(done, itemgetter(0), left_out)]
    metrics = {rolled.name: judged for rolled, judged in judged_flights}
    return [rolled for rolled, _ in judged_flights], RolloutEvaluation(
        __version__,
        model.identity,
        model.vehicle,
        level,
        horizon_s,
        metrics,
        {rolled.name: rolled.quality for rolled, _ in judged_flights},
        tuple(left_out or ()),
    )


def judge_flight(
    model: RolloutModel, flight: Flight, vehicle: Vehicle, *, horizon_s: float, confidence: float
) -> tuple[RolledFlight, FlightRolloutMetrics]:
    """Predict one flight, which passed the low-pass of the model, ahead; see :func:`evaluate_rollouts`.

    Raises:
        ModelError: for a horizon or confidence that is not calibrated; naming the flight, where it is shorter
            than the horizon or no roll-out has all rotor speeds.
    """
    rollout_flight = RolloutFlight.from_flight(flight, vehicle)
    step = rollout_flight.step
    # Those calibrated up to the one asked for, which is the last.
    times = tuple(sorted({horizon for horizon in HORIZONS_S if horizon < horizon_s} | {horizon_s}))
    horizons = horizon_steps(times, step)
    possible = len(range(0, len(rollout_flight.time) - int(horizons[-1]), START_EVERY))
    if possible <= 0:
        raise ModelError(
            f"{flight.source}: {len(rollout_flight.time) * step:.2f} s in the air, "
            f"shorter than the horizon of {horizon_s:g} s"
        )
    starts = rollout_flight.starts(int(horizons[-1]), START_EVERY)
    if len(starts) == 0:
        raise ModelError(
            f"{flight.source}: topic rotor_speeds: a rotor was not measured within {horizon_s:g} s "
            f"of every start"
        )
    assert model.calibration is not None
    rolled = model.roll(rollout_flight, starts, horizons)
    rolled = rolled._replace(covariance=model.calibration.shape.shaped(rolled.covariance))
    scores, norms = tube_scores(rolled.errors, rolled.covariance), error_norms(rolled.errors)
    unit = tube_radii(rolled.covariance)
    following = Following(
        (-(-horizons // START_EVERY)).tolist(), 1.0 - confidence, TRACKING_PER_S * START_EVERY * step
    )
    factors = model.calibration.factors(times, confidence)
    balls = model.calibration.radii(times, confidence)
    tubes = tracked_factors(scores, factors, following)
    tracked_balls = tracked_factors(norms, balls, following)
    # Sizes of the errors, those that tubes hold, and the radii of these.
    ways = {
        "": (scores, tubes, tubes * unit),
        "fixed_": (scores, factors, factors * unit),
        "conformal_": (norms, balls, np.broadcast_to(balls, norms.shape)),
        "conformal_tracked_": (norms, tracked_balls, tracked_balls),
    }
    metrics: dict[str, dict[str, TubeMetrics]] = {}
    for k, q in itertools.product(range(len(times)), range(len(QUANTITIES))):
        if times[k] not in (*JUDGED_S, horizon_s):
            continue
        name = list(QUANTITIES)[q]
        shown, scale = _NAMES.get(name, (name, 1.0))
        values = {"rms": scale * float(np.sqrt(np.mean(np.square(norms[:, k, q]))))}
        for way, (sizes, held, radii) in ways.items():
            values[f"{way}coverage"] = float(np.mean((sizes <= held)[:, k, q]))
            values[f"{way}width"] = scale * float(np.mean(2.0 * np.minimum(radii[:, k, q], LARGEST[q])))
        metrics.setdefault(f"{times[k]:g}", {})[shown] = TubeMetrics(**values)
    return (
        RolledFlight(flight.name, flight.quality, times, rollout_flight, rolled, tubes),
        FlightRolloutMetrics(
            len(starts), possible - len(starts), flight.position_measured, in_sample=False, horizons=metrics
        ),
    )
