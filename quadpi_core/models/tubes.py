# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Tubes around roll-outs: covariance of their errors, and its shape and size, calibrated on other flights.

What is uncertain is the start state, the parameters, and the wrench that the model lacks: a first-order
Markov process on each axis, known at the start as well as the past of the flight tells it. Their covariance
is carried along the predicted path by the linearised equations of motion, as an extended Kalman filter does
(Jategaonkar, Flight Vehicle System Identification, 2015, 5.3). What an attitude error does to force and
moment is linearised statistically (Gelb, Applied Optimal Estimation, 1974, 6.2): it does not grow beyond a
half turn. Attitude errors are rotation vectors in body axes.

The tube of a quantity (position, velocity, attitude or rates) at a horizon is the ellipsoid eᵀ Σ⁻¹ e ≤ f²
of a covariance Σ. That of the physics knows which errors grow in which direction and at which start, better
in some quantities and on some vehicles than in others. Two numbers of each quantity say how far it is
believed: the share of a ball in the covariance, and the power of its size by which a tube grows; with a whole
share and no power the tube is the ball of split conformal prediction. They are those with the narrowest
tubes on flights left out.

Per flight, the quantile of the score √(eᵀ Σ⁻¹ e) is the factor f that would have covered that flight; the
geometric mean over the flights is used, so that the coverage of the next flight lies about the nominal one,
neither above nor below. Split conformal prediction of |e|, whose regions are balls of one size, is kept
beside it for comparison.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.interval_rules import LEVELS, require_confidence
from quadpi_core.models.physical_rollout import ATTITUDE, POSITION, RATES, STATES, VELOCITY, Track
from quadpi_core.records import Records

# Rows of an error by the name of the quantity, with its unit.
QUANTITIES = {
    "position_m": POSITION,
    "velocity_m_s": VELOCITY,
    "attitude_rad": ATTITUDE,
    "rates_rad_s": RATES,
}
# Horizons [s] that are calibrated; factors in between are interpolated.
HORIZONS_S = (0.01, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 1.0)
# Shapes that are tried: from the physics alone to a ball of one size.
SHARES = (0.0, 0.3, 0.6, 1.0)
POWERS = (1.0, 0.75, 0.5, 0.25, 0.0)
# No attitude errs by more than half a turn: larger tubes are the whole.
LARGEST = np.array([np.pi if name == "attitude_rad" else np.inf for name in QUANTITIES])
# How fast a tube follows its flight [1/s], see `monitor.adaptive`. At ten starts a second the factor grows by
# 46 % after a miss and shrinks by 2 % after a hit. A flight of 30 s whose errors are three times those of the
# calibration then has 0.9 % more misses than nominal; half as fast, twice as many.
TRACKING_PER_S = 4.0
# Flights of the model itself may have no error at all at the first horizon.
_LEAST = np.finfo(float).tiny


class Uncertainty(NamedTuple):
    """Uncertainty at the start of a roll-out and per step: variances, and the decay of the disturbance.

    Attributes:
        state: (12,) of position, velocity, attitude and rates of a state, at the start and at the horizon.
        wrench: (6,) of the disturbance at the start.
        drive: (6,) process noise of the disturbance per step.
        decay: (6,) factor of the disturbance per step.
        parameters: (P, P) covariance of the parameters.
    """

    state: Array
    wrench: Array
    drive: Array
    decay: Array
    parameters: Array


def error_covariance(
    track: Track,
    starts: npt.NDArray[np.int64],
    horizons: npt.NDArray[np.int64],
    path: Records,
    parameters: Array,
    uncertainty: Uncertainty,
) -> Array:
    """Covariance (W, H, 12, 12) of the errors of W roll-outs at H horizons, by the physics.

    Args:
        track: the flight.
        starts: (W,) samples that the roll-outs started from.
        horizons: (H,) steps after the start, rising.
        path: MOVING (W, S + 1) that they took.
        parameters: (P,) of the model.
        uncertainty: at the start.
    """
    covariance = np.zeros((len(starts), len(horizons), STATES, STATES))
    compiled.error_covariance(track.in_rows(), starts, horizons, path, parameters, uncertainty, covariance)
    return covariance


class TubeShape(NamedTuple):
    """Shape of the tubes of each quantity.

    Attributes:
        round_share: (4,) share of a ball in the covariance, at the same mean variance.
        size_power: (4,) power of the size of an ellipsoid that its tube is proportional to.
    """

    round_share: Array
    size_power: Array

    def shaped(self, covariance: Array) -> Array:
        """Matrices (..., 12, 12) of the tubes' ellipsoids for a covariance of errors (..., 12, 12).

        Blocks of two quantities are zero. A power below one leaves a unit that the factor makes up for.
        """
        result = np.zeros_like(covariance)
        for quantity, part in enumerate(QUANTITIES.values()):
            own, share = covariance[..., part, part], self.round_share[quantity]
            mean = np.trace(own, axis1=-2, axis2=-1)[..., np.newaxis, np.newaxis] / 3.0
            mixed = (1.0 - share) * own + share * mean * np.eye(3)
            size = np.linalg.det(mixed)[..., np.newaxis, np.newaxis] ** (1.0 / 3.0)
            result[..., part, part] = mixed * size ** (self.size_power[quantity] - 1.0)
        return result


# Where flights are too few to choose one.
USUAL = TubeShape(np.array([0.3, 0.3, 0.0, 0.0]), np.ones(4))


def error_norms(errors: Array) -> Array:
    """Euclidean norm (W, H, 4) of each quantity of errors (W, H, 12)."""
    return np.stack([np.linalg.norm(errors[..., part], axis=-1) for part in QUANTITIES.values()], axis=-1)


def tube_scores(errors: Array, covariance: Array) -> Array:
    """Size (W, H, 4) of errors (W, H, 12) in terms of their covariance (W, H, 12, 12)."""
    scores = []
    for part in QUANTITIES.values():
        part_errors = errors[..., part]
        weighed = np.linalg.solve(covariance[..., part, part], part_errors[..., np.newaxis])[..., 0]
        scores.append(np.sqrt(np.sum(part_errors * weighed, axis=-1)))
    return np.stack(scores, axis=-1)


def tube_radii(covariance: Array) -> Array:
    """Radius (W, H, 4) of the ball that has the volume of the ellipsoid with factor 1."""
    blocks = [covariance[..., part, part] for part in QUANTITIES.values()]
    return np.stack([np.linalg.det(block) ** (1.0 / 6.0) for block in blocks], axis=-1)


class Following(NamedTuple):
    """How the size of tubes adapts to the errors of a flight, after Gibbs and Candès.

    Attributes:
        delays: (H,) starts after which the error of a horizon is known.
        miss_share: nominal share of misses.
        gain: step of the logarithm of the factor.
    """

    delays: Sequence[int]
    miss_share: float
    gain: float


def tracked_factors(scores: Array, calibrated: Array, following: Following) -> Array:
    """Factors (W, H, 4) that follow the scores (W, H, 4) of roll-outs once they have ended.

    Args:
        scores: smallest factor that covers each error, in the order of the starts.
        calibrated: (H, 4) factors to begin with.
        following: of the flight.
    """
    log = np.zeros_like(calibrated)
    factors = np.empty_like(scores)
    for start in range(len(scores)):
        for horizon, delay in enumerate(following.delays):
            ended = start - delay
            if ended >= 0:
                missed = scores[ended, horizon] > factors[ended, horizon]
                log[horizon] += following.gain * (missed - following.miss_share)
        factors[start] = calibrated * np.exp(log)
    return factors


def chosen_shape(errors: Sequence[Array], covariances: Sequence[Array], following: Following) -> TubeShape:
    """The shape whose tubes are narrowest on flights left out; :data:`USUAL` for fewer than two flights.

    Args:
        errors: (W, H, 12) of the roll-outs of each flight, in the order of the starts.
        covariances: (W, H, 12, 12) of them, by the physics.
        following: of each flight, from the factor of the others.
    """
    if len(errors) < 2:
        return USUAL
    pairs, widths = np.array(list(itertools.product(SHARES, POWERS))), []
    for share, power in pairs:
        tried = TubeShape(np.full(4, share), np.full(4, power))
        shaped = [tried.shaped(covariances_of_flight) for covariances_of_flight in covariances]
        scores = [tube_scores(*pair) for pair in zip(errors, shaped, strict=True)]
        logs = np.log(_quantiles(scores, 1.0 - following.miss_share))
        own_widths = []
        for k, (own, sizes) in enumerate(zip(scores, shaped, strict=True)):
            begin = np.exp(np.delete(logs, k, axis=0).mean(axis=0))
            radii = np.minimum(tracked_factors(own, begin, following) * tube_radii(sizes), LARGEST)
            own_widths.append(np.log(np.maximum(radii.mean(axis=0), _LEAST)).mean(axis=0))
        widths.append(np.mean(own_widths, axis=0))
    return TubeShape(*np.ascontiguousarray(pairs[np.argmin(widths, axis=0)].T))


@dataclass(frozen=True)
class TubeCalibration:
    """What flights left out in turn say of tubes at :data:`HORIZONS_S`.

    Attributes:
        scores: (F, H, 4, L) of each flight the quantiles of its scores at `interval_rules.LEVELS`.
        norms: (F, H, 4, L) likewise of the norms of its errors.
        shape: of the tubes that the scores are in terms of.
    """

    scores: Array
    norms: Array
    shape: TubeShape = USUAL

    @classmethod
    def of_flights(
        cls, scores: Sequence[Array], norms: Sequence[Array], shape: TubeShape = USUAL
    ) -> TubeCalibration:
        """From scores, by a shape, and norms (W, H, 4) of the roll-outs of each flight."""
        by_level = [np.moveaxis(_quantiles(values, LEVELS), 1, -1) for values in (scores, norms)]
        return cls(by_level[0], by_level[1], shape)

    def factors(self, horizons_s: Sequence[float], confidence: float) -> Array:
        """Factor (h, 4) on the covariance's ellipsoids at horizons (h,).

        Raises:
            ModelError: for a confidence or a horizon that is not calibrated.
        """
        return _at(self.scores, horizons_s, confidence)

    def radii(self, horizons_s: Sequence[float], confidence: float) -> Array:
        """Radius (h, 4) of the balls of split conformal prediction; raises as `factors` does."""
        return _at(self.norms, horizons_s, confidence)

    def arrays(self) -> dict[str, Array]:
        """What a stored model keeps."""
        stored = {"scores": self.scores, "norms": self.norms, "shape": np.array(self.shape)}
        return {f"calibration_{name}": np.ascontiguousarray(own) for name, own in stored.items()}

    @classmethod
    def stored(cls, arrays: Mapping[str, Array]) -> TubeCalibration:
        """Read what `arrays` gave.

        Raises:
            ModelError: for numbers that no calibration gives.
        """
        names = [f"calibration_{name}" for name in ("scores", "norms", "shape")]
        if missing := set(names) - set(arrays):
            raise ModelError(f"{min(missing)} is missing")
        scores, norms, shape = (arrays[name] for name in names)
        wanted = (len(scores), len(HORIZONS_S), len(QUANTITIES), len(LEVELS))
        for name, values in (("scores", scores), ("norms", norms)):
            if values.shape != wanted or not len(values) or not np.all(values > 0.0):
                raise ModelError(f"{name} of shape {values.shape}, expected positive {wanted}")
        if shape.shape != (2, len(QUANTITIES)) or not np.all((shape >= 0.0) & (shape <= 1.0)):
            raise ModelError(f"shape of tubes of shape {shape.shape}, expected shares (2, 4)")
        return cls(scores, norms, TubeShape(*shape))


def require_horizon(horizon_s: float) -> None:
    """Refuse a horizon for which tubes are not calibrated.

    Raises:
        ModelError: naming the range.
    """
    if not HORIZONS_S[0] <= horizon_s <= HORIZONS_S[-1]:
        raise ModelError(
            f"a horizon of {horizon_s:g} s: "
            f"tubes are calibrated from {HORIZONS_S[0]:g} to {HORIZONS_S[-1]:g} s"
        )


def _quantiles(values: Sequence[Array], levels: float | Array) -> Array:
    """Quantiles of values (W, ...) of each flight at levels: (F, ...) or (F, L, ...)."""
    quantiles = [np.quantile(sizes, levels, axis=0, method="higher") for sizes in values]
    return np.maximum(np.stack(quantiles), _LEAST)


def _at(quantiles: Array, horizons_s: Sequence[float], confidence: float) -> Array:
    require_confidence(confidence, calibrated=True)
    for horizon in horizons_s:
        require_horizon(horizon)
    mean = np.mean(np.log(quantiles), axis=0)
    at_level = np.array([[np.interp(confidence, LEVELS, row) for row in by_horizon] for by_horizon in mean])
    logs = [np.interp(np.log(horizons_s), np.log(HORIZONS_S), at) for at in at_level.T]
    return np.exp(np.stack(logs, axis=1))
