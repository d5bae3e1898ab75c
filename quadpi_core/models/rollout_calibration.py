# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How large the tube around a roll-out must be: factors on its covariance, calibrated on flights left out.

The tube of a quantity (position, velocity, attitude or rates) at a horizon is the ellipsoid eᵀ Σ⁻¹ e ≤ f²
of the covariance Σ that the physics give (see `rollout_covariance`), shaped as `tube_shape` says. Per
flight, the quantile of the score √(eᵀ Σ⁻¹ e) is the factor that would have covered that flight; the
geometric mean over the flights is used, so that the coverage of the next flight lies about the nominal one,
neither above nor below. Split conformal prediction of |e|, whose regions are balls of one size, is kept
beside it for comparison.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.interval_rules import LEVELS, require_confidence
from quadpi_core.models.tube_shape import EARLIER, QUANTITIES, TubeShape

# Horizons [s] that are calibrated; factors in between are interpolated.
HORIZONS_S = (0.01, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 1.0)


def error_norms(errors: Array) -> Array:
    """Euclidean norm (W, H, 4) of each quantity of errors (W, H, 12)."""
    return np.stack([np.linalg.norm(errors[..., part], axis=-1) for part in QUANTITIES.values()], axis=-1)


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
    shape: TubeShape = EARLIER

    @classmethod
    def of_flights(
        cls, scores: Sequence[Array], norms: Sequence[Array], shape: TubeShape = EARLIER
    ) -> TubeCalibration:
        """From scores, by a shape, and norms (W, H, 4) of the roll-outs of each flight."""
        return cls(_quantiles(scores), _quantiles(norms), shape)

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
        return {
            "calibration_scores": np.ascontiguousarray(self.scores),
            "calibration_norms": np.ascontiguousarray(self.norms),
            "calibration_shape": np.array(self.shape),
        }

    @classmethod
    def stored(cls, arrays: dict[str, Array]) -> TubeCalibration:
        """Read what `arrays` gave.

        Raises:
            ModelError: for numbers that no calibration gives.
        """
        if missing := {"calibration_scores", "calibration_norms"} - set(arrays):
            raise ModelError(f"roll-outs: {min(missing)} is missing")
        scores, norms = arrays["calibration_scores"], arrays["calibration_norms"]
        wanted = (len(scores), len(HORIZONS_S), len(QUANTITIES), len(LEVELS))
        for name, values in (("scores", scores), ("norms", norms)):
            if values.shape != wanted or not len(values) or not np.all(values > 0.0):
                raise ModelError(f"roll-outs: {name} of shape {values.shape}, expected positive {wanted}")
        # Models of earlier versions have none.
        shape = arrays.get("calibration_shape", np.array(EARLIER))
        if shape.shape != (2, len(QUANTITIES)) or not np.all((shape >= 0.0) & (shape <= 1.0)):
            raise ModelError(f"roll-outs: shape of tubes of shape {shape.shape}, expected shares (2, 4)")
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


def _quantiles(values: Sequence[Array]) -> Array:
    # Flights of the model itself may have no error at all at the first horizon.
    least = np.finfo(float).tiny
    return np.stack(
        [
            np.maximum(np.moveaxis(np.quantile(own, LEVELS, axis=0, method="higher"), 0, -1), least)
            for own in values
        ]
    )


def _at(quantiles: Array, horizons_s: Sequence[float], confidence: float) -> Array:
    require_confidence(confidence, calibrated=True)
    for horizon in horizons_s:
        require_horizon(horizon)
    mean = np.mean(np.log(quantiles), axis=0)
    at_level = np.array([[np.interp(confidence, LEVELS, row) for row in own] for own in mean])
    places = np.log(horizons_s)
    logs = np.stack([np.interp(places, np.log(HORIZONS_S), own) for own in at_level.T], axis=1)
    result: Array = np.exp(logs)
    return result
