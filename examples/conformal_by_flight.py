# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Split conformal prediction by flight, for any estimator that gives intervals.

`python examples/conformal_by_flight.py` calibrates a regression on flights that it was not fitted to, with
the rules of :mod:`quadpi_core.models.interval_rules`. Models of `quadpi identify` need no such step: they are
calibrated on each of their flights left out in turn.
"""

from __future__ import annotations

from hashlib import sha256
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.interval_rules import FlightErrors, HeldOutRule, conformal_rank


class IntervalEstimator(Protocol):
    """What is needed of an estimator: the scikit-learn protocol with intervals."""

    def fit(self, X: Array, y: Array, groups: npt.ArrayLike | None = None) -> Any:
        """Fit inputs (N, D) to targets (N,) of flights labelled by groups (N,)."""

    def predict(self, X: Array) -> Array:
        """Predictions (N,)."""

    def predict_interval(self, X: Array, confidence: float = ...) -> tuple[Array, Array]:
        """Lower and upper bounds (N,)."""


class ConformalByFlight:
    """Calibrates an estimator's intervals on whole flights that it was not fitted to.

    fit → conformalize → predict_interval, in this order. An estimator that is fitted already goes straight
    to `conformalize`; fitting again needs calibration again.

    The shape of the interval over the inputs stays the estimator's own: with the centre c and half width w
    of its interval, a sample's score is |y − c| / w, and the new interval is c ± q w. Per flight, the
    quantile of its scores at the confidence is a factor that would have covered that flight; q is the factor
    of rank ⌈0.9 (F + 1)⌉ among the F calibration flights, or the largest where there are fewer than nine
    (:class:`quadpi_core.models.interval_rules.HeldOutRule`).

    **Guarantee.** If the calibration flights and a new one are exchangeable, whatever the dependence between
    samples within each and however wrong the estimator, then with probability at least :attr:`flight_share`
    (0.9, or F/(F + 1) for F < 9) the interval covers at least `confidence`, a whole percentage, of the new
    flight's samples: the new flight's own factor is equally likely to take any rank among the F + 1 (Vovk,
    Gammerman and Shafer 2005, with the flight as the unit). Nothing is promised for a flight of another kind.

    Args:
        estimator: with `fit`, `predict` and `predict_interval`.
        reference: confidence at which the estimator is asked for its width; only for bounds that were trained
            for one confidence does it matter that it is that one.

    Attributes:
        rule_: factors of the calibration flights.
    """

    def __init__(self, estimator: IntervalEstimator, reference: float = 0.95) -> None:
        self.estimator = estimator
        self.reference = reference
        self._fitted_to: set[bytes] = set()

    def fit(self, X: Array, y: Array, groups: npt.ArrayLike | None = None) -> ConformalByFlight:
        """Fit the estimator to flights that do not calibrate it; forgets an earlier calibration."""
        vars(self).pop("rule_", None)
        self.estimator.fit(X, y, groups)
        labels = np.zeros(len(y)) if groups is None else np.asarray(groups)
        self._fitted_to = {_content(X, y, labels == label) for label in np.unique(labels)}
        return self

    def conformalize(self, X: Array, y: Array, groups: npt.ArrayLike) -> ConformalByFlight:
        """Calibrate on flights that the estimator was not fitted to.

        Args:
            X: (N, D) inputs.
            y: (N,) targets.
            groups: (N,) label of the flight that each sample belongs to.

        Raises:
            ModelError: before `fit`; for no samples, a target that is not finite, a flight that the estimator
                was fitted to, or an interval without width.
        """
        # Fitted attributes end with an underscore, by the protocol.
        if not any(name.endswith("_") for name in vars(self.estimator)):
            raise ModelError("conformalize: the estimator is not fitted: call fit first")
        X, y, labels = np.asarray(X, dtype=float), np.asarray(y, dtype=float), np.asarray(groups)
        if len(y) == 0 or not X.shape[:1] == y.shape == labels.shape:
            raise ModelError(f"conformalize: X {X.shape}, y {y.shape} and groups {labels.shape} do not fit")
        if not np.all(np.isfinite(y)):
            raise ModelError(f"conformalize: sample {np.argmin(np.isfinite(y))}: target is not finite")
        centre, half = self._own(X)
        if not np.all(half > 0.0):
            raise ModelError(f"conformalize: sample {np.argmin(half > 0.0)}: the interval has no width")
        factors = []
        for label in np.unique(labels):
            mine = labels == label
            if _content(X, y, mine) in self._fitted_to:
                raise ModelError(f"conformalize: flight {label}: the estimator was fitted to it")
            everywhere = np.ones(np.count_nonzero(mine), dtype=np.bool_)
            factors.append(FlightErrors((y - centre)[mine], half[mine], everywhere).factors())
        self.rule_ = HeldOutRule(np.stack(factors), flights_inside=len(factors))
        return self

    @property
    def flight_share(self) -> float:
        """Share of new flights that reach the nominal coverage, as guaranteed."""
        flights = len(self._calibrated.flight_factors)
        return conformal_rank(flights) / (flights + 1)

    def predict(self, X: Array) -> Array:
        """Predictions (N,) of the estimator."""
        return self.estimator.predict(X)

    def predict_interval(self, X: Array, confidence: float = 0.95) -> tuple[Array, Array]:
        """Lower and upper bounds (N,).

        Raises:
            ModelError: before `conformalize`, or for a confidence that cannot be calibrated.
        """
        factor = self._calibrated.factor(confidence)
        centre, half = self._own(X)
        return centre - factor * half, centre + factor * half

    @property
    def _calibrated(self) -> HeldOutRule:
        if not hasattr(self, "rule_"):
            raise ModelError("the intervals are not calibrated: call conformalize first")
        return self.rule_

    def _own(self, X: Array) -> tuple[Array, Array]:
        """Centre and half width (N,) of the estimator's intervals at the reference confidence."""
        lower, upper = self.estimator.predict_interval(X, self.reference)
        return 0.5 * (lower + upper), 0.5 * (upper - lower)


def _content(X: Array, y: Array, samples: npt.NDArray[np.bool_]) -> bytes:
    """Hash of one flight's numbers, whatever it is called."""
    digest = sha256(np.asarray(X, dtype=float)[samples].tobytes())
    digest.update(np.asarray(y, dtype=float)[samples].tobytes())
    return digest.digest()


class Parabola:
    """Least squares on the first input and its square; its intervals take residuals as independent."""

    def fit(self, X: Array, y: Array, groups: npt.ArrayLike | None = None) -> Parabola:  # noqa: ARG002
        """Fit coefficients and the standard deviation of the residuals."""
        self.coefficients_ = np.polyfit(X[:, 0], y, 2)
        self.deviation_ = float(np.std(y - self.predict(X)))
        return self

    def predict(self, X: Array) -> Array:
        """Predictions (N,)."""
        predicted: Array = np.polyval(self.coefficients_, X[:, 0])
        return predicted

    def predict_interval(self, X: Array, confidence: float = 0.95) -> tuple[Array, Array]:
        """Bounds of normal errors."""
        half = self.deviation_ * float(ndtri(0.5 + confidence / 2.0))
        return self.predict(X) - half, self.predict(X) + half


def main() -> None:
    """Calibrate a parabola on ten synthetic flights."""
    rng = np.random.default_rng(1)
    groups = np.repeat(np.arange(20), 200)
    X = rng.uniform(-1.0, 1.0, size=(len(groups), 2))
    y = X[:, 0] ** 2 + 0.1 * rng.normal(size=len(X))

    apart = groups >= 10
    conformal = ConformalByFlight(Parabola()).fit(X[~apart], y[~apart], groups[~apart])
    conformal.conformalize(X[apart], y[apart], groups[apart])
    print(f"{conformal.flight_share:.0%} of new flights reach their confidence")


if __name__ == "__main__":
    main()
