# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The shape of tubes: how far they follow the covariance that the physics give, and how far a ball.

The physics know which errors grow in which direction and at which start, better in some quantities and on
some vehicles than in others. Two numbers of each quantity say how far that is believed: the share of a ball
in the covariance, and the power of its size by which a tube grows; with a whole share and no power the tube
is the ball of split conformal prediction. They are those with the narrowest tubes on flights left out.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from quadpi_core.frames import Array
from quadpi_core.models.physical_rollout import ATTITUDE, POSITION, RATES, VELOCITY

# Rows of an error by the name of the quantity, with its unit.
QUANTITIES = {
    "position_m": POSITION,
    "velocity_m_s": VELOCITY,
    "attitude_rad": ATTITUDE,
    "rates_rad_s": RATES,
}
# What is tried: from the physics alone to a ball of one size.
SHARES = (0.0, 0.3, 0.6, 1.0)
POWERS = (1.0, 0.75, 0.5, 0.25, 0.0)
# No attitude errs by more than half a turn: larger tubes are the whole.
LARGEST = np.array([np.pi if name == "attitude_rad" else np.inf for name in QUANTITIES])


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


# How fast a tube follows its flight [1/s], see `monitor.adaptive`. At ten starts a second the factor grows by
# 46 % after a miss and shrinks by 2 % after a hit. A flight of 30 s whose errors are three times those of the
# calibration then has 0.9 % more misses than nominal; half as fast, twice as many.
TRACKING_PER_S = 4.0
# Of models that were calibrated before the shape was chosen.
EARLIER = TubeShape(np.array([0.3, 0.3, 0.0, 0.0]), np.ones(4))


def tube_scores(errors: Array, covariance: Array) -> Array:
    """Size (W, H, 4) of errors (W, H, 12) in terms of their covariance (W, H, 12, 12)."""
    scores = []
    for part in QUANTITIES.values():
        own = errors[..., part]
        weighed = np.linalg.solve(covariance[..., part, part], own[..., np.newaxis])[..., 0]
        scores.append(np.sqrt(np.sum(own * weighed, axis=-1)))
    return np.stack(scores, axis=-1)


def tube_radii(covariance: Array) -> Array:
    """Radius (W, H, 4) of the ball that has the volume of the ellipsoid with factor 1."""
    return np.stack(
        [np.linalg.det(covariance[..., part, part]) ** (1.0 / 6.0) for part in QUANTITIES.values()], axis=-1
    )


class Following(NamedTuple):
    """How tubes follow a flight.

    Attributes:
        delays: (H,) starts after which the error of a horizon is known.
        miss_share: nominal share of misses.
        gain: step of the logarithm of the factor.
    """

    delays: Sequence[int]
    miss_share: float
    gain: float


def chosen_shape(errors: Sequence[Array], covariances: Sequence[Array], following: Following) -> TubeShape:
    """The shape whose tubes are narrowest on flights left out, each followed from the factor of the others.

    Args:
        errors: (W, H, 12) of the roll-outs of each flight, in the order of the starts.
        covariances: (W, H, 12, 12) of them, by the physics.
        following: of the flights.

    Returns:
        The shape; with fewer than two flights, :data:`EARLIER`.
    """
    if len(errors) < 2:
        return EARLIER
    tried = [
        TubeShape(np.full(4, share), np.full(4, power)) for share, power in itertools.product(SHARES, POWERS)
    ]
    widths = np.array([_mean_log_width(shape, errors, covariances, following) for shape in tried])
    best = [tried[k] for k in np.argmin(widths, axis=0)]
    return TubeShape(
        np.array([shape.round_share[0] for shape in best]), np.array([shape.size_power[0] for shape in best])
    )


def _mean_log_width(
    shape: TubeShape, errors: Sequence[Array], covariances: Sequence[Array], following: Following
) -> Array:
    """Mean logarithm (4,) of the width of tubes over the flights and horizons."""
    shaped = [shape.shaped(own) for own in covariances]
    scores = [tube_scores(own, matrix) for own, matrix in zip(errors, shaped, strict=True)]
    least, level = np.finfo(float).tiny, 1.0 - following.miss_share
    quantiles = np.log(
        [np.maximum(np.quantile(own, level, axis=0, method="higher"), least) for own in scores]
    )
    widths = []
    for k, (own, matrix) in enumerate(zip(scores, shaped, strict=True)):
        start = np.exp(np.delete(quantiles, k, axis=0).mean(axis=0))
        radii = np.minimum(tracked_factors(own, start, following) * tube_radii(matrix), LARGEST)
        widths.append(np.log(np.maximum(radii.mean(axis=0), least)).mean(axis=0))
    result: Array = np.mean(widths, axis=0)
    return result


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
