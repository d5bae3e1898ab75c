# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Quality-driven ensembles: members trained to give bounds that cover the target and are narrow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeAlias

import numpy as np
from scipy.special import ndtri

from quadpi_core.config_schema import NotNegative
from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.ensemble_estimator import Ensemble, EnsembleKind, Floats, Trained, mean_over
from quadpi_core.models.fitted_ensemble import EnsembleEntry, FittedEnsemble
from quadpi_core.models.interval_rules import Rule, TrainedRule
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import Regressor
from quadpi_core.models.training_table import Plan, Table

if TYPE_CHECKING:
    from quadpi_core.training.losses import QualityDrivenForm
    from quadpi_core.training.train import Report, Training

Aggregation: TypeAlias = Literal["sd", "sem"]
# Of the normal distribution, for bounds of 95 %.
_QUANTILE = float(ndtri(0.975))


@dataclass(frozen=True, kw_only=True)
class _Entry(EnsembleEntry):
    outward: NotNegative


@dataclass(frozen=True)
class FittedQualityDriven(FittedEnsemble):
    """Members that predict a lower and an upper bound.

    Each bound of the ensemble is the mean of the members', moved outward by `outward` standard deviations
    (B − 1), for both the mean of the two bounds': a member astray on one side would else pull the middle
    after it. Centre and spread are the middle of the two and half their distance, but no less than the floor.

    Attributes:
        outward: 1.96 with the standard deviation, 1.96/√B with the standard error of the mean.
    """

    method: ClassVar[str] = "quality-driven"
    entry: ClassVar[type[EnsembleEntry]] = _Entry
    outward: float

    def centre_and_spread(self, X: Array) -> tuple[Array, Array]:
        """Centre and spread (N,) in numpy: the reference for the compiled kernels."""
        bounds = self.members.outputs(self.features(X))
        mean, deviation = bounds.mean(axis=0), bounds.std(axis=0, ddof=1)
        half = 0.5 * (mean[:, 1] - mean[:, 0]) + self.outward * deviation.mean(axis=1)
        spread = np.maximum(np.abs(half), self.floor)
        scale = self.scaling.target_scale
        return self.scaling.target_mean + scale * mean.mean(axis=1), scale * spread

    @property
    def deviation_weight(self) -> float:
        """Of the members' standard deviation."""
        return self.outward

    def require_networks(self) -> None:
        """Two outputs each."""
        if self.members.output_biases.shape[1] != 2 or len(self.members) < 2:
            raise ModelError("members do not give two bounds each")


@dataclass(eq=False)
class QualityDrivenEnsemble(Ensemble):
    """Members trained to give a lower and an upper bound that cover the target and are narrow.

    The paper's settings are given by :meth:`paper`, aggregated as the code of Pearce does. The defaults
    deviate:

    - members start as trained regressors, with bounds at 1.96 times their error: from random weights, the
      loss has a gradient only at samples beside a bound, and the middle stays far from the target;
    - bounds that cross are penalised;
    - a member leaves out whole flights instead of single samples, whose neighbours in time it would have
      seen; with too few flights, contiguous parts. It keeps the weights of the epoch with the best interval
      score on them. The ensemble's half distance is at least 1.96 times the typical offset of a whole flight;
    - intervals are calibrated on flights left out in turn, with ensembles of their own, for any confidence.

    Args:
        warm_up: epochs as regressors, before `epochs` with the quality-driven loss.
        confidence: that the bounds are trained for.
        form, factor, softening, crossing: of the loss, see
            :class:`~quadpi_core.training.losses.QualityDriven`; factor is its λ.
        aggregation: the members' bounds are moved outward by 1.96 standard deviations, "sd", or standard
            errors of the mean, "sem".

    The other arguments are those of :class:`.ensemble_estimator.Ensemble`.
    """

    warm_up: int = 25
    confidence: float = 0.95
    form: QualityDrivenForm = "sqrt-n"
    factor: float = 15.0
    softening: float = 160.0
    crossing: float = 10.0
    aggregation: Aggregation = "sd"

    PAPER: ClassVar[dict[str, Any]] = Ensemble.PAPER | {
        "warm_up": 0,
        "form": "paper",
        "factor": 1.0,
        "crossing": 0.0,
        "aggregation": "sem",
    }
    fitted_type: ClassVar[type[FittedEnsemble]] = FittedQualityDriven

    @property
    def _uncalibrated(self) -> Rule:
        return TrainedRule(self.confidence)

    @property
    def _outward(self) -> float:
        return _QUANTILE / (float(np.sqrt(self.members)) if self.aggregation == "sem" else 1.0)

    def _train(self, table: Table, plan: Plan, report: Report | None) -> Trained:
        from quadpi_core.training.losses import QualityDriven, SquaredError
        from quadpi_core.training.train import train

        samples, schedule, start = self._samples(table, plan), self._schedule(), None
        if self.warm_up:
            start = train(samples, SquaredError(), replace(schedule, epochs=self.warm_up), "warm-up", report)
        loss = QualityDriven(
            self.confidence, self.batch, self.form, self.factor, self.softening, self.crossing
        )
        members = train(samples, loss, schedule, "bounds", report, start)
        centre, half, errors = self._outcomes(members, table, plan)
        floors = _QUANTILE * self._floors(table, plan, errors)
        parts = [
            {"members": own[plan.networks(0)], "outward": self._outward, "floor": float(floors[0, axis])}
            for axis, own in enumerate(members.networks())
        ]
        return Trained(parts, centre, np.maximum(half, floors[..., None]))

    def _outcome(self, members: Training, table: Table, plan: Plan, ensemble: int) -> Sequence[Floats]:
        """Middle, half distance and errors (A, N) of an ensemble's bounds.

        Errors are those of the members that left a sample out; NaN where there is none.
        """
        bounds = members.predictions(plan.networks(ensemble))
        mean, deviation = bounds.mean(axis=1), bounds.std(axis=1, ddof=1)
        half = 0.5 * (mean[:, 1] - mean[:, 0]) + self._outward * deviation.mean(axis=1)
        errors = table.targets - mean_over(bounds.mean(axis=2), plan.unseen(ensemble))
        return mean.mean(axis=1), np.abs(half), errors


class QualityDriven(EnsembleKind):
    """Each axis a quality-driven ensemble, trained for the confidence that the monitor will use."""

    name = FittedQualityDriven.method
    label = "quality-driven ensemble"
    colour = "#0072B2"  # as in the paper
    axis_type = FittedQualityDriven
    estimator = QualityDrivenEnsemble

    def configured(self, inputs: Sequence[Regressor], options: IdentifyOptions) -> Ensemble:
        """The estimator of one axis, not yet fitted."""
        return super().configured(inputs, options).set_params(confidence=options.confidence)


KIND = QualityDriven()
