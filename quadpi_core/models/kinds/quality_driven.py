# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Quality-driven ensembles: members trained to give bounds that cover the target and are narrow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from quadpi_core.config_schema import NotNegative
from quadpi_core.models.ensemble import Ensemble, Floats, Plan, Table, Trained, mean_over
from quadpi_core.models.fitted_ensemble import EnsembleAxis, FittedEnsembles
from quadpi_core.models.interval_rules import Rule, TrainedRule

if TYPE_CHECKING:
    from quadpi_core.training.train import Report, Training

# Of the normal distribution, for bounds of 95 %.
_QUANTILE = 1.959963984540054


@dataclass(frozen=True)
class QualityDrivenAxis(EnsembleAxis):
    """Members that predict a lower and an upper bound.

    Each bound of the ensemble is the mean of the members', moved outward by `outward` standard deviations
    (B − 1), for both the mean of the two bounds': a member astray on one side would else pull the middle
    after it. Centre and spread are the middle of the two and half their distance, but no less than the floor.

    Attributes:
        outward: 1.96 with the standard deviation, 1.96/√B with the standard error of the mean.
    """

    outward: NotNegative

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.members.output_biases.shape[1] != 2:
            raise ValueError("members do not give two bounds each")

    @property
    def deviation_weight(self) -> float:
        """Of the members' standard deviation."""
        return self.outward


class FittedQualityDriven(FittedEnsembles):
    """Quality-driven ensembles of all axes."""

    method = "quality-driven"
    axis_type = QualityDrivenAxis


@dataclass(frozen=True)
class QualityDriven(Ensemble):
    """Members trained to give a lower and an upper bound that cover the target and are narrow.

    The paper's settings are aggregated as the code of Pearce does. The defaults deviate:

    - members start as trained regressors, with bounds at 1.96 times their error: from random weights, the
      loss has a gradient only at samples beside a bound, and the middle stays far from the target;
    - bounds that cross are penalised;
    - a member leaves out whole flights instead of single samples, whose neighbours in time it would have
      seen; with too few flights, contiguous parts. It keeps the weights of the epoch with the best interval
      score on them. The ensemble's half distance is at least 1.96 times the typical offset of a whole flight;
    - intervals are calibrated on flights left out in turn, with ensembles of their own, for any confidence.

    Attributes:
        warm_up: epochs as regressors, before `epochs` with the quality-driven loss.
        form, factor, softening, crossing: of the loss, see
            :class:`~quadpi_core.training.losses.QualityDriven`; factor is its λ.
        aggregation: the members' bounds are moved outward by 1.96 standard deviations, "sd", or standard
            errors of the mean, "sem".
    """

    warm_up: int = 25
    form: Literal["sqrt-n", "paper", "pearce"] = "sqrt-n"
    factor: float = 15.0
    softening: float = 160.0
    crossing: float = 10.0
    aggregation: Literal["sd", "sem"] = "sd"

    name = FittedQualityDriven.method
    label = "quality-driven ensemble"
    colour = "#0072B2"  # as in the paper
    fitted_type = FittedQualityDriven
    PAPER: ClassVar[dict[str, Any]] = Ensemble.PAPER | {
        "warm_up": 0,
        "form": "paper",
        "factor": 1.0,
        "crossing": 0.0,
        "aggregation": "sem",
    }

    def _uncalibrated(self, confidence: float) -> Rule:
        return TrainedRule(confidence)

    @property
    def _outward(self) -> float:
        return _QUANTILE / (float(np.sqrt(self.members)) if self.aggregation == "sem" else 1.0)

    def _train(self, table: Table, plan: Plan, confidence: float, report: Report | None) -> Trained:
        from quadpi_core.training import losses
        from quadpi_core.training.train import train

        samples, schedule, start = self._samples(table, plan), self._schedule(), None
        if self.warm_up:
            start = train(
                samples, losses.SquaredError(), replace(schedule, epochs=self.warm_up), "warm-up", report
            )
        loss = losses.QualityDriven(
            confidence, self.batch, self.form, self.factor, self.softening, self.crossing
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


KIND = QualityDriven()
